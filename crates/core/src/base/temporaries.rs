//! What files and folders are called until they are whole, and what becomes of those whose process was killed.

use std::ffi::{OsStr, OsString};
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use crate::base::{Error, Result};

/// Start of the names of entries that are not finished yet.
pub const TEMPORARY: &str = ".augnerf-tmp-";
/// Start of the names of folders that were moved aside while their replacement took their place.
pub const REPLACED: &str = ".augnerf-old-";

/// Puts right what killed processes left in `dir` (not below it) and returns how many entries
/// that were: unfinished files and folders are deleted, and a folder that had been moved aside is
/// moved back if its replacement did not arrive. Where the file system has no locks, call it only while holding the run's lock,
/// with no write of one's own under way.
pub fn clean_temporaries(dir: &Path) -> Result<usize> {
    clean_where(dir, |_| true).map_err(|error| Error::unwritable(dir, &error))
}

/// The same of entries that were to have a `chosen` name.
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
        // Held until it is gone, so that whoever made it just now finds out.
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

/// Whether an entry of this name is something that a killed process left behind.
pub fn is_temporary(name: &OsStr) -> bool {
    let bytes = name.as_encoded_bytes();
    bytes.starts_with(TEMPORARY.as_bytes()) || bytes.starts_with(REPLACED.as_bytes())
}

/// Deletes a file or folder (a symbolic link itself, not what it points to); absent is fine, and so is one that another
/// process deletes meanwhile.
pub fn remove(path: &Path) -> io::Result<()> {
    let removed = path.symlink_metadata().and_then(|found| match found.is_dir() {
        true => fs::remove_dir_all(path),
        false => fs::remove_file(path),
    });
    removed.or_else(|error| if error.kind() == io::ErrorKind::NotFound { Ok(()) } else { Err(error) })
}

/// Deletes what has a name such that a kill at any moment leaves all of it there or nothing: it loses its name first.
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

/// Locks a file or folder for as long as the value lives; none where that cannot be.
pub fn hold(path: &Path) -> Option<File> {
    File::open(path).ok().filter(|file| file.try_lock().is_ok())
}

/// The same, once whoever holds it has given it up.
pub fn wait_and_hold(path: &Path) -> Option<File> {
    File::open(path).ok().filter(|file| file.lock().is_ok())
}

/// A process works on the entry.
struct Held;

/// Locks what a killed process left; none where the file system has no locks.
fn hold_leftover(path: &Path) -> std::result::Result<Option<File>, Held> {
    // A pipe would be waited for.
    let can_be_opened = path.symlink_metadata().is_ok_and(|found| found.is_file() || found.is_dir());
    let Some(file) = can_be_opened.then(|| File::open(path).ok()).flatten() else { return Ok(None) };
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => Err(Held),
        _ => Ok(Some(file)),
    }
}

/// Makes an entry beside `target` and locks it by its `file`, where the file system has locks. Between the two another process
/// may take it for a leftover and delete it: then it is made again.
pub(super) fn held_beside<T>(
    target: &Path,
    make: impl Fn(&Path) -> io::Result<T>,
    file: impl Fn(&T) -> Option<&File>,
) -> io::Result<(PathBuf, T)> {
    loop {
        let path = temporary_beside(target)?;
        let made = make(&path)?;
        // Waits for one that is deleting it.
        let _ = file(&made).map(File::lock);
        if path.symlink_metadata().is_ok() {
            return Ok((path, made));
        }
    }
}

fn temporary_beside(target: &Path) -> io::Result<PathBuf> {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let count = COUNT.fetch_add(1, Ordering::Relaxed);
    let prefix = format!("{TEMPORARY}{}-{count}-", std::process::id());
    let temporary = folder_of(target).join(prefixed(&prefix, name_of(target)?));
    // A killed process may have had this very number, as the first one in a container always has.
    remove(&temporary)?;
    Ok(temporary)
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

/// The name that a temporary entry was to have: what follows the numbers of process and entry. One of another make, such as a
/// probe's, stands for itself.
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

/// Names of a folder's entries, in order.
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

    #[test]
    fn a_leftover_of_the_same_process_number_is_no_obstacle() {
        let dir = tempfile::tempdir().unwrap();
        for count in 0..200 {
            let name = format!("{TEMPORARY}{}-{count}-a", std::process::id());
            fs::write(dir.path().join(name), "half").unwrap();
        }
        write_atomic(&dir.path().join("a"), b"whole").unwrap();
        assert_eq!(fs::read(dir.path().join("a")).unwrap(), b"whole");
    }
}
