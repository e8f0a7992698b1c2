//! The `augnerf` program: hands its arguments to [`augnerf::cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    augnerf::runtime::allocator::keep_freed_memory();
    augnerf::cli::main()
}
