//! The lock of a run folder.

use std::fs::{File, TryLockError};
use std::io::{Read, Write};
use std::path::Path;

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
        match file.try_lock() {
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
}

fn locked(path: &Path, file: &mut File) -> Error {
    let mut holder = String::new();
    let known = file.take(64).read_to_string(&mut holder).is_ok() && !holder.is_empty();
    let who = if known { format!("process {holder}") } else { "another process".to_string() };
    Error::Output(format!(
        "{} is in use by {who}, which trains in it or reads it; wait for it, or give a new run another --out",
        path.display()
    ))
}
