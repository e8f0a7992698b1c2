//! The program as a user runs it, in a folder that is not the repository.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, LazyLock, Mutex, OnceLock};
use std::time::Duration;

use augnerf::runtime::with_own_variables;
use tempfile::TempDir;

use super::assert_says;
use super::files::{copy, json, text};

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

/// Runs a command, demands an exit code and no panic, and returns its messages with what it printed.
#[track_caller]
pub fn demand(command: &mut Command, code: i32) -> String {
    let output = command.output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{command:?}: {message}");
    assert!(!message.contains("panicked"), "{message}");
    message + &String::from_utf8_lossy(&output.stdout)
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

/// A folder of its own in which the program runs.
pub struct Place(TempDir);

impl Place {
    pub fn new() -> Place {
        Place(TempDir::new().unwrap())
    }

    /// A folder with this file in it.
    pub fn with(file: &str, text: &str) -> Place {
        let place = Place::new();
        place.write(file, text);
        place
    }

    /// A copy of the folder of a name, which is made once, for tests that change it.
    pub fn once(name: &str, make: impl FnOnce(&Place)) -> Place {
        static MADE: LazyLock<Mutex<HashMap<String, Arc<OnceLock<Place>>>>> = LazyLock::new(Mutex::default);
        let made = MADE.lock().unwrap().entry(name.into()).or_default().clone();
        let made = made.get_or_init(|| {
            let place = Place::new();
            make(&place);
            place
        });
        let place = Place::new();
        copy(made.path(), place.path());
        place
    }

    /// A copy of the folder of a run on the embedded scene with these flags, `run`.
    pub fn trained(flags: &str) -> Place {
        Place::once(flags, |place| drop(place.run(&format!("train --quiet --preset smoke --out run {flags}"), 0)))
    }

    pub fn path(&self) -> &Path {
        self.0.path()
    }

    pub fn at(&self, name: &str) -> PathBuf {
        self.path().join(name)
    }

    /// Writes a file, and the folders that it lies in.
    #[track_caller]
    pub fn write(&self, file: &str, content: impl AsRef<[u8]>) {
        std::fs::create_dir_all(self.at(file).parent().unwrap()).unwrap();
        std::fs::write(self.at(file), content).unwrap();
    }

    #[track_caller]
    pub fn text(&self, file: &str) -> String {
        text(&self.at(file))
    }

    #[track_caller]
    pub fn json(&self, file: &str) -> serde_json::Value {
        json(&self.at(file))
    }

    /// A command line, not yet started. Words are between spaces or, with spaces of their own, in quotes.
    pub fn command(&self, line: &str) -> Command {
        let parts = line.split('\'').enumerate();
        let words = parts.flat_map(|(i, part)| if i % 2 == 1 { vec![part] } else { part.split_whitespace().collect() });
        let mut command = augnerf(&words.collect::<Vec<&str>>());
        command.current_dir(self.path());
        command
    }

    /// Runs a command line, demands an exit code and no panic, and returns everything said.
    #[track_caller]
    pub fn run(&self, line: &str, code: i32) -> String {
        demand(&mut self.command(line), code)
    }

    /// Runs, demands success and returns what was printed.
    #[track_caller]
    pub fn printed(&self, line: &str) -> String {
        let output = self.command(line).output().unwrap();
        assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }

    /// Demands an exit code and words of what is said.
    #[track_caller]
    pub fn says(&self, line: &str, code: i32, words: &[&str]) {
        assert_says(&self.run(line, code), words);
    }

    /// Starts a command line whose messages are kept.
    pub fn start(&self, line: &str) -> Child {
        self.command(line).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
    }
}

/// A sweep of points of a second, on the embedded scene at 16 x 16: further settings, `key=value` with spaces between, and rows
/// beside `NeRF`.
pub fn tiny_sweep(seeds: &[u64], metrics: &[&str], settings: &str, rows: &[(&str, &str)]) -> String {
    let head = "title = \"tiny\"\npreset = \"smoke\"\nscenes = [\"builtin\"]\nbaseline = \"NeRF\"";
    let small = "data.width=16 field.width=16 sampling.coarse=8 sampling.fine=8 train.rays=64 ";
    let setting = |text: &str| text.split_once('=').map(|(key, value)| format!("\"{key}\" = {value}\n")).unwrap();
    let settings: String = small.split_whitespace().chain(settings.split_whitespace()).map(setting).collect();
    let row = |(name, set): &(&str, &str)| format!("\n[[row]]\nname = \"{name}\"\nset = {{ {set} }}\n");
    let rows: String = std::iter::once(&("NeRF", "")).chain(rows).map(row).collect();
    format!("{head}\nseeds = {seeds:?}\nmetrics = {metrics:?}\n\n[set]\n{settings}{rows}")
}

/// Flags of settings with spaces between them.
pub fn set(settings: &str) -> String {
    settings.split_whitespace().map(|setting| format!(" --set {setting}")).collect()
}

/// Sends a signal to a program and returns its exit code and what it said.
#[cfg(unix)]
pub fn signalled(child: Child, signal: &str) -> (Option<i32>, String) {
    assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}
