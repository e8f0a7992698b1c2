//! The `augnerf` program: hands its arguments to [`augnerf::cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    augnerf::cli::main()
}
