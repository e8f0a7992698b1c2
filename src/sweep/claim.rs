//! Who works on a point. Runners on one machine are kept apart by the operating system's lock,
//! which dies with its process; runners on several by a heartbeat beside it, for file systems
//! whose locks do not reach that far.

use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime};

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::output::{host_name, write_json};

const LOCK: &str = "claim.lock";
const CLAIM: &str = "claim.json";
/// Between two heartbeats.
const BEAT: Duration = Duration::from_secs(5);
/// A claim of another machine without a heartbeat for so long is dead.
const DEAD_AFTER: Duration = Duration::from_secs(180);

/// `claim.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Sign {
    host: String,
    pid: u32,
    step: u64,
    steps: u64,
    /// Seconds since the claim.
    seconds: f64,
    /// Step at the claim: a rate needs it.
    first: u64,
    /// Runners that died with this point, one after the other.
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
    /// The runner works on it.
    pub alive: bool,
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

    /// A step is done.
    pub fn stepped(&self, step: u64) {
        self.step.store(step, Ordering::Relaxed);
    }
}

/// A point taken by this process until the value is dropped.
#[derive(Debug)]
pub struct Claim {
    file: PathBuf,
    _lock: File,
    /// How far the point is.
    pub beat: Arc<Beat>,
    /// Runners that died with this point before.
    pub deaths: u32,
    over: Arc<AtomicBool>,
    heart: Option<JoinHandle<()>>,
}

impl Claim {
    /// Takes the point in `folder` unless another runner works on it.
    pub fn take(folder: &Path) -> Result<Option<Claim>> {
        let path = folder.join(LOCK);
        let lock = File::options().create(true).truncate(false).write(true).open(&path);
        let lock = lock.map_err(|e| Error::unwritable(&path, &e))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Ok(None),
            Err(TryLockError::Error(error)) if error.kind() == std::io::ErrorKind::Unsupported => {}
            Err(TryLockError::Error(error)) => return Err(Error::unwritable(&path, &error)),
        }
        let file = folder.join(CLAIM);
        let deaths = match read(&file) {
            // Held by a lock that this machine cannot see.
            Some(sign) if sign.host != host_name() && beats(&file) => return Ok(None),
            Some(sign) => sign.deaths + 1,
            None => 0,
        };
        let mut claim = Claim { file, _lock: lock, beat: Arc::default(), deaths, over: Arc::default(), heart: None };
        let signed = claim.signer();
        signed(0.0)?;
        claim.heart = Some(claim.start_heart(signed));
        Ok(Some(claim))
    }

    /// What writes `claim.json`, given the seconds since the claim.
    fn signer(&self) -> impl Fn(f64) -> Result<()> + Send + 'static {
        let (file, beat, deaths) = (self.file.clone(), self.beat.clone(), self.deaths);
        let (host, pid) = (host_name(), std::process::id());
        move |seconds| {
            let load = |value: &AtomicU64| value.load(Ordering::Relaxed);
            let (step, steps, first) = (load(&beat.step), load(&beat.steps), load(&beat.first));
            write_json(&file, &Sign { host: host.clone(), pid, step, steps, seconds, first, deaths })
        }
    }

    fn start_heart(&self, sign: impl Fn(f64) -> Result<()> + Send + 'static) -> JoinHandle<()> {
        let over = self.over.clone();
        let started = std::time::Instant::now();
        std::thread::spawn(move || {
            while !over.load(Ordering::Relaxed) {
                std::thread::park_timeout(BEAT);
                if !over.load(Ordering::Relaxed) {
                    // A full disk shows where results are written; a missed beat does no harm.
                    let _ = sign(started.elapsed().as_secs_f64());
                }
            }
        })
    }

    /// Who works on the point in `folder`, or did when they died; none where nobody does.
    pub fn look(folder: &Path) -> Option<Claimed> {
        let file = folder.join(CLAIM);
        let sign = read(&file)?;
        let alive = if sign.host == host_name() { is_locked(&folder.join(LOCK)) } else { beats(&file) };
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
        let _ = fs::remove_file(&self.file);
    }
}

fn read(file: &Path) -> Option<Sign> {
    serde_json::from_slice(&fs::read(file).ok()?).ok()
}

fn beats(file: &Path) -> bool {
    let modified = fs::metadata(file).and_then(|metadata| metadata.modified());
    modified.is_ok_and(|at| SystemTime::now().duration_since(at).unwrap_or_default() < DEAD_AFTER)
}

fn is_locked(path: &Path) -> bool {
    File::open(path).is_ok_and(|file| matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)))
}
