//! Files and folders that appear completely or not at all.
//!
//! New content is written under a temporary name in the same folder, flushed to the disk, and renamed. The same folder
//! is the same file system, so that the rename cannot become a copy. A killed process leaves at most an entry whose
//! name starts with [`TEMPORARY`]. [`clean_temporaries`] deletes these, and so does the next [`AtomicDir`] of the same
//! name. A process locks its entries while it works on them; locked entries are left alone.

use std::ffi::{OsStr, OsString};
use std::fs::{self, File, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::input::{JSON_BYTES, read_bytes};
use crate::{Error, Result};

/// Prefix of the names of unfinished entries, before the name that the entry is to have and random letters.
pub const TEMPORARY: &str = ".augnerf-tmp-";

/// Writes `bytes` to `path` atomically. At every moment, and after a crash of the machine, the file has its old content
/// or the new one. A symbolic link is replaced, because in a folder of somebody else it might lead anywhere. A device or
/// pipe is an error.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<()> {
    try_write(path, bytes).map_err(|error| Error::unwritable(path, &error))
}

/// Writes to a file that the user named. A symbolic link is followed. A device or pipe, which cannot be replaced, is
/// written to directly. What killed processes left of files of this name is deleted first.
pub fn write_named(path: &Path, bytes: &[u8]) -> Result<()> {
    // A leftover that cannot be deleted does no harm.
    let _ = clean_beside(path);
    try_write_named(path, bytes).map_err(|error| Error::unwritable(path, &error))
}

/// Checks that an entry of a folder that the program writes into is what it would have made: a file, or a folder. It may
/// not be there. A link would lead writes, and deletions, out of the folder.
///
/// # Errors
/// [`Error::Output`].
pub fn check_own(path: &Path, is_folder: bool) -> Result<()> {
    let Ok(found) = path.symlink_metadata() else { return Ok(()) };
    let sound = if is_folder { found.is_dir() } else { found.is_file() };
    if sound {
        return Ok(());
    }
    let kind = if found.is_symlink() { "a symbolic link" } else { "neither a file nor a folder of ours" };
    let wanted = if is_folder { "a folder" } else { "a file" };
    Err(Error::Output(format!(
        "{} is {kind}, where {wanted} is written; put {wanted} there, or work on a copy without it",
        path.display()
    )))
}

/// Writes `value` with [`write_atomic`], as indented JSON with a newline at the end.
pub fn write_json<T: Serialize>(path: &Path, value: &T) -> Result<()> {
    write_atomic(path, &json_bytes(value).map_err(|error| Error::unwritable(path, &error))?)
}

/// Returns `value` as indented JSON with a newline at the end.
pub fn json_bytes<T: Serialize>(value: &T) -> io::Result<Vec<u8>> {
    let mut text = serde_json::to_vec_pretty(value)?;
    text.push(b'\n');
    Ok(text)
}

/// Reads `path` as JSON. Returns `None` if there is no such file. `advice` says what to do with a damaged file.
///
/// # Errors
/// [`Error::Data`] for a file that the system does not read, [`Error::Checkpoint`] for a damaged one.
pub fn read_json<T: for<'de> Deserialize<'de>>(path: &Path, advice: &str) -> Result<Option<T>> {
    read_large_json(path, JSON_BYTES, advice)
}

/// Calls [`read_json`] for a file of at most `most` bytes.
pub fn read_large_json<T: for<'de> Deserialize<'de>>(path: &Path, most: u64, advice: &str) -> Result<Option<T>> {
    let bytes = match read_bytes(path, most) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(Error::unreadable(path, &error)),
    };
    let damaged = |error| Error::Checkpoint(format!("cannot read {}: {error}; {advice}", path.display()));
    serde_json::from_slice(&bytes).map(Some).map_err(damaged)
}

fn try_write_named(path: &Path, bytes: &[u8]) -> io::Result<()> {
    match fs::metadata(path) {
        Ok(found) if !found.is_file() && !found.is_dir() => {
            fs::OpenOptions::new().write(true).open(path)?.write_all(bytes)
        }
        Ok(_) => try_write(&fs::canonicalize(path)?, bytes),
        Err(_) => try_write(path, bytes),
    }
}

fn try_write(target: &Path, bytes: &[u8]) -> io::Result<()> {
    match target.symlink_metadata() {
        Ok(found) if found.is_dir() => return Err(io::Error::other("it is a folder")),
        // Root could replace the machine's own.
        Ok(found) if !found.is_file() && !found.is_symlink() => {
            return Err(io::Error::other("it is a device or a pipe"));
        }
        _ => {}
    }
    let (mut file, temporary) = held_beside(target, |path| File::create_new(path), |file| Some(file))?;
    // Locked until it has its name, so that no process treats it as a leftover.
    let written = write_synced(&mut file, bytes).and_then(|()| fs::rename(&temporary, target));
    if written.is_err() {
        let _ = fs::remove_file(&temporary);
    }
    written.and_then(|()| sync_folder(folder_of(target)))
}

/// Writes `bytes`, and waits until they have reached the disk.
fn write_synced(file: &mut File, bytes: &[u8]) -> io::Result<()> {
    file.write_all(bytes)?;
    file.sync_all()
}

/// A folder that is filled under a hidden name and gets its own with [`AtomicDir::commit`]. If it is dropped without a
/// commit, it is deleted.
#[derive(Debug)]
pub struct AtomicDir {
    temporary: PathBuf,
    target: PathBuf,
    /// Keeps other processes from treating the hidden folder as a leftover.
    _held: Option<File>,
}

impl AtomicDir {
    /// Creates the hidden folder next to `target`, whose parent must exist. It first cleans up what killed processes
    /// left of folders of this name.
    pub fn new(target: &Path) -> Result<AtomicDir> {
        // A leftover that cannot be deleted does no harm.
        let _ = clean_beside(target);
        let make = |path: &Path| fs::create_dir(path).map(|()| File::open(path).ok());
        let (_held, temporary) =
            held_beside(target, make, Option::as_ref).map_err(|error| Error::unwritable(target, &error))?;
        Ok(AtomicDir { temporary, target: target.to_path_buf(), _held })
    }

    /// Creates the hidden folder for a target that must be free: an empty folder or none. A file, or a folder that is
    /// not empty, is not replaced. Missing parent folders are created.
    pub fn vacant(target: &Path) -> Result<AtomicDir> {
        AtomicDir::check_vacant(target)?;
        let parent = folder_of(target);
        fs::create_dir_all(parent).map_err(|error| Error::unwritable(parent, &error))?;
        AtomicDir::new(target)
    }

    /// Returns an error if the target is not free, before the work that it is for.
    pub fn check_vacant(target: &Path) -> Result<()> {
        match fs::read_dir(target).map(|mut entries| entries.next().is_none()) {
            Ok(true) => Ok(()),
            Ok(false) => {
                Err(Error::Output(format!("{} already holds files: name a new or an empty folder", target.display())))
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            Err(error) => Err(Error::unwritable(target, &error)),
        }
    }

    /// Returns the hidden folder. Its content will be that of `target`.
    pub fn path(&self) -> &Path {
        &self.temporary
    }

    /// Flushes everything inside to the disk, and gives the folder the final name in the place of what has it already.
    pub fn commit(self) -> Result<()> {
        use io::ErrorKind::{InvalidInput, NotFound, Unsupported};
        self.rename(|| match exchange(&self.temporary, &self.target) {
            Ok(()) => Ok(()),
            // Nothing has the name, or the file system cannot exchange two.
            Err(error) if matches!(error.kind(), NotFound | Unsupported | InvalidInput) => {
                discard(&self.target).and_then(|()| fs::rename(&self.temporary, &self.target))
            }
            Err(error) => Err(error),
        })
    }

    /// The same for a name that nobody has taken meanwhile.
    pub fn commit_new(self) -> Result<()> {
        self.rename(|| match self.target.symlink_metadata() {
            Ok(_) => Err(io::ErrorKind::AlreadyExists.into()),
            Err(_) => fs::rename(&self.temporary, &self.target),
        })
    }

    fn rename(&self, rename: impl FnOnce() -> io::Result<()>) -> Result<()> {
        sync_tree(&self.temporary)
            .and_then(|()| rename())
            .and_then(|()| sync_folder(folder_of(&self.target)))
            .map_err(|error| Error::unwritable(&self.target, &error))
    }
}

/// Exchanges the names of two folders, so that a killed process leaves one of them under each.
#[cfg(target_os = "linux")]
fn exchange(one: &Path, other: &Path) -> io::Result<()> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    Ok(renameat_with(CWD, one, CWD, other, RenameFlags::EXCHANGE)?)
}

#[cfg(not(target_os = "linux"))]
fn exchange(_: &Path, _: &Path) -> io::Result<()> {
    Err(io::ErrorKind::Unsupported.into())
}

impl Drop for AtomicDir {
    fn drop(&mut self) {
        // After an exchange it is what had the name before, which may be a file.
        let _ = remove(&self.temporary);
    }
}

/// Deletes what killed processes left unfinished in `dir` (not below it), and returns the number of entries. If the file
/// system has no locks, call it only while holding the run's lock and without writes of your own.
pub fn clean_temporaries(dir: &Path) -> Result<usize> {
    clean(dir, OsStr::new(TEMPORARY), |_| true).map_err(|error| Error::unwritable(dir, &error))
}

/// Deletes what was to have the name `target`.
fn clean_beside(target: &Path) -> io::Result<usize> {
    // A point belongs to the name of another file: `a.json` beside `a`.
    clean(folder_of(target), &temporary_prefix(target)?, |random| !random.contains(&b'.'))
}

/// Deletes unfinished entries whose names start with `prefix`, and whose rest is accepted.
fn clean(dir: &Path, prefix: &OsStr, accepts: impl Fn(&[u8]) -> bool) -> io::Result<usize> {
    let mut cleaned = 0;
    for entry in fs::read_dir(dir)? {
        let entry = entry?;
        if !entry.file_name().as_encoded_bytes().strip_prefix(prefix.as_encoded_bytes()).is_some_and(&accepts) {
            continue;
        }
        let kind = entry.file_type()?;
        // Opening a pipe would wait. The lock is kept until the entry is deleted, so that its maker notices.
        let file = if kind.is_file() || kind.is_dir() { File::open(entry.path()).ok() } else { None };
        if file.as_ref().is_some_and(|file| matches!(file.try_lock(), Err(TryLockError::WouldBlock))) {
            continue;
        }
        remove(&entry.path())?;
        cleaned += 1;
    }
    Ok(cleaned)
}

/// Returns whether an entry of this name is unfinished, or a leftover of a killed process.
pub fn is_temporary(name: &OsStr) -> bool {
    name.as_encoded_bytes().starts_with(TEMPORARY.as_bytes())
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
        Ok(_) => remove(&beside(path, |aside| fs::rename(path, aside))?.1),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(error),
    }
}

/// Waits for the lock of a file or folder and takes it. Returns `None` if the file system has no locks.
pub fn wait_and_hold(path: &Path) -> Option<File> {
    File::open(path).ok().filter(|file| file.lock().is_ok())
}

/// Makes an entry next to `target`, and locks it through its `file` if the file system has locks. Between the two,
/// another process may treat it as a leftover and delete it. Then it is made again.
fn held_beside<T>(
    target: &Path,
    make: impl Fn(&Path) -> io::Result<T>,
    file: impl Fn(&T) -> Option<&File>,
) -> io::Result<(T, PathBuf)> {
    loop {
        let (made, path) = beside(target, &make)?;
        // Waits for a process that is deleting it.
        let _ = file(&made).map(File::lock);
        if path.symlink_metadata().is_ok() {
            return Ok((made, path));
        }
    }
}

/// Makes an entry beside `target`, under a temporary name that no other process has.
fn beside<T>(target: &Path, make: impl Fn(&Path) -> io::Result<T>) -> io::Result<(T, PathBuf)> {
    let made = tempfile::Builder::new().prefix(&temporary_prefix(target)?).make_in(folder_of(target), make)?;
    made.keep().map_err(|error| error.error)
}

fn temporary_prefix(target: &Path) -> io::Result<OsString> {
    let name = target.file_name().ok_or_else(|| io::Error::other("the path does not end in a name"))?;
    Ok([OsStr::new(TEMPORARY), name, OsStr::new(".")].into_iter().collect())
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// Makes renames and creations in `folder` survive a crash of the machine. Only Unix can open a folder for this. File
/// systems without the operation are left alone.
fn sync_folder(folder: &Path) -> io::Result<()> {
    if !cfg!(unix) {
        return Ok(());
    }
    match File::open(folder)?.sync_all() {
        Err(error) if matches!(error.kind(), io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported) => Ok(()),
        other => other,
    }
}

fn sync_tree(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let kind = entry.file_type()?;
        if kind.is_dir() {
            sync_tree(&entry.path())?;
        } else if kind.is_file() {
            fs::OpenOptions::new().append(true).open(entry.path())?.sync_all()?;
        }
    }
    sync_folder(folder)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};

    use super::*;

    /// Returns the names of a folder's entries, in order.
    fn names(dir: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_created_and_replaced_without_leftovers() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.json");
        write_atomic(&path, b"one").unwrap();
        write_atomic(&path, b"two").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
        assert_eq!(names(dir.path()), ["a.json"]);
    }

    #[test]
    fn a_named_file_takes_its_own_leftovers_away() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["a.json", "b.json", "a.json.gz"] {
            fs::write(dir.path().join(format!("{TEMPORARY}{name}.x7")), "half").unwrap();
        }
        write_named(&dir.path().join("a.json"), b"{}").unwrap();
        assert_eq!(names(dir.path()), [".augnerf-tmp-a.json.gz.x7", ".augnerf-tmp-b.json.x7", "a.json"]);
    }

    #[test]
    fn a_refused_write_names_the_path_and_keeps_what_was_there() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("taken");
        fs::create_dir(&folder).unwrap();
        let error = write_atomic(&folder, b"x").unwrap_err();
        assert_eq!(error.exit_code(), 4);
        assert!(error.to_string().contains("taken"), "{error}");
        let below_file = dir.path().join("file").join("below");
        fs::write(dir.path().join("file"), "keep").unwrap();
        assert_eq!(write_atomic(&below_file, b"x").unwrap_err().exit_code(), 4);
        assert_eq!(names(dir.path()), ["file", "taken"]);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_device_is_an_output_error_and_stays_a_device() {
        let error = write_named(Path::new("/dev/full"), b"x").unwrap_err();
        assert!(matches!(&error, Error::Output(text) if text.contains("/dev/full")), "{error}");
        assert_eq!(write_atomic(Path::new("/dev/full"), b"x").unwrap_err().exit_code(), 4);
        assert!(!fs::metadata("/dev/full").unwrap().is_file());
    }

    #[cfg(unix)]
    #[test]
    fn a_symbolic_link_is_followed_where_the_user_named_it_alone() {
        let dir = tempfile::tempdir().unwrap();
        let (real, link) = (dir.path().join("real"), dir.path().join("link"));
        fs::write(&real, "old").unwrap();
        std::os::unix::fs::symlink(&real, &link).unwrap();
        assert_eq!(check_own(&link, false).unwrap_err().exit_code(), 4);
        write_named(&link, b"new").unwrap();
        assert_eq!(fs::read(&real).unwrap(), b"new");
        assert!(link.symlink_metadata().unwrap().is_symlink());
        write_atomic(&link, b"own").unwrap();
        assert_eq!((fs::read(&real).unwrap(), fs::read(&link).unwrap()), (b"new".to_vec(), b"own".to_vec()));
        assert!(
            check_own(&link, false).is_ok() && check_own(&link, true).is_err() && check_own(dir.path(), true).is_ok()
        );
    }

    #[test]
    fn a_folder_appears_only_when_committed() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("step-10");
        let abandoned = AtomicDir::new(&target).unwrap();
        fs::write(abandoned.path().join("weights"), "half").unwrap();
        assert!(!target.exists());
        drop(abandoned);
        assert!(names(dir.path()).is_empty());

        fs::write(&target, "in its place").unwrap();
        for content in ["first", "second"] {
            let folder = AtomicDir::new(&target).unwrap();
            fs::write(folder.path().join("weights"), content).unwrap();
            folder.commit().unwrap();
            assert_eq!(fs::read_to_string(target.join("weights")).unwrap(), content);
        }
        assert_eq!(names(dir.path()), ["step-10"]);
    }

    #[test]
    fn a_place_that_holds_something_is_not_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        fs::write(at("file"), "keep").unwrap();
        fs::create_dir(at("full")).unwrap();
        fs::write(at("full").join("a"), "keep").unwrap();
        fs::create_dir(at("empty")).unwrap();
        for taken in ["file", "full"] {
            let error = AtomicDir::vacant(&at(taken)).unwrap_err();
            assert!(error.exit_code() == 4 && error.to_string().contains(taken), "{error}");
        }
        for free in ["empty", "new/below"] {
            AtomicDir::vacant(&at(free)).unwrap().commit().unwrap();
            assert!(at(free).is_dir());
        }
        assert_eq!(names(dir.path()), ["empty", "file", "full", "new"]);
    }

    #[test]
    fn what_kills_left_is_put_right() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        fs::write(at(".augnerf-tmp-metrics.json.x1"), "half").unwrap();
        fs::create_dir(at(".augnerf-tmp-step-20.x1")).unwrap();
        fs::create_dir(at("step-15")).unwrap();
        fs::write(at(".hidden"), "not ours").unwrap();
        assert_eq!(clean_temporaries(dir.path()).unwrap(), 2);
        assert_eq!(names(dir.path()), [".hidden", "step-15"]);
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
        let over = AtomicBool::new(false);
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
        for leftover in [".augnerf-tmp-pictures.x3", ".augnerf-tmp-pictures.y0", ".augnerf-tmp-others.x4"] {
            fs::create_dir(dir.path().join(leftover)).unwrap();
        }
        AtomicDir::vacant(&target).unwrap().commit().unwrap();
        assert_eq!(names(dir.path()), [".augnerf-tmp-others.x4", "pictures"], "another name is another's");
    }
}
