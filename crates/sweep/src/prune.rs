//! Points that a sweep's folder has and its definition no longer asks for.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use crate::base::files::{check_own, discard};
use crate::base::{Error, Result};

use super::claim::{Claim, Sharing};
use super::folder::SweepFolder;
use super::points::Point;

/// A point's folder that no point of the definition has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Left {
    /// The point's name.
    pub id: String,
    /// What it was: the first line of its `config.toml`, or nothing.
    pub label: String,
    /// Its folder.
    pub path: PathBuf,
    /// It was measured.
    pub done: bool,
    /// Size of its files in bytes.
    pub bytes: u64,
}

/// Returns the folders below `points/` that `points` do not name, by name.
///
/// # Errors
/// A folder that cannot be read, or a link in its place.
pub fn prunable(folder: &SweepFolder, points: &[Point]) -> Result<Vec<Left>> {
    folder.check_entries()?;
    let known: HashSet<&str> = points.iter().map(|point| point.id.as_str()).collect();
    let mut left = Vec::new();
    for path in entries(&folder.points_path())? {
        let id = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        // Links and files are none of ours.
        let is_folder = path.symlink_metadata().is_ok_and(|found| found.is_dir());
        if !is_folder || known.contains(id.as_str()) {
            continue;
        }
        let text = std::fs::read_to_string(path.join("config.toml")).unwrap_or_default();
        let label = text.lines().next().and_then(|line| line.strip_prefix("# ")).unwrap_or_default().to_string();
        let (done, bytes) = (path.join("result.json").exists(), size(&path)?);
        left.push(Left { id, label, path, done, bytes });
    }
    left.sort_by(|a, b| a.id.cmp(&b.id));
    Ok(left)
}

/// Deletes folders that [`prunable`] found.
///
/// # Errors
/// A worker has one of them; then nothing is deleted. A folder that cannot be deleted.
pub fn prune(folder: &SweepFolder, left: &[Left]) -> Result<()> {
    let _lock = folder.lock()?;
    let mut claims = Vec::new();
    for point in left {
        check_own(&point.path, true)?;
        match Claim::take(&point.path, Sharing::Scheduler)? {
            Some(claim) => claims.push(claim),
            None => {
                let who = Claim::look(&point.path).map_or("another worker".into(), |claim| claim.who());
                return Err(Error::Output(format!(
                    "{}: {who} works on it; nothing is deleted. Stop that worker first",
                    point.path.display()
                )));
            }
        }
    }
    // Claims note their progress in the folders: they go first, while the sweep's lock keeps workers from new ones.
    drop(claims);
    left.iter().try_for_each(|point| discard(&point.path).map_err(|e| Error::unwritable(&point.path, &e)))
}

fn entries(path: &Path) -> Result<Vec<PathBuf>> {
    let unreadable = |e: std::io::Error| Error::unreadable(path, &e);
    match std::fs::read_dir(path) {
        Ok(found) => found.map(|entry| Ok(entry.map_err(unreadable)?.path())).collect(),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(error) => Err(unreadable(error)),
    }
}

/// Size of all files below a folder; links count as nothing.
fn size(path: &Path) -> Result<u64> {
    let mut bytes = 0;
    for entry in entries(path)? {
        let found = entry.symlink_metadata().map_err(|e| Error::unreadable(&entry, &e))?;
        bytes += if found.is_dir() { size(&entry)? } else { found.len() };
    }
    Ok(bytes)
}
