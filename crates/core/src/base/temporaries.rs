//! The names of files and folders until they are complete, and the cleaning up after killed processes.

use std::collections::hash_map::RandomState;
use std::ffi::{OsStr, OsString};
use std::fs::{self, File, TryLockError};
use std::hash::BuildHasher;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::base::{Error, Result};

/// Prefix of the names of unfinished entries.
pub const TEMPORARY: &str = ".augnerf-tmp-";
/// Prefix of the names of folders that were moved aside while their replacement took their name.
pub const REPLACED: &str = ".augnerf-old-";

/// Cleans up what killed processes left in `dir` (not below it), and returns the number of entries. Unfinished files
/// and folders are deleted. A folder that was moved aside is moved back if its replacement did not arrive. If the file
/// system has no locks, call it only while holding the run's lock and without writes of your own.
pub fn clean_temporaries(dir: &Path) -> Result<usize> {
    clean_where(dir, |_| true).map_err(|error| Error::unwritable(dir, &error))
}

/// Cleans up entries that were to have a `chosen` name.
pub(super) fn clean_where(dir: &Path, chosen: impl Fn(&OsStr) -> bool) -> io::Result<usize> {
    let mut cleaned = 0;
    for entry in fs::read_dir(dir)? {
        let path = entry?.path();
        let Some(name) = path.file_name() else { continue };
        let replaced = after_prefix(REPLACED, name);
        let Some(intended) = replaced.clone().or_else(|| intended_name(name)) else { continue };
        if !chosen(&intended) {
            continue;
        }
        // Locked until it is deleted, so that a process that just made it notices.
        let Ok(_held) = hold_leftover(&path) else { continue };
        let original = dir.join(intended);
        match replaced {
            Some(_) if original.symlink_metadata().is_err() => fs::rename(&path, &original)?,
            Some(_) => discard(&path)?,
            None => remove(&path)?,
        }
        cleaned += 1;
    }
    Ok(cleaned)
}

/// Returns whether an entry of this name is a leftover of a killed process.
pub fn is_temporary(name: &OsStr) -> bool {
    let bytes = name.as_encoded_bytes();
    bytes.starts_with(TEMPORARY.as_bytes()) || bytes.starts_with(REPLACED.as_bytes())
}

/// Deletes a file or folder, or a symbolic link itself. It is no error if it does not exist, or if another process
/// deletes it meanwhile.
pub fn remove(path: &Path) -> io::Result<()> {
    let removed = path.symlink_metadata().and_then(|found| match found.is_dir() {
        true => fs::remove_dir_all(path),
        false => fs::remove_file(path),
    });
    removed.or_else(|error| if error.kind() == io::ErrorKind::NotFound { Ok(()) } else { Err(error) })
}

/// Deletes an entry completely: a kill leaves all of it or nothing. The entry loses its name first.
pub fn discard(path: &Path) -> io::Result<()> {
    match path.symlink_metadata() {
        Ok(_) => {
            let aside = temporary_beside(path)?;
            fs::rename(path, &aside)?;
            remove(&aside)
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(error),
    }
}

/// Locks a file or folder while the value lives. Returns `None` if that is not possible.
pub fn hold(path: &Path) -> Option<File> {
    File::open(path).ok().filter(|file| file.try_lock().is_ok())
}

/// Waits for the lock of a file or folder and takes it.
pub fn wait_and_hold(path: &Path) -> Option<File> {
    File::open(path).ok().filter(|file| file.lock().is_ok())
}

/// Another process works on the entry.
struct Held;

/// Locks what a killed process left. Returns `None` if the file system has no locks.
fn hold_leftover(path: &Path) -> std::result::Result<Option<File>, Held> {
    // Opening a pipe would wait.
    let can_be_opened = path.symlink_metadata().is_ok_and(|found| found.is_file() || found.is_dir());
    let Some(file) = can_be_opened.then(|| File::open(path).ok()).flatten() else { return Ok(None) };
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => Err(Held),
        _ => Ok(Some(file)),
    }
}

/// Makes an entry next to `target`, and locks it through its `file` if the file system has locks. Between the two,
/// another process may treat it as a leftover and delete it. Then it is made again.
pub(super) fn held_beside<T>(
    target: &Path,
    make: impl Fn(&Path) -> io::Result<T>,
    file: impl Fn(&T) -> Option<&File>,
) -> io::Result<(PathBuf, T)> {
    loop {
        let path = temporary_beside(target)?;
        let made = make(&path)?;
        // Waits for a process that is deleting it.
        let _ = file(&made).map(File::lock);
        if path.symlink_metadata().is_ok() {
            return Ok((path, made));
        }
    }
}

/// Returns a name beside `target` that no other process has.
pub fn temporary_beside(target: &Path) -> io::Result<PathBuf> {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    // Not the process's number: processes in containers have equal ones.
    static PROCESS: LazyLock<u64> = LazyLock::new(|| RandomState::new().hash_one("process"));
    let count = COUNT.fetch_add(1, Ordering::Relaxed);
    let prefix = format!("{TEMPORARY}{}-{count}-", *PROCESS);
    Ok(folder_of(target).join(prefixed(&prefix, name_of(target)?)))
}

pub(super) fn name_of(path: &Path) -> io::Result<&OsStr> {
    path.file_name().ok_or_else(|| io::Error::other("the path does not end in a name"))
}

pub(super) fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

pub(super) fn prefixed(prefix: &str, name: &OsStr) -> OsString {
    let mut joined = OsString::from(prefix);
    joined.push(name);
    joined
}

/// Returns the name that a temporary entry was to have: the part after the numbers of process and entry. Other names,
/// such as a probe's, are returned unchanged.
fn intended_name(temporary: &OsStr) -> Option<OsString> {
    let rest = after_prefix(TEMPORARY, temporary)?;
    let is_number = |part: &[u8]| !part.is_empty() && part.iter().all(u8::is_ascii_digit);
    let parts: Vec<&[u8]> = rest.as_encoded_bytes().splitn(3, |byte| *byte == b'-').collect();
    match parts[..] {
        [process, count, name] if is_number(process) && is_number(count) && !name.is_empty() => {
            let numbers = format!("{}-{}-", String::from_utf8_lossy(process), String::from_utf8_lossy(count));
            after_prefix(&numbers, &rest)
        }
        _ => Some(rest),
    }
}

fn after_prefix(prefix: &str, name: &OsStr) -> Option<OsString> {
    let rest = name.as_encoded_bytes().strip_prefix(prefix.as_bytes())?;
    // SAFETY: the bytes come from `as_encoded_bytes`, cut directly after a non-empty UTF-8 prefix.
    Some(unsafe { OsStr::from_encoded_bytes_unchecked(rest) }.to_os_string())
}

/// Returns the names of a folder's entries, in order.
#[cfg(test)]
pub(super) fn names(dir: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::files::{AtomicDir, write_atomic};

    #[test]
    fn what_kills_left_is_put_right() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        fs::write(at(".augnerf-tmp-1-0-metrics.json"), "half").unwrap();
        fs::create_dir(at(".augnerf-tmp-1-1-step-20")).unwrap();
        fs::create_dir(at(".augnerf-old-step-10")).unwrap();
        fs::create_dir(at(".augnerf-old-step-15")).unwrap();
        fs::create_dir(at("step-15")).unwrap();
        fs::write(at(".hidden"), "not ours").unwrap();
        assert_eq!(clean_temporaries(dir.path()).unwrap(), 4);
        assert_eq!(names(dir.path()), [".hidden", "step-10", "step-15"]);
    }

    #[test]
    fn what_is_being_written_is_no_leftover() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("step-10");
        let working = AtomicDir::new(&target).unwrap();
        fs::write(working.path().join("weights"), "half").unwrap();
        assert_eq!(clean_temporaries(dir.path()).unwrap(), 0);
        // Another one of the same name, as of another process.
        AtomicDir::new(&target).unwrap().commit().unwrap();
        working.commit().unwrap();
        assert_eq!(fs::read_to_string(target.join("weights")).unwrap(), "half");
        assert_eq!(names(dir.path()), ["step-10"]);
    }

    #[test]
    fn nothing_is_taken_for_a_leftover_while_many_clean() {
        let dir = tempfile::tempdir().unwrap();
        let over = std::sync::atomic::AtomicBool::new(false);
        std::thread::scope(|scope| {
            for _ in 0..3 {
                scope.spawn(|| {
                    while !over.load(Ordering::Relaxed) {
                        clean_temporaries(dir.path()).unwrap();
                    }
                });
            }
            // Few names, so that cleaning is quick and meets what is just being made.
            let written = (0..500).try_for_each(|turn| {
                write_atomic(&dir.path().join("a"), b"whole")?;
                AtomicDir::new(&dir.path().join(format!("folder-{}", turn % 8)))?.commit()
            });
            over.store(true, Ordering::Relaxed);
            written.unwrap();
        });
    }

    #[test]
    fn leftovers_beside_a_folder_go_when_it_is_written_again() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("pictures");
        for leftover in [".augnerf-tmp-77-3-pictures", ".augnerf-tmp-78-0-pictures", ".augnerf-tmp-77-4-others"] {
            fs::create_dir(dir.path().join(leftover)).unwrap();
        }
        AtomicDir::vacant(&target).unwrap().commit().unwrap();
        assert_eq!(names(dir.path()), [".augnerf-tmp-77-4-others", "pictures"], "another name is another's");
    }

    /// Two processes of one number, as in two containers, write the same file: the names of one are not the other's.
    #[test]
    fn names_do_not_follow_from_the_process_number() {
        let name = temporary_beside(Path::new("a")).unwrap();
        let name = name.file_name().unwrap().to_str().unwrap();
        assert!(!name.contains(&format!("-{}-", std::process::id())), "{name}");
        assert_eq!(intended_name(OsStr::new(name)), Some("a".into()));
        assert_ne!(name, temporary_beside(Path::new("a")).unwrap().to_str().unwrap());
    }
}
