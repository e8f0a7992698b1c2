//! The lock of a run folder.

use std::fs::{File, TryLockError};
use std::io::{Read, Write};
use std::path::Path;
use std::time::Duration;

use crate::base::{Error, Result};

/// The file that is locked.
pub const LOCK: &str = "run.lock";

/// A run folder locked by this process. The operating system releases the lock however the process ends, so no stale
/// lock can remain. On a file system without locks it does nothing.
#[derive(Debug)]
pub struct RunLock {
    _file: File,
}

impl RunLock {
    /// Locks the run folder `path`, or returns an error that names the holder.
    pub fn acquire(path: &Path) -> Result<RunLock> {
        let name = path.join(LOCK);
        let mut file = File::options()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&name)
            .map_err(|error| Error::unwritable(&name, &error))?;
        match (0..LOOKS).find_map(|_| taken(&file)).unwrap_or(Err(TryLockError::WouldBlock)) {
            Ok(()) => {
                // Only for the message below; a failure to write it changes nothing.
                let _ = file.set_len(0).and_then(|()| write!(file, "{}", std::process::id()));
            }
            Err(TryLockError::WouldBlock) => return Err(locked(path, &mut file)),
            Err(TryLockError::Error(_)) => {}
        }
        Ok(RunLock { _file: file })
    }

    /// Keeps others from training in a run that this process can only read; `None` if there is nothing to lock.
    pub fn share(path: &Path) -> Result<Option<RunLock>> {
        let Ok(mut file) = File::open(path.join(LOCK)) else { return Ok(None) };
        match file.try_lock_shared() {
            Ok(()) => Ok(Some(RunLock { _file: file })),
            Err(TryLockError::WouldBlock) => Err(locked(path, &mut file)),
            Err(TryLockError::Error(_)) => Ok(None),
        }
    }

    /// Returns who holds the run folder `path`, or `None` if it is free or its lock cannot be opened. A free run is locked
    /// for a moment.
    pub fn holder(path: &Path) -> Option<String> {
        let mut file = File::options().read(true).write(true).open(path.join(LOCK)).ok()?;
        matches!(file.try_lock(), Err(TryLockError::WouldBlock)).then(|| named(&mut file))
    }
}

/// Attempts to lock a run that another process only looks at, as [`RunLock::holder`] does.
const LOOKS: usize = 20;

/// Locks a file, or returns `None` a little later if another process holds it.
fn taken(file: &File) -> Option<std::result::Result<(), TryLockError>> {
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => {
            std::thread::sleep(Duration::from_millis(1));
            None
        }
        done => Some(done),
    }
}

/// Returns the process that a lock file names.
fn named(file: &mut File) -> String {
    let mut holder = String::new();
    let known = file.take(64).read_to_string(&mut holder).is_ok() && !holder.is_empty();
    if known { format!("process {holder}") } else { "another process".to_string() }
}

fn locked(path: &Path, file: &mut File) -> Error {
    Error::InUse(format!(
        "{} is in use by {}, which trains in it or reads it; wait for it, or give a new run another --out",
        path.display(),
        named(file)
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_held_run_is_in_use_and_names_its_holder() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(RunLock::holder(dir.path()), None, "no lock file yet");
        let held = RunLock::acquire(dir.path()).unwrap();
        let own = format!("process {}", std::process::id());
        assert_eq!(RunLock::holder(dir.path()), Some(own.clone()));
        let error = RunLock::acquire(dir.path()).unwrap_err();
        assert!(matches!(&error, Error::InUse(text) if text.contains(&own)), "{error}");
        assert_eq!(error.exit_code(), 4);
        drop(held);
        assert_eq!(RunLock::holder(dir.path()), None);
        // Readers of a run that they cannot write keep a trainer away, too.
        let _shared = RunLock::share(dir.path()).unwrap().unwrap();
        assert!(RunLock::holder(dir.path()).is_some());
    }
}
