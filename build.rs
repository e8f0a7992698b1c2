//! Notes whether the commands differ from the commit that `augnerf-run` names.

use std::process::Command;

/// What only the program is built from.
const SOURCES: [&str; 2] = ["src", "sweeps"];

/// The standard output of a successful git command. No optional locks: asking must not write.
fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").arg("--no-optional-locks").args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_string())
}

fn main() {
    let in_git = |file| git(&["rev-parse", "--git-path", file]);
    let watched = SOURCES.into_iter().chain(["build.rs"]).map(String::from);
    for file in watched.chain(in_git("HEAD")).chain(in_git("logs/HEAD")) {
        // A watched file that does not exist would run this script in every build.
        if std::path::Path::new(&file).exists() {
            println!("cargo:rerun-if-changed={file}");
        }
    }
    let status = git(&["status", "--porcelain", "--untracked-files=no", "--", SOURCES[0], SOURCES[1]]);
    println!("cargo:rustc-env=AUGNERF_COMMANDS_DIFFER={}", status.is_some_and(|changes| !changes.is_empty()));
}
