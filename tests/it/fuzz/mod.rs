//! Damaged input for every reader of the library: no panic, no hang, no memory beyond reason, and an error that is a
//! sentence for people.
//!
//! ```sh
//! cargo test --release --test it fuzz:: -- --ignored --nocapture      # a minute over all readers
//! AUGNERF_FUZZ_INPUTS=1000000 AUGNERF_FUZZ_READER=ply cargo test ...   # as many inputs of the readers of that name
//! ```
//!
//! | variable | default |
//! |---|---|
//! | `AUGNERF_FUZZ_INPUTS` | as many inputs a reader as there is time for |
//! | `AUGNERF_FUZZ_SECONDS` | 60, of all readers, where no number of inputs is set |
//! | `AUGNERF_FUZZ_SEED` | 1 |
//! | `AUGNERF_FUZZ_READER` | every reader; otherwise those whose names hold this |
//! | `AUGNERF_FUZZ_FROM` | 0, the number of the first input |
//!
//! An input is a function of seed, reader and number. One that fails is left in `target/fuzz`.

pub mod formats;
pub mod memory;
mod mutate;
mod readers;
pub mod results;
mod seeds;

use std::cell::RefCell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use mutate::{Dice, mutated};
use readers::Reader;

/// An input that takes longer hangs.
const HANG: Duration = Duration::from_secs(20);
/// After so long the program is ended: the input does not come back.
const LOST: Duration = Duration::from_secs(600);
/// Most bytes that an input may take.
const MOST_BYTES: usize = 1 << 30;
/// Longest message for a person.
const MOST_MESSAGE: usize = 20_000;

thread_local! {
    static PANIC: RefCell<String> = const { RefCell::new(String::new()) };
}

/// What became of an input.
struct Outcome {
    failure: Option<String>,
    refused: bool,
    took: Duration,
    bytes: usize,
}

fn read(reader: &Reader, input: &[u8]) -> Outcome {
    let started = Instant::now();
    let work = || catch_unwind(AssertUnwindSafe(|| (reader.read)(input)));
    let (result, bytes) = memory::most_taken(work);
    let took = started.elapsed();
    let (failure, refused) = match &result {
        Err(_) => (Some(format!("panic: {}", PANIC.with_borrow(String::clone))), false),
        Ok(Ok(())) => (None, false),
        Ok(Err(error)) => (unfit(&error.to_string(), error.exit_code()), true),
    };
    // A machine that was busy with other things is not so a second time.
    let again = || {
        let started = Instant::now();
        let _ = catch_unwind(AssertUnwindSafe(|| (reader.read)(input)));
        started.elapsed() > HANG
    };
    let slow = (took > HANG && again()).then(|| format!("takes {took:?}"));
    let large = (bytes > MOST_BYTES).then(|| format!("takes {} MiB", bytes >> 20));
    Outcome { failure: failure.or(slow).or(large), refused, took, bytes }
}

/// Where inputs are written: in memory where the system has a place for that, as a disk takes longer than most readers.
fn work_folder() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap()
}

/// Why a message is not one for people.
fn unfit(message: &str, exit_code: u8) -> Option<String> {
    let stray = |character: char| character.is_control() && !['\n', '\t'].contains(&character);
    if exit_code == 1 {
        return Some(format!("an internal error: {message}"));
    }
    if message.len() > MOST_MESSAGE {
        return Some(format!("a message of {} bytes", message.len()));
    }
    message.contains(stray).then(|| format!("control characters in the message {message:?}"))
}

/// The value of a variable, or what stands where it is not set.
fn setting(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name}={text} is no number")))
}

/// Where inputs that fail are left.
fn failures() -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/fuzz");
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

/// Since when an input is read, its name and bytes.
type Now = Arc<Mutex<Option<(Instant, String, Vec<u8>)>>>;

/// Ends the program where an input does not come back, and leaves the input.
struct Watch {
    now: Now,
}

impl Watch {
    fn new() -> Watch {
        let now: Now = Arc::default();
        let watched = now.clone();
        std::thread::spawn(move || {
            loop {
                std::thread::sleep(Duration::from_secs(1));
                if let Some((_, name, input)) =
                    watched.lock().unwrap().as_ref().filter(|(since, ..)| since.elapsed() > LOST)
                {
                    let path = failures().join(name);
                    std::fs::write(&path, input).unwrap();
                    eprintln!("{}: does not come back within {LOST:?}", path.display());
                    std::process::exit(101);
                }
            }
        });
        Watch { now }
    }

    fn begin(&self, name: String, input: &[u8]) {
        *self.now.lock().unwrap() = Some((Instant::now(), name, input.to_vec()));
    }

    fn end(&self) {
        *self.now.lock().unwrap() = None;
    }
}

/// The numbers of one reader, for the table.
#[derive(Default)]
struct Tally {
    inputs: u64,
    refused: u64,
    time: Duration,
    slowest: Duration,
    bytes: usize,
    failures: Vec<String>,
}

impl Tally {
    fn add(&mut self, outcome: &Outcome) {
        self.inputs += 1;
        self.refused += u64::from(outcome.refused);
        self.time += outcome.took;
        self.slowest = self.slowest.max(outcome.took);
        self.bytes = self.bytes.max(outcome.bytes);
    }

    fn line(&self, name: &str) -> String {
        format!(
            "{name:<24} {:>9} {:>8.1} {:>9.1} {:>8.1} {:>7.1} {:>8}",
            self.inputs,
            self.time.as_secs_f64() * 1e6 / self.inputs.max(1) as f64,
            self.slowest.as_secs_f64() * 1e3,
            self.bytes as f64 / f64::from(1 << 20),
            100.0 * self.refused as f64 / self.inputs.max(1) as f64,
            self.failures.len()
        )
    }
}

/// Runs the inputs of one reader. Of one that seems to hang, the second of two tries counts: the machine may have been busy.
fn attack(reader: &Reader, share: Option<Duration>, watch: &Watch) -> Tally {
    let (seed, from) = (setting("AUGNERF_FUZZ_SEED", 1), setting("AUGNERF_FUZZ_FROM", 0));
    let inputs = setting("AUGNERF_FUZZ_INPUTS", u64::MAX);
    let started = Instant::now();
    let mut tally = Tally::default();
    for number in (from..).take(usize::try_from(inputs).unwrap_or(usize::MAX)) {
        if share.is_some_and(|share| started.elapsed() > share) || tally.failures.len() >= 20 {
            break;
        }
        let input = mutated(reader.format, &reader.seeds, &mut Dice::new(seed, reader.name, number));
        let name = format!("{}-{seed}-{number}", reader.name.replace(' ', "_"));
        watch.begin(name.clone(), &input);
        let mut outcome = read(reader, &input);
        if outcome.took > HANG {
            outcome = read(reader, &input);
        }
        watch.end();
        tally.add(&outcome);
        if let Some(failure) = outcome.failure {
            let path = failures().join(name);
            std::fs::write(&path, &input).unwrap();
            tally.failures.push(format!("{}: {failure}", path.display()));
        }
    }
    tally
}

#[test]
fn sound_files_are_read() {
    let folder = work_folder();
    let mut refused = Vec::new();
    for reader in readers::all(folder.path()) {
        assert!(!reader.seeds.is_empty(), "{} has no files to begin with", reader.name);
        for (number, seed) in reader.seeds.iter().enumerate() {
            let message = (reader.read)(seed).err().map(|error| error.to_string());
            let sound = message.as_ref().is_none_or(|said| reader.lacks.iter().any(|lacks| said.contains(lacks)));
            refused.extend(message.filter(|_| !sound).map(|said| format!("{} {number}: {said}", reader.name)));
        }
    }
    assert!(refused.is_empty(), "{}", refused.join("\n"));
}

#[test]
#[ignore = "a minute; the nightly run has it"]
fn damaged_files_are_refused_in_a_sentence() {
    let folder = work_folder();
    let only = std::env::var("AUGNERF_FUZZ_READER").unwrap_or_default();
    let readers: Vec<Reader> =
        readers::all(folder.path()).into_iter().filter(|reader| reader.name.contains(&only)).collect();
    let seconds = setting("AUGNERF_FUZZ_SECONDS", 60) as f64 / readers.len() as f64;
    let share = std::env::var_os("AUGNERF_FUZZ_INPUTS").is_none().then(|| Duration::from_secs_f64(seconds));
    let watch = Watch::new();
    std::panic::set_hook(Box::new(|panic| PANIC.with_borrow_mut(|text| *text = panic.to_string())));
    println!("reader                      inputs       us slowest/ms  most/MiB  refused/% failures");
    let mut failed = Vec::new();
    for reader in &readers {
        let tally = attack(reader, share, &watch);
        println!("{}", tally.line(reader.name));
        tally.failures.iter().for_each(|failure| println!("    {failure}"));
        failed.extend(tally.failures);
    }
    drop(std::panic::take_hook());
    assert!(failed.is_empty(), "{} inputs are not refused as they should be", failed.len());
}
