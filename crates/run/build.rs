//! Compiles the code revision in.

use std::path::Path;
use std::process::Command;

/// The workspace, from this package.
const ROOT: &str = "../..";

/// What numbers are computed by. Only a change of these makes the revision `-dirty`, and they are what is watched: the git
/// index is not, since every `git status` may rewrite it. The commands have a build script of their own.
const SOURCES: [&str; 3] = ["crates", "Cargo.toml", "Cargo.lock"];

/// Files below the git folder that change when another commit is checked out or made.
const GIT_FILES: [&str; 3] = ["HEAD", "logs/HEAD", "packed-refs"];

fn main() {
    println!("cargo:rerun-if-changed=src");
    println!("cargo:rerun-if-changed=build.rs");
    for source in SOURCES.map(|source| Path::new(ROOT).join(source)).iter().filter(|source| source.exists()) {
        println!("cargo:rerun-if-changed={}", source.display());
    }
    let revision = git_revision().or_else(packaged_revision).unwrap_or_else(|| "unknown".to_string());
    println!("cargo:rustc-env=AUGNERF_REVISION={revision}");
    println!("cargo:rustc-env=AUGNERF_FEATURES={}", features().join(" "));
}

/// The features that are built in, `default` left out.
fn features() -> Vec<String> {
    let name = |key: String| Some(key.strip_prefix("CARGO_FEATURE_")?.to_lowercase().replace('_', "-"));
    let mut features: Vec<String> = std::env::vars().filter_map(|(key, _)| name(key)).collect();
    features.retain(|feature| feature != "default");
    features.sort();
    features
}

/// The standard output of a successful git command. No optional locks: asking must not write.
fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").arg("--no-optional-locks").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_string())
}

fn git_revision() -> Option<String> {
    // A package unpacked inside some other project's repository must not report that one's commit.
    let manifest = std::fs::read_to_string(Path::new(ROOT).join("Cargo.toml")).ok()?;
    if git(&["rev-parse", "--show-prefix"])? != "crates/run/" || !manifest.contains("name = \"augnerf\"") {
        return None;
    }
    let reference = git(&["symbolic-ref", "-q", "HEAD"]);
    for file in GIT_FILES.into_iter().chain(reference.as_deref()) {
        // A watched file that does not exist would run this script in every build.
        if let Some(path) = git(&["rev-parse", "--git-path", file]).filter(|path| Path::new(path).exists()) {
            println!("cargo:rerun-if-changed={path}");
        }
    }
    let commit = git(&["rev-parse", "--short=12", "HEAD"])?;
    let sources = SOURCES.map(|source| format!(":/{source}"));
    let mut status = vec!["status", "--porcelain", "--untracked-files=no", "--"];
    status.extend(sources.iter().map(String::as_str));
    let dirty = !git(&status)?.is_empty();
    Some(commit.chars().take(12).collect::<String>() + if dirty { "-dirty" } else { "" })
}

/// The commit that `cargo package` noted in the crate's archive.
fn packaged_revision() -> Option<String> {
    let text = std::fs::read_to_string(".cargo_vcs_info.json").ok()?;
    let (_, rest) = text.split_once("\"sha1\"")?;
    let commit = rest.split('"').nth(1)?.get(..12)?;
    commit.bytes().all(|byte| byte.is_ascii_hexdigit()).then(|| commit.to_string())
}
