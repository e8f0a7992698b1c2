//! Files and folders that appear completely or not at all.
//!
//! New content is written under a temporary name in the same folder, flushed to the disk, and renamed. The same folder
//! is the same file system, so that the rename cannot become a copy. A killed process leaves at most an entry whose
//! name starts with [`TEMPORARY`] or [`REPLACED`]. [`clean_temporaries`] cleans these up, and so does the next
//! [`AtomicDir`] of the same name. A process locks its entries while it works on them; locked entries are left alone.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::base::input::{JSON_BYTES, read_bytes};
use crate::base::{Error, Result};

pub use super::temporaries::{REPLACED, TEMPORARY, clean_temporaries, is_temporary, temporary_beside};
use super::temporaries::{clean_where, folder_of, held_beside, name_of, prefixed};
pub use super::temporaries::{discard, hold, remove, wait_and_hold};

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
    let _ = name_of(path).and_then(|name| clean_where(folder_of(path), |entry| entry == name));
    try_write_named(path, bytes).map_err(|error| Error::unwritable(path, &error))
}

/// Writes `value` with [`write_named`], as indented JSON with a newline at the end.
pub fn write_named_json<T: Serialize>(path: &Path, value: &T) -> Result<()> {
    write_named(path, &json_bytes(value).map_err(|error| Error::unwritable(path, &error))?)
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
    let (temporary, mut file) = held_beside(target, |path| File::create_new(path), |file| Some(file))?;
    // Locked until it has its name, so that no process treats it as a leftover.
    let written = write_synced(&mut file, bytes).and_then(|()| fs::rename(&temporary, target));
    if written.is_err() {
        let _ = fs::remove_file(&temporary);
    }
    written.and_then(|()| sync_folder(folder_of(target)))
}

/// Writes `bytes`, and waits until they have reached the disk.
pub fn write_synced(file: &mut File, bytes: &[u8]) -> io::Result<()> {
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
        let _ = name_of(target).and_then(|name| clean_where(folder_of(target), |entry| entry == name));
        let make = |path: &Path| fs::create_dir(path).map(|()| File::open(path).ok());
        let (temporary, _held) =
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

    /// Flushes everything inside to the disk, and gives the folder its final name. A folder that has this name already
    /// is moved aside first and deleted last. [`clean_temporaries`] undoes a kill between the two renames.
    pub fn commit(self) -> Result<()> {
        self.try_commit().map_err(|error| Error::unwritable(&self.target, &error))
    }

    /// The same for a name that nobody has taken meanwhile.
    pub fn commit_new(self) -> Result<()> {
        let committed = sync_tree(&self.temporary).and_then(|()| match self.target.symlink_metadata() {
            Ok(_) => Err(io::Error::from(io::ErrorKind::AlreadyExists)),
            Err(_) => fs::rename(&self.temporary, &self.target),
        });
        committed
            .and_then(|()| sync_folder(folder_of(&self.target)))
            .map_err(|error| Error::unwritable(&self.target, &error))
    }

    fn try_commit(&self) -> io::Result<()> {
        sync_tree(&self.temporary)?;
        let parent = folder_of(&self.target);
        let replaced = parent.join(prefixed(REPLACED, name_of(&self.target)?));
        let mut _held = None;
        if self.target.symlink_metadata().is_ok() {
            discard(&replaced)?;
            _held = hold(&self.target);
            fs::rename(&self.target, &replaced)?;
        }
        if let Err(error) = fs::rename(&self.temporary, &self.target) {
            let _ = fs::rename(&replaced, &self.target);
            return Err(error);
        }
        sync_folder(parent)?;
        discard(&replaced)
    }
}

impl Drop for AtomicDir {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.temporary);
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
    use super::*;
    use crate::base::temporaries::names;

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
        for name in ["a.json", "b.json"] {
            fs::write(dir.path().join(format!("{TEMPORARY}7-0-{name}")), "half").unwrap();
        }
        write_named(&dir.path().join("a.json"), b"{}").unwrap();
        assert_eq!(names(dir.path()), [".augnerf-tmp-7-0-b.json", "a.json"]);
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
}
