//! Who works on a point. A worker holds the operating system's lock of `claim.lock`, which ends with its process. It notes in
//! `claim.json` how far it is, for `sweep status`. Several machines are kept apart by a scheduler, or by a file system whose
//! locks cross machines.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use crate::base::files::{check_own, read_json, write_json};
use crate::base::{Error, Result};
use crate::runtime::host_name;

const LOCK: &str = "claim.lock";
pub(super) const CLAIM: &str = "claim.json";
/// Between two notes on how far a point is.
const NOTE_EVERY: Duration = Duration::from_secs(5);

/// How workers divide the points of a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sharing {
    /// By locks. A worker waits for points that others hold. A file system without locks is an error.
    Locks,
    /// By a scheduler, which gives each point to one task. A point that another worker holds is left to it.
    Scheduler,
}

/// `claim.json`. Older programs wrote more into it, and it is read all the same.
#[derive(Debug, Serialize, Deserialize)]
struct Note {
    host: String,
    pid: u32,
    step: u64,
    /// 0 until training begins.
    steps: u64,
    /// Seconds since training began.
    seconds: f64,
    /// The step at which it began.
    first: u64,
}

/// A claim as another process sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct Claimed {
    /// The worker's machine.
    pub host: String,
    /// The worker's process.
    pub pid: u32,
    /// Finished steps at the last note.
    pub step: u64,
    /// Steps in all; 0 until training begins.
    pub steps: u64,
    /// Seconds that are left by the rate so far; none until there is one.
    pub seconds_left: Option<f64>,
    /// The lock is held, or the file system has no locks that could tell.
    pub alive: bool,
}

impl Claimed {
    /// The worker, for a person.
    pub fn who(&self) -> String {
        format!("{} (process {})", self.host, self.pid)
    }

    /// What became of a worker whose lock is free.
    pub fn fate(&self) -> String {
        let elsewhere = if self.host == host_name() { "" } else { ", or this machine cannot see its lock" };
        format!("its worker, {}, was killed at step {}{elsewhere}", self.who(), self.step)
    }
}

/// How far a point is. Its training says so; now and then it is noted for other processes.
#[derive(Debug)]
pub struct Progress {
    file: PathBuf,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    first: u64,
    step: u64,
    steps: u64,
    begun: Instant,
    noted: Instant,
}

impl Progress {
    fn new(file: PathBuf) -> Progress {
        let now = Instant::now();
        Progress { file, state: Mutex::new(State { first: 0, step: 0, steps: 0, begun: now, noted: now }) }
    }

    /// Training begins at step `first` of `steps`.
    pub fn begin(&self, first: u64, steps: u64) {
        let mut state = self.state();
        *state = State { first, step: first, steps, begun: Instant::now(), ..*state };
        self.note_if_possible(&mut state);
    }

    /// A step is done.
    pub fn stepped(&self, step: u64) {
        let mut state = self.state();
        state.step = step;
        if step == state.steps || state.noted.elapsed() >= NOTE_EVERY {
            self.note_if_possible(&mut state);
        }
    }

    /// Training was over when this worker took the point: only its evaluation is left.
    pub fn only_evaluates(&self) -> bool {
        let state = self.state();
        state.steps > 0 && state.first == state.steps
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A full disk is an error where results are written. A missing note does no harm.
    fn note_if_possible(&self, state: &mut State) {
        let _ = self.note(state);
    }

    fn note(&self, state: &mut State) -> Result<()> {
        state.noted = Instant::now();
        let State { first, step, steps, .. } = *state;
        let seconds = state.begun.elapsed().as_secs_f64();
        write_json(&self.file, &Note { host: host_name(), pid: std::process::id(), step, steps, seconds, first })
    }
}

/// A point held by this process until the value is dropped.
#[derive(Debug)]
pub struct Claim {
    /// How far the point is.
    pub progress: Progress,
    /// False on a file system without locks: a scheduler alone keeps other workers away.
    pub is_locked: bool,
    _lock: File,
}

impl Claim {
    /// Takes the point in `folder`; none where another worker holds it.
    ///
    /// # Errors
    /// A folder that cannot be written, or with [`Sharing::Locks`] a file system without locks.
    pub fn take(folder: &Path, sharing: Sharing) -> Result<Option<Claim>> {
        check_own(folder, true)?;
        let path = folder.join(LOCK);
        check_own(&path, false)?;
        let lock = File::options().create(true).truncate(false).write(true).open(&path);
        let lock = lock.map_err(|e| Error::unwritable(&path, &e))?;
        let Some(is_locked) = accept(try_hold(&lock), sharing, folder)? else { return Ok(None) };
        let claim = Claim { progress: Progress::new(folder.join(CLAIM)), is_locked, _lock: lock };
        claim.progress.note(&mut claim.progress.state())?;
        Ok(Some(claim))
    }

    /// Who works on the point in `folder`, or did when they were killed; none where nobody does.
    pub fn look(folder: &Path) -> Option<Claimed> {
        let Note { host, pid, step, steps, seconds, first } = read_json(&folder.join(CLAIM), "").ok()??;
        let done = step.saturating_sub(first);
        let left = steps.saturating_sub(step);
        let seconds_left = (done > 0).then(|| seconds * left as f64 / done as f64);
        Some(Claimed { host, pid, step, steps, seconds_left, alive: is_held(&folder.join(LOCK)).unwrap_or(true) })
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        // Before the lock goes: the next worker finds no trace of a kill.
        let _ = fs::remove_file(&self.progress.file);
    }
}

/// Attempts to lock a file that others only look at: `sweep status` shares the lock for a moment.
const LOOKS: usize = 1000;

/// Locks a file, or returns false if another worker holds it. A process that shares the lock for long counts as a worker.
fn try_hold(file: &File) -> io::Result<bool> {
    for _ in 0..LOOKS {
        match file.try_lock() {
            Ok(()) => return Ok(true),
            Err(TryLockError::Error(error)) => return Err(error),
            Err(TryLockError::WouldBlock) => {}
        }
        match file.try_lock_shared() {
            Ok(()) => file.unlock()?,
            Err(TryLockError::WouldBlock) => return Ok(false),
            Err(TryLockError::Error(error)) => return Err(error),
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    Ok(false)
}

/// Whether a point may be worked on after an attempt to lock it, and if so, whether it is locked.
fn accept(held: io::Result<bool>, sharing: Sharing, folder: &Path) -> Result<Option<bool>> {
    match held {
        Ok(held) => Ok(held.then_some(true)),
        Err(_) if sharing == Sharing::Scheduler => Ok(Some(false)),
        Err(error) => Err(Error::Output(format!(
            "cannot lock {}: {error}; without locks two workers could train one point, so use `augnerf sweep slurm` or \
             `augnerf sweep run-point`, or --out on a local disk (with --seeds or --scenes of its own for each machine)",
            folder.display()
        ))),
    }
}

/// Returns whether another worker holds the point in `folder`.
pub(super) fn is_taken(folder: &Path) -> bool {
    is_held(&folder.join(LOCK)) == Some(true)
}

/// Returns whether a worker holds the lock, or none if that cannot be known: no permission, or a file system without locks.
fn is_held(path: &Path) -> Option<bool> {
    let file = match File::open(path) {
        Ok(file) => file,
        Err(error) => return (error.kind() == io::ErrorKind::NotFound).then_some(false),
    };
    match file.try_lock_shared() {
        Ok(()) => Some(false),
        Err(TryLockError::WouldBlock) => Some(true),
        Err(TryLockError::Error(_)) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `sweep status` looks while workers take points: nobody takes a look for a worker.
    #[test]
    fn a_free_point_is_taken_while_others_look() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path();
        drop(Claim::take(folder, Sharing::Locks).unwrap());
        let looking = File::open(folder.join(LOCK)).unwrap();
        looking.lock_shared().unwrap();
        std::thread::scope(|scope| {
            let taking = scope.spawn(|| Claim::take(folder, Sharing::Scheduler).unwrap().is_some());
            looking.unlock().unwrap();
            assert!(taking.join().unwrap());
        });
        let held = Claim::take(folder, Sharing::Locks).unwrap().unwrap();
        assert!(held.is_locked && is_held(&folder.join(LOCK)) == Some(true));
        assert!(Claim::take(folder, Sharing::Scheduler).unwrap().is_none());
        drop(held);
        assert_eq!(is_held(&folder.join(LOCK)), Some(false));
    }

    #[test]
    fn without_locks_only_a_scheduler_gives_points() {
        let attempt =
            |sharing| accept(Err(io::Error::from(io::ErrorKind::Unsupported)), sharing, Path::new("points/a"));
        assert_eq!(attempt(Sharing::Scheduler).unwrap(), Some(false));
        let error = attempt(Sharing::Locks).unwrap_err();
        assert_eq!(error.exit_code(), 4);
        for word in ["points/a", "unsupported", "sweep slurm", "run-point", "--out", "--seeds", "--scenes"] {
            assert!(error.to_string().contains(word), "{word}: {error}");
        }
    }

    #[test]
    fn a_note_says_how_far_a_point_is() {
        let dir = tempfile::tempdir().unwrap();
        let claim = Claim::take(dir.path(), Sharing::Locks).unwrap().unwrap();
        let look = || Claim::look(dir.path()).unwrap();
        assert_eq!((look().steps, look().pid, look().alive), (0, std::process::id(), true));
        claim.progress.begin(10, 100);
        assert_eq!((look().step, look().steps, look().seconds_left), (10, 100, None));
        claim.progress.stepped(11);
        assert_eq!(look().step, 10, "a note a step would be too many");
        claim.progress.state().noted -= NOTE_EVERY;
        claim.progress.stepped(40);
        assert!(look().step == 40 && look().seconds_left.is_some());
        claim.progress.stepped(100);
        assert_eq!((look().step, look().seconds_left), (100, Some(0.0)));
        assert!(!claim.progress.only_evaluates());
        claim.progress.begin(100, 100);
        assert!(claim.progress.only_evaluates());
    }
}
