//! The program as a user runs it, in a folder that is not the repository.

use std::process::{Command, Output};
use std::time::Duration;

use augnerf::runtime::with_own_variables;

use super::assert_says;

/// The program with arguments, not yet started. It sees neither scenes nor LPIPS weights of this machine.
pub fn augnerf(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_augnerf"));
    command.args(arguments).env("RUST_BACKTRACE", "0");
    command.env_remove("AUGNERF_LPIPS_WEIGHTS").env_remove("AUGNERF_DATA");
    // A runtime in this process has set the threads of its children.
    with_own_variables(&mut command);
    // Whatever lands in a default place must not land in the repository.
    command.current_dir(std::env::temp_dir());
    command
}

/// Runs it to its end.
pub fn run(arguments: &[&str]) -> Output {
    augnerf(arguments).output().unwrap()
}

/// Runs and demands success.
#[track_caller]
pub fn succeed(arguments: &[&str]) -> Output {
    let output = run(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    output
}

/// Runs, demands success and returns what it printed.
#[track_caller]
pub fn printed(arguments: &[&str]) -> String {
    String::from_utf8(succeed(arguments).stdout).unwrap()
}

/// Runs a command, demands an exit code and no panic, and returns its messages with what it printed.
#[track_caller]
pub fn demand(command: &mut Command, code: i32) -> String {
    let output = command.output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{command:?}: {message}");
    assert!(!message.contains("panicked"), "{message}");
    message + &String::from_utf8_lossy(&output.stdout)
}

/// Runs and demands the exit code and words of a refusal: one sentence, no panic.
#[track_caller]
pub fn refuse(arguments: &[&str], code: i32, words: &[&str]) {
    assert_says(&demand(&mut augnerf(arguments), code), words);
}

/// Waits until something holds. What does not for ten minutes never does, on a busy machine, too.
#[track_caller]
pub fn wait_for(what: &str, mut holds: impl FnMut() -> bool) {
    for _ in 0..120_000 {
        if holds() {
            return;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    panic!("ten minutes went by without {what}");
}
