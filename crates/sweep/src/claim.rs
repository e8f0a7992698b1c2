//! Who works on a point. Runners on one machine are kept apart by the operating system's lock,
//! which dies with its process; runners on several, and on file systems without locks, by
//! `claim.json`, which appears whole or not at all and whose heartbeat says that its runner lives. Clocks of machines differ:
//! whoever wants such a claim watches whether it changes, by a clock of its own.

use std::collections::{HashMap, HashSet};
use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

use serde::{Deserialize, Serialize};

use crate::base::files::{create_whole, json_bytes, write_json};
use crate::base::input::{TEXT_BYTES, read_bytes};
use crate::base::{Error, Result};
use crate::runtime::host_name;

const LOCK: &str = "claim.lock";
pub(super) const CLAIM: &str = "claim.json";
/// Between two heartbeats.
const BEAT: Duration = Duration::from_secs(5);
/// A claim that no lock speaks for is dead after so long without a heartbeat.
const DEAD_AFTER: Duration = Duration::from_secs(180);
/// The same of one whose date says that it is so old: the date alone may be that of a clock that is behind.
const OLD_IS_DEAD_AFTER: Duration = Duration::from_secs(16);
/// Two runners that take over the claim of a dead third see within this who wrote last.
const SETTLING: Duration = Duration::from_secs(2);

/// `claim.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Sign {
    host: String,
    pid: u32,
    /// Tells this claim from every other.
    #[serde(default)]
    nonce: u64,
    step: u64,
    steps: u64,
    /// Seconds since the claim.
    seconds: f64,
    /// Step at the claim: a rate needs it, and a later first step is progress.
    first: u64,
    /// Runners that died with this point, one after the other, none of them further than the one before.
    deaths: u32,
}

/// A claim as another process sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct Claimed {
    /// The runner's machine.
    pub host: String,
    /// The runner's process.
    pub pid: u32,
    /// Steps finished at the last heartbeat.
    pub step: u64,
    /// Steps in all; 0 until training begins.
    pub steps: u64,
    /// Seconds that are left by the rate so far; none until there is one.
    pub seconds_left: Option<f64>,
    /// Runners that died with this point.
    pub deaths: u32,
    /// The runner works on it, as far as locks and dates say.
    pub alive: bool,
    /// Its date lies in the future: whether its runner lives takes minutes to tell.
    pub ahead: bool,
}

impl Claimed {
    /// The runner, for a person, and what stands against believing in it.
    pub fn who(&self) -> String {
        let Claimed { host, pid, .. } = self;
        let minutes = DEAD_AFTER.as_secs() / 60;
        match (self.ahead, self.alive) {
            (true, _) => format!(
                "{host} (process {pid}; its claim is dated in the future, so that a runner takes it over when it has not \
                 changed for {minutes} minutes)"
            ),
            (false, true) => format!("{host} (process {pid})"),
            (false, false) => {
                format!("{host} (process {pid}; it seems to be dead, and is watched before it is taken over)")
            }
        }
    }
}

/// How far a point is, written by its training and read by the heartbeat.
#[derive(Debug, Default)]
pub struct Beat {
    step: AtomicU64,
    steps: AtomicU64,
    first: AtomicU64,
}

impl Beat {
    /// Training begins at step `first` of `steps`.
    pub fn begin(&self, first: u64, steps: u64) {
        self.first.store(first, Ordering::Relaxed);
        self.steps.store(steps, Ordering::Relaxed);
        self.step.store(first, Ordering::Relaxed);
    }

    /// Training was over when this runner took the point: all that it does is to measure it.
    pub fn only_evaluates(&self) -> bool {
        let [first, steps] = [&self.first, &self.steps].map(|value| value.load(Ordering::Relaxed));
        steps > 0 && first == steps
    }

    /// A step is done.
    pub fn stepped(&self, step: u64) {
        self.step.store(step, Ordering::Relaxed);
    }
}

/// What one process saw of claims that no lock speaks for.
#[derive(Debug)]
pub struct Watch {
    /// How long a claim may stay as it is, and how long where its date says that it is old.
    patience: [Duration; 2],
    /// Each as it was when it was last seen to change, and when that was.
    seen: Mutex<HashMap<PathBuf, (Vec<u8>, Instant)>>,
    /// Those that were seen to change.
    changed: Mutex<HashSet<PathBuf>>,
    /// Those whose lock was held at the last look.
    locked: Mutex<HashSet<PathBuf>>,
}

impl Default for Watch {
    fn default() -> Watch {
        Watch::with_patience(DEAD_AFTER, OLD_IS_DEAD_AFTER)
    }
}

impl Watch {
    /// One that takes a claim for dead after `quiet` without a change, or after `old` where its date says that it is old.
    pub fn with_patience(quiet: Duration, old: Duration) -> Watch {
        Watch { patience: [quiet, old], seen: Mutex::default(), changed: Mutex::default(), locked: Mutex::default() }
    }

    /// Whether a claim has not changed for so long that its runner must be dead. The first look at one never says so.
    fn is_dead(&self, file: &Path) -> bool {
        // Where it just went, its runner was alive.
        let Ok(now) = read_bytes(file, TEXT_BYTES) else { return false };
        let [quiet, old] = self.patience;
        let patience = if pulse(file) == Pulse::Old { old } else { quiet };
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        match seen.get(file) {
            Some((before, since)) if *before == now => since.elapsed() >= patience,
            before => {
                if before.is_some() {
                    self.changed.lock().unwrap_or_else(PoisonError::into_inner).insert(file.to_path_buf());
                }
                seen.insert(file.to_path_buf(), (now, Instant::now()));
                false
            }
        }
    }

    /// Whether the runner that has the point in `folder` surely lives. One of this machine holds the lock in two looks, one after
    /// the other (who only looks at a claim holds it for a moment). One elsewhere was seen to beat: file systems may keep the
    /// lock of a machine that died.
    pub(super) fn sees_life(&self, folder: &Path) -> bool {
        let file = folder.join(CLAIM);
        let here = read(&file).is_some_and(|sign| sign.host == host_name());
        let mut locked = self.locked.lock().unwrap_or_else(PoisonError::into_inner);
        if here && is_locked(&folder.join(LOCK)) == Some(true) {
            return !locked.insert(file);
        }
        locked.remove(&file);
        self.is_dead(&file);
        self.changed.lock().unwrap_or_else(PoisonError::into_inner).contains(&file)
    }
}

/// What the date of a claim says, next to this machine's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pulse {
    Beats,
    Old,
    /// Dated further ahead than a beat is long: one of the clocks is wrong.
    Ahead,
}

fn pulse(file: &Path) -> Pulse {
    let Ok(at) = fs::metadata(file).and_then(|metadata| metadata.modified()) else { return Pulse::Old };
    match SystemTime::now().duration_since(at) {
        Ok(age) if age < DEAD_AFTER => Pulse::Beats,
        Ok(_) => Pulse::Old,
        Err(ahead) if ahead.duration() < DEAD_AFTER => Pulse::Beats,
        Err(_) => Pulse::Ahead,
    }
}

/// A point taken by this process until the value is dropped.
#[derive(Debug)]
pub struct Claim {
    file: PathBuf,
    _lock: File,
    nonce: u64,
    /// How far the point is.
    pub beat: Arc<Beat>,
    /// Runners that died with this point before without getting further than the first of them.
    pub deaths: u32,
    /// Where the last of them had begun.
    died_from: u64,
    over: Arc<AtomicBool>,
    heart: Option<JoinHandle<()>>,
}

impl Claim {
    /// Takes the point in `folder` unless another runner works on it. The claim of a runner on another machine is taken over
    /// once `watch` has seen that it no longer changes: ask again.
    pub fn take(folder: &Path, watch: &Watch) -> Result<Option<Claim>> {
        let path = folder.join(LOCK);
        let lock = File::options().create(true).truncate(false).write(true).open(&path);
        let lock = lock.map_err(|e| Error::unwritable(&path, &e))?;
        let locked = match lock.try_lock() {
            Ok(()) => true,
            Err(TryLockError::WouldBlock) => return Ok(None),
            Err(TryLockError::Error(error)) if error.kind() == std::io::ErrorKind::Unsupported => false,
            Err(TryLockError::Error(error)) => return Err(Error::unwritable(&path, &error)),
        };
        let mut claim = Claim {
            file: folder.join(CLAIM),
            _lock: lock,
            nonce: nonce(),
            beat: Arc::default(),
            deaths: 0,
            died_from: 0,
            over: Arc::default(),
            heart: None,
        };
        if !claim.sign_first(locked, watch)? {
            return Ok(None);
        }
        claim.heart = Some(claim.start_heart());
        Ok(Some(claim))
    }

    /// Writes `claim.json` unless a living runner has.
    fn sign_first(&mut self, locked: bool, watch: &Watch) -> Result<bool> {
        if !self.file.exists() {
            return self.create();
        }
        let sign = read(&self.file);
        // The lock speaks for this machine's runners; the heartbeat for all others.
        let unseen = !locked || sign.as_ref().is_none_or(|sign| sign.host != host_name());
        if unseen && !watch.is_dead(&self.file) {
            return Ok(false);
        }
        if let Some(sign) = sign {
            (self.deaths, self.died_from) = (sign.deaths + 1, sign.first);
        }
        self.signer()(0.0)?;
        if unseen {
            std::thread::sleep(SETTLING);
        }
        Ok(self.holds())
    }

    /// Creates `claim.json`, whole, unless another runner just did.
    fn create(&self) -> Result<bool> {
        match json_bytes(&self.sign(0.0)).and_then(|bytes| create_whole(&self.file, &bytes)) {
            Ok(created) => Ok(created),
            // No hard links here: the lock, or settling, has to do.
            Err(_) => self.signer()(0.0).map(|()| self.holds()),
        }
    }

    /// Whether the point is still this runner's: another one takes over what has not beaten for minutes, as after a
    /// machine was suspended.
    pub fn holds(&self) -> bool {
        read(&self.file).is_some_and(|sign| sign.nonce == self.nonce)
    }

    /// `claim.json` as the next heartbeat writes it.
    pub fn signed(&self) -> String {
        serde_json::to_string(&self.sign(0.0)).expect("plain data")
    }

    fn sign(&self, seconds: f64) -> Sign {
        sign(&self.beat, (self.nonce, self.deaths, self.died_from), seconds)
    }

    /// What writes `claim.json`, given the seconds since the claim.
    fn signer(&self) -> impl Fn(f64) -> Result<()> + Send + 'static {
        let (file, beat) = (self.file.clone(), self.beat.clone());
        let who = (self.nonce, self.deaths, self.died_from);
        move |seconds| write_json(&file, &sign(&beat, who, seconds))
    }

    fn start_heart(&self) -> JoinHandle<()> {
        let (over, file, nonce, signed) = (self.over.clone(), self.file.clone(), self.nonce, self.signer());
        let started = std::time::Instant::now();
        std::thread::spawn(move || {
            while !over.load(Ordering::Relaxed) {
                std::thread::park_timeout(BEAT);
                let own = read(&file).is_some_and(|sign| sign.nonce == nonce);
                if own && !over.load(Ordering::Relaxed) {
                    // A full disk shows where results are written; a missed beat does no harm.
                    let _ = signed(started.elapsed().as_secs_f64());
                }
            }
        })
    }

    /// Who works on the point in `folder`, or did when they died; none where nobody does.
    pub fn look(folder: &Path) -> Option<Claimed> {
        let file = folder.join(CLAIM);
        let sign = read(&file)?;
        let here = sign.host == host_name();
        let pulse = pulse(&file);
        let locked = if here { is_locked(&folder.join(LOCK)) } else { None };
        let alive = locked.unwrap_or(pulse == Pulse::Beats);
        let done = sign.step.saturating_sub(sign.first);
        let left = sign.steps.saturating_sub(sign.step);
        Some(Claimed {
            seconds_left: (done > 0).then(|| sign.seconds * left as f64 / done as f64),
            host: sign.host,
            pid: sign.pid,
            step: sign.step,
            steps: sign.steps,
            deaths: sign.deaths,
            alive,
            ahead: locked.is_none() && pulse == Pulse::Ahead,
        })
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        if let Some(heart) = self.heart.take() {
            heart.thread().unpark();
            let _ = heart.join();
        }
        // Before the lock goes: whoever takes it next finds no trace of a death.
        if self.holds() {
            let _ = fs::remove_file(&self.file);
        }
    }
}

fn sign(beat: &Beat, (nonce, deaths, died_from): (u64, u32, u64), seconds: f64) -> Sign {
    let load = |value: &AtomicU64| value.load(Ordering::Relaxed);
    let (step, steps, first) = (load(&beat.step), load(&beat.steps), load(&beat.first));
    let further = steps > 0 && first > died_from;
    // Until training begins the point is where the last one left it.
    let first = if steps > 0 { first } else { died_from };
    let deaths = if further { 0 } else { deaths };
    Sign { host: host_name(), pid: std::process::id(), nonce, step: step.max(first), steps, seconds, first, deaths }
}

/// A number that no other claim has.
fn nonce() -> u64 {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let nanoseconds = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default().as_nanos() as u64;
    nanoseconds ^ (u64::from(std::process::id()) << 40) ^ (COUNT.fetch_add(1, Ordering::Relaxed) << 32)
}

fn read(file: &Path) -> Option<Sign> {
    serde_json::from_slice(&read_bytes(file, TEXT_BYTES).ok()?).ok()
}

/// None where the file system has no locks.
fn is_locked(path: &Path) -> Option<bool> {
    let Ok(file) = File::open(path) else { return Some(false) };
    match file.try_lock_shared() {
        Ok(()) => Some(false),
        Err(TryLockError::WouldBlock) => Some(true),
        Err(TryLockError::Error(_)) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lock_speaks_for_this_machine_alone_and_a_heartbeat_for_any() {
        let dir = tempfile::tempdir().unwrap();
        let (watch, folder) = (Watch::default(), dir.path());
        let lock = File::create(folder.join(LOCK)).unwrap();
        lock.try_lock().unwrap();
        let say = |host: String, step: u64| {
            let sign = Sign { host, pid: 7, nonce: 1, step, steps: 9, seconds: 1.0, first: 0, deaths: 0 };
            write_json(&folder.join(CLAIM), &sign).unwrap();
        };
        assert!(!watch.sees_life(folder), "whoever has the lock has not said who it is");
        say("elsewhere".into(), 1);
        assert!((0..3).all(|_| !watch.sees_life(folder)), "it may be the lock of the dead");
        say("elsewhere".into(), 2);
        assert!(watch.sees_life(folder));
        let watch = Watch::default();
        say(host_name(), 1);
        assert!(!watch.sees_life(folder), "one look may meet another's");
        assert!(watch.sees_life(folder));
        let watch = Watch::default();
        drop(lock);
        assert!((0..3).all(|_| !watch.sees_life(folder)), "it is dead");
    }
}
