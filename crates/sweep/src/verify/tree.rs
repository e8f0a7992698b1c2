//! What lies below a folder: sweeps, views, comparisons, single runs, and pages on them, in groups of any depth.

use std::path::{Path, PathBuf};

use super::files;
use crate::base::{Error, Result};
use crate::comparisons::{ACROSS, OVER_SCENES};
use crate::folder::DEFINITION;
use crate::report::exporters::is_made;
use crate::view::VIEW;

/// Deeper than anyone sorts results: most likely a link that leads up.
const DEEPEST: usize = 6;

/// What a folder holds.
#[derive(Clone, Copy, PartialEq)]
pub enum Kind {
    /// A sweep's results.
    Sweep,
    /// Chosen rows of sweeps.
    View,
    /// Single runs.
    Runs,
    /// Rows compared over several sweeps or their scenes.
    Comparison,
    /// Text on results in other folders.
    Pages,
    /// Nothing that can be checked.
    Other,
}

/// Returns the folders of results below a folder, by path; the folder itself where it is no group.
pub fn leaves_below(path: &Path) -> Result<Vec<(PathBuf, Kind)>> {
    let mut leaves = Vec::new();
    walk(path, 0, &mut leaves)?;
    Ok(leaves)
}

fn walk(path: &Path, depth: usize, leaves: &mut Vec<(PathBuf, Kind)>) -> Result<()> {
    let (kind, before) = (kind(path)?, leaves.len());
    if matches!(kind, Kind::Other | Kind::Pages) && depth < DEEPEST {
        folders_in(path)?.iter().try_for_each(|folder| walk(folder, depth + 1, leaves))?;
    }
    if leaves[before..].iter().all(|(_, kind)| *kind == Kind::Other) {
        leaves.truncate(before);
        leaves.push((path.to_path_buf(), kind));
    }
    Ok(())
}

/// Returns the sweeps' folders of this name below the folder `results` that a path lies in.
pub fn sweeps_named(path: &Path, name: &str) -> Result<Vec<PathBuf>> {
    let absolute = std::path::absolute(path).map_err(|e| Error::unreadable(path, &e))?;
    let is_root = |folder: &&Path| folder.ends_with("results") && !folder.join(DEFINITION).exists();
    let Some(root) = absolute.ancestors().find(is_root) else { return Ok(Vec::new()) };
    let is_it = |path: &Path, kind: Kind| kind == Kind::Sweep && path.file_name().is_some_and(|own| own == name);
    let leaves = leaves_below(root)?.into_iter();
    Ok(leaves.filter(|(path, kind)| is_it(path, *kind)).map(|(path, _)| path).collect())
}

fn kind(path: &Path) -> Result<Kind> {
    let has = |name: &str| path.join(name).exists();
    let folders = folders_in(path)?;
    Ok(match () {
        () if has(VIEW) => Kind::View,
        () if has("points.csv") || has(DEFINITION) => Kind::Sweep,
        () if folders.iter().any(|folder| folder.join("metrics.json").exists()) => Kind::Runs,
        () if !folders.is_empty() => Kind::Other,
        () if has(ACROSS) || has(OVER_SCENES) => Kind::Comparison,
        () if holds_pages_alone(path)? => Kind::Pages,
        () => Kind::Other,
    })
}

/// Returns whether people wrote all that a folder holds: a page at least, and nothing that the program leaves in results.
fn holds_pages_alone(path: &Path) -> Result<bool> {
    let names = names_in(path)?;
    let is_results = |name: &String| files::is_kept(name) || is_made(name);
    Ok(names.iter().any(|name| name.ends_with(".md")) && !names.iter().any(is_results))
}

/// Returns the folders in a folder, by name.
fn folders_in(path: &Path) -> Result<Vec<PathBuf>> {
    let paths = names_in(path)?.into_iter().map(|name| path.join(name));
    Ok(paths.filter(|path| path.is_dir()).collect())
}

/// Returns the names in a folder, folders among them.
pub fn names_in(folder: &Path) -> Result<Vec<String>> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|e| Error::unreadable(folder, &e))? {
        let entry = entry.map_err(|e| Error::unreadable(folder, &e))?;
        names.push(entry.file_name().to_string_lossy().into_owned());
    }
    names.sort();
    Ok(names)
}
