//! The `augnerf` program, which passes its arguments to [`augnerf::cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    augnerf::cli::main()
}
