//! The `augnerf` program: hands its arguments to [`augnerf::cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    augnerf::allocator::keep_freed_memory();
    augnerf::cli::main()
}
