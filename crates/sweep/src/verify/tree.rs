//! What lies below a folder: sweeps, single runs, comparisons, and pages on them, in groups of any depth.

use std::path::{Path, PathBuf};

use super::files;
use super::quotes::QUOTES;
use super::runs::run_folders;
use crate::across::{ACROSS, ACROSS_PAGE};
use crate::base::{Error, Result};
use crate::folder::DEFINITION;
use crate::over_scenes::{OVER_SCENES, OVER_SCENES_PAGE};
use crate::report::exporters::EXPORTERS;
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
    /// One comparison of each of several sweeps, or rows over their scenes.
    Across,
    /// Text on results in other folders.
    Pages,
    /// Nothing that can be checked.
    Other,
}

/// The folders of results below a folder, and the pages in its groups.
#[derive(Default)]
pub struct Tree {
    /// By path; the folder itself where it is no group.
    pub leaves: Vec<(PathBuf, Kind)>,
    /// By path.
    pub pages: Vec<PathBuf>,
}

impl Tree {
    /// Of a folder of results, or of a group of such.
    pub fn below(path: &Path) -> Result<Tree> {
        let mut tree = Tree::default();
        tree.walk(path, 0)?;
        tree.pages.sort();
        Ok(tree)
    }

    fn walk(&mut self, path: &Path, depth: usize) -> Result<()> {
        let (kind, before) = (kind(path)?, self.leaves.len());
        if matches!(kind, Kind::Other | Kind::Pages) && depth < DEEPEST {
            folders_in(path)?.iter().try_for_each(|folder| self.walk(folder, depth + 1))?;
        }
        let is_group = self.leaves[before..].iter().any(|(_, kind)| *kind != Kind::Other);
        if !is_group {
            self.leaves.truncate(before);
            self.leaves.push((path.to_path_buf(), kind));
        }
        if is_group || matches!(kind, Kind::Across | Kind::Pages) {
            let pages = names_in(path)?.into_iter().filter(|name| name.ends_with(".md"));
            let by_people = pages
                .filter(|name| !(kind == Kind::Across && [ACROSS_PAGE, OVER_SCENES_PAGE].contains(&name.as_str())));
            self.pages.extend(by_people.map(|name| path.join(name)));
        }
        Ok(())
    }

    /// Whether a folder holds results of its own.
    pub fn is_leaf(&self, folder: &Path) -> bool {
        self.leaves.iter().any(|(leaf, kind)| leaf == folder && *kind != Kind::Pages)
    }

    /// Folders that numbers may come from, of this name.
    pub fn named(&self, name: &str) -> Vec<&Path> {
        let sources = self.leaves.iter().filter(|(_, kind)| matches!(kind, Kind::Sweep | Kind::Runs | Kind::Across));
        sources.map(|(path, _)| path.as_path()).filter(|path| path.file_name().is_some_and(|own| own == name)).collect()
    }
}

/// The folder of all results that a path lies in, the path itself where it is one: the nearest that is called `results` or has
/// `quotes.toml`.
pub fn root_of(path: &Path) -> Result<Option<PathBuf>> {
    let absolute = std::path::absolute(path).map_err(|e| Error::unreadable(path, &e))?;
    let is_root = |folder: &&Path| {
        (folder.ends_with("results") || folder.join(QUOTES).is_file()) && !folder.join(DEFINITION).exists()
    };
    Ok(absolute.ancestors().find(is_root).map(Path::to_path_buf))
}

fn kind(path: &Path) -> Result<Kind> {
    let has = |name: &str| path.join(name).exists();
    Ok(match () {
        () if has(VIEW) => Kind::View,
        () if has("points.csv") || has(DEFINITION) => Kind::Sweep,
        () if !run_folders(path)?.is_empty() => Kind::Runs,
        () if !folders_in(path)?.is_empty() => Kind::Other,
        () if has(ACROSS) || has(OVER_SCENES) => Kind::Across,
        () if holds_pages_alone(path)? => Kind::Pages,
        () => Kind::Other,
    })
}

/// Whether people wrote all that a folder holds: a page at least, and nothing that the program leaves in results.
fn holds_pages_alone(path: &Path) -> Result<bool> {
    let names = names_in(path)?;
    let is_made = |name: &String| files::is_kept(name) || EXPORTERS.iter().any(|exporter| exporter.owns(name));
    Ok(names.iter().any(|name| name.ends_with(".md")) && !names.iter().any(is_made))
}

/// The folders in a folder, by name.
fn folders_in(path: &Path) -> Result<Vec<PathBuf>> {
    let paths = names_in(path)?.into_iter().map(|name| path.join(name));
    Ok(paths.filter(|path| path.is_dir()).collect())
}

/// Names in a folder, folders among them.
pub fn names_in(folder: &Path) -> Result<Vec<String>> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|e| Error::unreadable(folder, &e))? {
        let entry = entry.map_err(|e| Error::unreadable(folder, &e))?;
        names.push(entry.file_name().to_string_lossy().into_owned());
    }
    names.sort();
    Ok(names)
}
