//! Damaged input for every reader of the library: no panic, no hang, no memory beyond reason, and an error that is a
//! sentence for people.
//!
//! | variable | default |
//! |---|---|
//! | `AUGNERF_FUZZ_SECONDS` | 60, of all readers |
//! | `AUGNERF_FUZZ_SEED` | 1 |
//! | `AUGNERF_FUZZ_READER` | every file; otherwise those whose paths hold this |
//!
//! An input is a function of seed, file and number. One that fails is left in `target/fuzz`. If a run hangs, its input is one of the first
//! file that has no line in the table.

pub mod damage;
pub mod memory;
pub mod readers;

use std::cell::RefCell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use augnerf::base::rng::{Random, Stream};
use damage::damaged;
use readers::Reader;

/// An input that takes longer hangs.
const HANG: Duration = Duration::from_secs(20);
/// Most bytes that an input may take.
const MOST_BYTES: usize = 1 << 30;
/// Longest message for a person.
const MOST_MESSAGE: usize = 20_000;
/// What is said of sound files that are not whole: a part of a network, a scene under another name, a lock that is held.
const LACKS: [&str; 5] = [
    "lacks the tensor 3.squeeze.weight",
    "cannot be read",
    "here both have the same layers",
    "rename it to transforms.json",
    "is in use by process 4711",
];

thread_local! {
    static PANIC: RefCell<String> = const { RefCell::new(String::new()) };
}

/// Reads a file that was damaged, and returns what is wrong with that, and the most bytes that it took.
fn failure(reader: &Reader) -> (Option<String>, usize) {
    let started = Instant::now();
    let (result, bytes) = memory::most_taken(|| catch_unwind(AssertUnwindSafe(&reader.read)));
    let took = started.elapsed();
    let failure = match &result {
        Err(_) => Some(format!("panic: {}", PANIC.with_borrow(String::clone))),
        _ if took > HANG => Some(format!("takes {took:?}")),
        _ if bytes > MOST_BYTES => Some(format!("takes {} MiB", bytes >> 20)),
        Ok(Ok(())) => None,
        Ok(Err(error)) => unfit(&error.to_string(), error.exit_code()),
    };
    (failure, bytes)
}

/// Why a message is not one for people.
fn unfit(message: &str, exit_code: u8) -> Option<String> {
    let stray = |character: char| character.is_control() && !['\n', '\t'].contains(&character);
    match message {
        _ if exit_code == 1 => Some(format!("an internal error: {message}")),
        _ if message.len() > MOST_MESSAGE => Some(format!("a message of {} bytes", message.len())),
        _ => message.contains(stray).then(|| format!("control characters in the message {message:?}")),
    }
}

/// The value of a variable, or what stands where it is not set.
fn setting(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name}={text} is no number")))
}

/// Leaves an input in `target/fuzz`.
fn keep(name: &str, input: &[u8]) -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/fuzz");
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join(name);
    std::fs::write(&path, input).unwrap();
    path
}

/// Damages a file again and again for some time, prints a line of a table, and returns what failed.
fn attack(reader: &Reader, name: &str, share: Duration) -> Vec<String> {
    let seed = setting("AUGNERF_FUZZ_SEED", 1);
    let part = name.bytes().fold(0, |hash: u64, byte| hash.wrapping_mul(31) + u64::from(byte));
    let sound = std::fs::read(&reader.file).unwrap();
    let (started, mut inputs, mut most, mut failures) = (Instant::now(), 0, 0, Vec::new());
    while started.elapsed() < share && failures.len() < 20 {
        let input = damaged(&sound, &mut Random::part(seed, Stream::Batches, inputs, part));
        let name = format!("{}-{seed}-{inputs}", name.replace('/', "-"));
        std::fs::write(&reader.file, &input).unwrap();
        let (failed, bytes) = failure(reader);
        failures.extend(failed.map(|failed| format!("{}: {failed}", keep(&name, &input).display())));
        (inputs, most) = (inputs + 1, most.max(bytes));
    }
    println!("{name:<60} {inputs:>9} {:>8} {:>8}", most >> 20, failures.len());
    std::fs::write(&reader.file, sound).unwrap();
    failures
}

/// All readers, their files in memory where the system has a place for that: a disk takes longer than most readers.
fn all_readers() -> (tempfile::TempDir, Vec<Reader>) {
    let folder = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
    let readers = readers::all(folder.path());
    (folder, readers)
}

fn name<'a>(reader: &'a Reader, folder: &Path) -> &'a str {
    reader.file.strip_prefix(folder).unwrap().to_str().unwrap()
}

#[test]
fn sound_files_are_read() {
    let (folder, readers) = all_readers();
    let refused = readers.iter().filter_map(|reader| {
        let message = (reader.read)().err()?.to_string();
        let is_sound = LACKS.iter().any(|lacks| message.contains(lacks));
        (!is_sound).then(|| format!("{}: {message}", name(reader, folder.path())))
    });
    let refused: Vec<String> = refused.collect();
    assert!(refused.is_empty(), "{}", refused.join("\n"));
}

#[test]
#[ignore = "a minute; the nightly run has it"]
fn damaged_files_are_refused_in_a_sentence() {
    let (folder, readers) = all_readers();
    let only = std::env::var("AUGNERF_FUZZ_READER").unwrap_or_default();
    let chosen: Vec<&Reader> = readers.iter().filter(|reader| name(reader, folder.path()).contains(&only)).collect();
    assert!(!chosen.is_empty(), "AUGNERF_FUZZ_READER={only} names no reader");
    let share = Duration::from_secs(setting("AUGNERF_FUZZ_SECONDS", 60)) / chosen.len() as u32;
    std::panic::set_hook(Box::new(|panic| PANIC.with_borrow_mut(|text| *text = panic.to_string())));
    println!("{:<60} {:>9} {:>8} {:>8}", "file", "inputs", "most MiB", "failures");
    let failed: Vec<String> =
        chosen.iter().flat_map(|reader| attack(reader, name(reader, folder.path()), share)).collect();
    drop(std::panic::take_hook());
    assert!(failed.is_empty(), "{}", failed.join("\n"));
}
