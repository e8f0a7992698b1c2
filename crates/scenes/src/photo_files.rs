//! The choice among a scene's image folders: `images`, or a smaller `images_{factor}` next to it.

use std::cmp::Reverse;
use std::path::{Path, PathBuf};

use super::found;
use super::images::{self, Size};
use augnerf_base::Result;

/// The files of a scene's photos, in the folder that suits the working resolution best.
pub(super) struct Chosen {
    /// A file for each photo. `None` for missing ones.
    pub(super) files: Vec<Option<PathBuf>>,
    /// The factor by which the folder's photos are reduced.
    pub(super) factor: usize,
    /// Folders that were not used, for people.
    pub(super) passed: Vec<String>,
    /// Where photos are that are not in a folder for the working resolution, for people.
    pub(super) elsewhere: Option<String>,
}

impl Chosen {
    /// Returns the number of photos that are there.
    pub(super) fn found(&self) -> usize {
        self.files.iter().flatten().count()
    }

    /// Returns a photo's width and height, from those as stored, reduced by the rest of a factor: to the nearest pixel, as
    /// ImageMagick made the published folders. Photos whose factor does not divide it stay as they are.
    pub(super) fn reduced(&self, (width, height): (usize, usize), factor: usize) -> (usize, usize) {
        let rest = if factor.is_multiple_of(self.factor) { factor / self.factor } else { 1 };
        let divide = |side: usize| ((side as f64 / rest as f64).round() as usize).max(1);
        (divide(width), divide(height))
    }
}

/// What is chosen for.
pub(super) struct Chooser<'a> {
    /// The scene's folder.
    pub(super) dir: &'a Path,
    /// The working resolution.
    pub(super) size: Size,
    /// Number of photos.
    pub(super) all: usize,
    /// Returns the files in a folder: one for each photo, or `None` for missing ones.
    pub(super) files_in: &'a dyn Fn(&Path) -> Result<Vec<Option<PathBuf>>>,
    /// Returns the columns of the widest of these photos, turned to fit; 0 if none is there.
    pub(super) columns: &'a dyn Fn(&[Option<PathBuf>]) -> Result<usize>,
    /// Says how many photos a folder has of how many, for people.
    pub(super) count: fn(usize, usize) -> String,
}

impl Chooser<'_> {
    /// Chooses among folders, each with its factor. For a factor: the folder of that factor, then the originals, then those
    /// whose factor divides it, beginning with the `smallest` photos or the largest. For a width: the smallest photos of which
    /// one is at least as wide, by their headers. A folder without some of the photos is not used if another has them all.
    pub(super) fn choose(&self, mut folders: Vec<(usize, PathBuf)>, smallest: bool) -> Result<Option<Chosen>> {
        match self.size {
            Size::Factor(wanted) => {
                folders.retain(|(factor, _)| wanted.is_multiple_of(*factor));
                let order = |factor: usize| if smallest { wanted / factor } else { factor };
                folders.sort_by_key(|(factor, _)| (*factor != wanted, *factor != 1, order(*factor)));
            }
            Size::Width(width) => {
                // Photos that cannot be measured come last, and are an error only if they are needed.
                let columns = |folder: &Path| (self.columns)(&(self.files_in)(folder)?);
                let measured = folders.into_iter().map(|(factor, folder)| {
                    let columns = columns(&folder).unwrap_or(usize::MAX);
                    (columns, Reverse(factor), folder)
                });
                let mut wide: Vec<_> = measured.filter(|(columns, ..)| *columns >= width).collect();
                wide.sort();
                folders = wide.into_iter().map(|(_, Reverse(factor), folder)| (factor, folder)).collect();
            }
        }
        self.first_of(folders)
    }

    /// Returns the photos in the largest of the reduced folders, if no other has them.
    pub(super) fn reduced(&self) -> Result<Option<Chosen>> {
        let Size::Factor(wanted) = self.size else { return Ok(None) };
        let mut folders = images::folders(self.dir)?;
        folders.retain(|(factor, _)| !wanted.is_multiple_of(*factor));
        let words = |factor: usize| found::reduced_words(Path::new(&format!("images_{factor}")), factor, self.size);
        let chosen = self.first_of(folders)?;
        Ok(chosen.map(|chosen| Chosen { elsewhere: Some(words(chosen.factor)), ..chosen }))
    }

    /// Returns the first folder that has all photos, or else the first of those that have the most. More than all count as all.
    fn first_of(&self, folders: Vec<(usize, PathBuf)>) -> Result<Option<Chosen>> {
        let mut best: Option<Chosen> = None;
        let mut passed = Vec::new();
        for (factor, folder) in folders {
            let chosen = Chosen { files: (self.files_in)(&folder)?, factor, passed: Vec::new(), elsewhere: None };
            let found = chosen.found();
            if found == 0 {
                continue;
            }
            if found == self.all {
                return Ok(Some(Chosen { passed, ..chosen }));
            }
            passed.push(format!("{} has {}", folder.display(), (self.count)(found, self.all)));
            if best.as_ref().is_none_or(|best| best.found().min(self.all) < found.min(self.all)) {
                best = Some(chosen);
            }
        }
        Ok(best)
    }
}
