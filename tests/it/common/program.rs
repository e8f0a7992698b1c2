//! The program as a user runs it, in a folder that is not the repository.

use std::process::{Command, Output};

/// The program with arguments, not yet started.
pub fn augnerf(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_augnerf"));
    command.args(arguments).env_remove("AUGNERF_LPIPS_WEIGHTS").env("RUST_BACKTRACE", "0");
    // Whatever lands in a default place must not land in the repository.
    command.current_dir(std::env::temp_dir());
    command
}

/// Runs it to its end.
pub fn run(arguments: &[&str]) -> Output {
    augnerf(arguments).output().unwrap()
}

/// Runs and demands success.
pub fn succeed(arguments: &[&str]) -> Output {
    let output = run(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    output
}

/// Runs and demands the exit code and words of a refusal: one sentence, no panic.
pub fn refuse(arguments: &[&str], code: i32, words: &[&str]) {
    let output = run(arguments);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {message}");
    assert!(!message.contains("panicked"), "{message}");
    for word in words {
        assert!(message.contains(word), "'{word}' is not in: {message}");
    }
}
