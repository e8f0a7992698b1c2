//! The folder of one run: its fixed names, its lock, and checks that are made before hours of training rather than
//! after.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use crate::base::files::{check_own, clean_temporaries, discard, is_temporary, read_json, remove};
use crate::base::input::{TEXT_BYTES, read_text};
use crate::base::{Error, Result};
use crate::runtime::Timing;
use crate::settings::Config;
use crate::train::checkpoint;

use super::lock::{LOCK, RunLock};

const CONFIG: &str = "config.toml";
const SCENE: &str = "scene.json";
const METRICS_JSON: &str = "metrics.json";
const METRICS_CSV: &str = "metrics.csv";
const DEPTH_ERRORS: &str = "depth_errors.gz";
const SMOOTHNESS: &str = "smoothness.csv";
const SCALARS: &str = "scalars.csv";
const TIMING: &str = "timing.json";
const CHECKPOINTS: &str = "checkpoints";
const RENDERS: &str = "renders";
const MESH: &str = "mesh";
const EVAL: &str = "eval";

/// The files of a run, apart from the lock.
const FILES: [&str; 8] = [CONFIG, SCENE, METRICS_JSON, METRICS_CSV, DEPTH_ERRORS, SMOOTHNESS, SCALARS, TIMING];
/// The subfolders of a run.
const FOLDERS: [&str; 2] = [CHECKPOINTS, RENDERS];

const MIB: f64 = 1024.0 * 1024.0;

/// What to do with an existing run at the path of a new one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// Keep it, and return an error.
    Refuse,
    /// Delete it.
    Replace,
}

/// The folder of one run.
#[derive(Debug)]
pub struct RunDir {
    path: PathBuf,
    lock: Option<RunLock>,
}

impl RunDir {
    /// Creates a locked, empty run folder at `path`, with parents. An existing run is an error. With
    /// [`Existing::Replace`], the run's own entries are deleted and nothing else. A folder that holds anything but a
    /// run is always an error. So is a disk without `bytes_needed` of free space. Both are checked before anything is
    /// deleted.
    pub fn create(path: &Path, existing: Existing, bytes_needed: u64) -> Result<RunDir> {
        if path.exists() {
            check_vacant(path, existing)?;
        }
        fs::create_dir_all(path).map_err(|error| Error::unwritable(path, &error))?;
        check_entries(path)?;
        let lock = RunLock::acquire(path)?;
        // Again under the lock, since another process may have started a run here in between.
        check_vacant(path, existing)?;
        check_space(path, bytes_needed)?;
        clear(path).map_err(|error| Error::unwritable(path, &error))?;
        let run = RunDir { path: path.to_path_buf(), lock: Some(lock) };
        run.create_folders()?;
        Ok(run)
    }

    /// Returns whether a run was started at `path`.
    pub fn holds_run(path: &Path) -> bool {
        path.join(CONFIG).is_file()
    }

    /// Returns whether no run was started at `path`: it does not exist, or has no settings and checkpoints.
    ///
    /// # Errors
    /// The path cannot be read.
    pub fn is_vacant(path: &Path) -> Result<bool> {
        let exists = |path: &Path| path.try_exists().map_err(|error| Error::unreadable(path, &error));
        if !exists(path)? {
            return Ok(true);
        }
        Ok(path.is_dir() && !exists(&path.join(CONFIG))? && checkpoint::list(&path.join(CHECKPOINTS))?.is_empty())
    }

    /// Opens an existing run for reading. To continue its training, call [`RunDir::lock`] as well.
    pub fn open(path: &Path) -> Result<RunDir> {
        if !path.is_dir() {
            let found = if path.exists() { "not a folder" } else { "missing" };
            return Err(Error::Checkpoint(format!("cannot open run {}: it is {found}", path.display())));
        }
        if !RunDir::holds_run(path) {
            if path.join("sweep.toml").is_file() {
                return Err(Error::Checkpoint(format!(
                    "{} is the folder of a sweep; `augnerf sweep run FILE` continues it, and `augnerf sweep status` lists its runs",
                    path.display()
                )));
            }
            return Err(Error::Checkpoint(format!(
                "{} is not a run folder: it has no {CONFIG}; give the folder of `augnerf train --out`",
                path.display()
            )));
        }
        let run = path.join("run");
        if !path.join(CHECKPOINTS).exists() && RunDir::holds_run(&run) {
            let (point, run) = (path.display(), run.display());
            return Err(Error::Checkpoint(format!("{point} is a point of a sweep; its run is {run}")));
        }
        Ok(RunDir { path: path.to_path_buf(), lock: None })
    }

    /// Opens and locks an existing run, and repairs what a killed session left half-written.
    ///
    /// # Errors
    /// Those of [`RunDir::open`]; another process holds the run.
    pub fn take(path: &Path) -> Result<RunDir> {
        let mut run = RunDir::open(path)?;
        run.lock()?;
        run.clean()?;
        Ok(run)
    }

    /// Opens and locks a run for reading. If this process cannot write there, the run stays unchanged and other
    /// readers share it.
    ///
    /// # Errors
    /// Those of [`RunDir::take`].
    pub fn take_to_read(path: &Path) -> Result<RunDir> {
        let mut run = RunDir::open(path)?;
        check_entries(path)?;
        if run.is_writable() {
            return RunDir::take(path);
        }
        run.lock = RunLock::share(path)?;
        Ok(run)
    }

    /// Returns who holds the run at `path`, or `None` if [`RunDir::take`] would not find it in use.
    pub fn holder(path: &Path) -> Option<String> {
        // A link in place of a file is an error of whoever takes the run.
        check_entries(path).ok()?;
        RunLock::holder(path)
    }

    /// Returns whether this process may write into the run; not on a read-only disk, for instance.
    pub fn is_writable(&self) -> bool {
        let denied = |error: &io::Error| {
            matches!(error.kind(), io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem)
        };
        !matches!(File::options().write(true).create(true).truncate(false).open(self.path.join(LOCK)), Err(e) if denied(&e))
    }

    /// Reads the settings of the run's start, resolved.
    pub fn read_config(&self) -> Result<Config> {
        let path = self.config();
        let text = read_text(&path, TEXT_BYTES)
            .map_err(|e| Error::Checkpoint(format!("cannot read {}: {e}", path.display())))?;
        // An empty file would be all defaults.
        if text.trim().is_empty() {
            return Err(Error::Checkpoint(format!(
                "{} is empty, though a run's settings were in it: take it from a copy, or train the run again",
                path.display()
            )));
        }
        Config::from_toml(&text, &path.display().to_string())
    }

    /// Reads the time of earlier sessions, or returns `None` before the first checkpoint.
    pub fn read_timing(&self) -> Result<Option<Timing>> {
        read_json(&self.timing(), "delete it to continue")
    }

    /// Repairs what a killed session left half-written. The caller holds the lock.
    pub fn clean(&self) -> Result<()> {
        let below = FOLDERS.iter().chain(&[MESH, EVAL]).map(|name| self.path.join(name));
        std::iter::once(self.path.clone())
            .chain(below)
            .filter(|folder| folder.is_dir())
            .try_for_each(|folder| clean_temporaries(&folder).map(|_| ()))
    }

    /// Locks the run for this process until the value is dropped.
    pub fn lock(&mut self) -> Result<()> {
        if self.lock.is_none() {
            check_entries(&self.path)?;
            self.lock = Some(RunLock::acquire(&self.path)?);
        }
        Ok(())
    }

    /// Creates missing folders of the run, and checks before training that the disk has `bytes_needed`, the caller's
    /// estimate of the run's size.
    pub fn check_writable(&self, bytes_needed: u64) -> Result<()> {
        self.create_folders()?;
        check_space(&self.path, bytes_needed)
    }

    fn create_folders(&self) -> Result<()> {
        FOLDERS
            .iter()
            .map(|name| self.path.join(name))
            .try_for_each(|folder| fs::create_dir_all(&folder).map_err(|error| Error::unwritable(&folder, &error)))
    }

    /// Returns the run folder itself.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the path of `config.toml`: the resolved configuration.
    pub fn config(&self) -> PathBuf {
        self.path.join(CONFIG)
    }

    /// Returns the path of `scene.json`: units, bounds and box of the scene.
    pub fn scene_file(&self) -> PathBuf {
        self.path.join(SCENE)
    }

    /// Returns the paths of `metrics.json` and `metrics.csv` in any folder.
    pub fn metrics_in(folder: &Path) -> [PathBuf; 2] {
        [METRICS_JSON, METRICS_CSV].map(|name| folder.join(name))
    }

    /// Returns the path of `depth_errors.gz` in any folder.
    pub fn depth_errors_in(folder: &Path) -> PathBuf {
        folder.join(DEPTH_ERRORS)
    }

    /// Returns the path of `smoothness.csv`: l1, TV and Laplacian of density, one row for each network.
    pub fn smoothness(&self) -> PathBuf {
        self.path.join(SMOOTHNESS)
    }

    /// Returns the path of `scalars.csv`: losses and other numbers over training.
    pub fn scalars(&self) -> PathBuf {
        self.path.join(SCALARS)
    }

    /// Returns the path of `timing.json`, which depends on clock and machine.
    pub fn timing(&self) -> PathBuf {
        self.path.join(TIMING)
    }

    /// Returns the path of `checkpoints/`.
    pub fn checkpoints(&self) -> PathBuf {
        self.path.join(CHECKPOINTS)
    }

    /// Returns the path of `renders/surface.png` in any folder: the shaded surface of the evaluation in the first
    /// held-out view.
    pub fn surface_picture_in(path: &Path) -> PathBuf {
        path.join(RENDERS).join("surface.png")
    }

    /// Returns the path of `eval/`: evaluations of other checkpoints and views, a folder each.
    pub fn evaluations(&self) -> PathBuf {
        self.path.join(EVAL)
    }

    /// Returns the path of `renders/` in the run folder `run`: images and videos.
    pub fn renders_in(run: &Path) -> PathBuf {
        run.join(RENDERS)
    }

    /// Returns the path of `mesh/` in the run folder `run`: a surface of the trained density, if one was drawn.
    pub fn mesh_in(run: &Path) -> PathBuf {
        run.join(MESH)
    }
}

/// Returns an error unless `path` is free for a new run: a folder that is empty, or holds a run that may be
/// overwritten.
fn check_vacant(path: &Path, existing: Existing) -> Result<()> {
    if !path.is_dir() {
        return Err(Error::Output(format!("cannot write {}: it is a file; give another --out", path.display())));
    }
    let content = Content::read(path).map_err(|error| Error::unwritable(path, &error))?;
    match content.entry {
        None => Ok(()),
        Some(entry) if !content.run => Err(Error::Output(format!(
            "{} holds {entry} and is not a run folder; give --out an empty or new folder",
            path.display()
        ))),
        Some(_) if existing == Existing::Replace => Ok(()),
        Some(_) => Err(Error::Output(format!(
            "{0} already holds a run; continue it with `augnerf resume {0}`, replace it with --overwrite, or give another --out",
            path.display()
        ))),
    }
}

/// Checks that a run's own entries are files and folders, not links that would lead writes elsewhere.
fn check_entries(path: &Path) -> Result<()> {
    FILES.iter().chain(&[LOCK]).try_for_each(|name| check_own(&path.join(name), false))?;
    let folders = FOLDERS.iter().chain(&[MESH, EVAL]).map(|name| path.join(name));
    folders.chain([path.join(RENDERS).join("path")]).try_for_each(|folder| check_own(&folder, true))
}

/// Content of a folder that a run is to be created in.
struct Content {
    /// One of its entries. The lock, temporary entries and empty run folders do not count.
    entry: Option<String>,
    /// A run made it: it has our lock file or, copied without it, `config.toml` next to `checkpoints/`. The name
    /// `config.toml` alone is too common.
    run: bool,
}

impl Content {
    fn read(path: &Path) -> io::Result<Content> {
        let run = path.join(LOCK).is_file() || path.join(CONFIG).is_file() && path.join(CHECKPOINTS).is_dir();
        for entry in fs::read_dir(path)? {
            let name = entry?.file_name();
            let idle =
                name == LOCK || is_temporary(&name) || is_own_folder(&name) && is_empty_folder(&path.join(&name));
            if !idle {
                return Ok(Content { entry: Some(name.to_string_lossy().into_owned()), run });
            }
        }
        Ok(Content { entry: None, run })
    }
}

fn is_own_folder(name: &OsStr) -> bool {
    FOLDERS.iter().any(|own| name == *own)
}

fn is_empty_folder(path: &Path) -> bool {
    fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none())
}

/// Deletes a run's entries and unfinished files; the lock stays.
fn clear(path: &Path) -> io::Result<()> {
    for entry in fs::read_dir(path)? {
        let entry = entry?;
        if is_temporary(&entry.file_name()) {
            remove(&entry.path())?;
        }
    }
    FILES.iter().chain(&FOLDERS).chain(&[MESH, EVAL]).try_for_each(|name| discard(&path.join(name)))
}

fn check_space(path: &Path, needed: u64) -> Result<()> {
    match free_bytes(path) {
        Some(free) if free < needed => Err(Error::Output(format!(
            "{} has too little space: the run writes about {:.0} MiB, but {:.0} MiB are free; free some or give another --out",
            path.display(),
            (needed as f64 / MIB).ceil(),
            (free as f64 / MIB).floor()
        ))),
        _ => Ok(()),
    }
}

/// Returns the bytes that an unprivileged process may still write at `path`, or `None` if unknown.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
pub fn free_bytes(path: &Path) -> Option<u64> {
    use std::os::unix::ffi::OsStrExt;
    let name = std::ffi::CString::new(path.as_os_str().as_bytes()).ok()?;
    let mut found = std::mem::MaybeUninit::<libc::statvfs>::uninit();
    // SAFETY: `name` ends in NUL and outlives the call, which fills `found` if it returns 0.
    let found = unsafe {
        if libc::statvfs(name.as_ptr(), found.as_mut_ptr()) != 0 {
            return None;
        }
        found.assume_init()
    };
    // The field types differ between architectures.
    #[allow(clippy::unnecessary_cast)]
    Some((found.f_bavail as u64).saturating_mul(found.f_frsize as u64))
}

/// Returns the bytes that may still be written at `path`; unknown on this system.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub fn free_bytes(_path: &Path) -> Option<u64> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_started_run_that_wrote_nothing_is_free() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a/b/run");
        drop(RunDir::create(&path, Existing::Refuse, 0).unwrap());
        fs::write(path.join(".augnerf-tmp-1-0-config.toml"), "half").unwrap();
        drop(RunDir::create(&path, Existing::Refuse, 0).unwrap());
        assert!(!path.join(".augnerf-tmp-1-0-config.toml").exists());
    }

    #[test]
    fn a_half_deleted_run_can_be_overwritten_again() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join(METRICS_CSV), "").unwrap();
        assert!(RunDir::create(dir.path(), Existing::Replace, 0).is_err());
        fs::write(dir.path().join(LOCK), "").unwrap();
        assert!(RunDir::create(dir.path(), Existing::Refuse, 0).is_err());
        RunDir::create(dir.path(), Existing::Replace, 0).unwrap();
        assert!(!dir.path().join(METRICS_CSV).exists());
    }

    #[test]
    fn room_is_compared_with_the_need() {
        let dir = tempfile::tempdir().unwrap();
        let run = RunDir::create(&dir.path().join("run"), Existing::Refuse, 0).unwrap();
        run.check_writable(1).unwrap();
        if free_bytes(dir.path()).is_some() {
            let error = run.check_writable(u64::MAX).unwrap_err().to_string();
            assert!(error.contains("MiB are free") && error.contains("run"), "{error}");
        }
    }
}
