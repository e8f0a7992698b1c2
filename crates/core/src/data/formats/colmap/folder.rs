//! The choice among a COLMAP scene's image folders: `images`, or a smaller `images_{factor}` next to it.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use super::model::Photograph;
use crate::base::{Error, Result};
use crate::data::images::{self, Size};

/// Returns the folders of images, each with the reduction factor in its name.
fn folders(dir: &Path) -> Result<Vec<(usize, PathBuf)>> {
    let entries = std::fs::read_dir(dir).map_err(|e| Error::unreadable(dir, &e))?;
    let named = entries.flatten().filter(|entry| entry.path().is_dir());
    let mut found: Vec<(usize, PathBuf)> = named
        .filter_map(|entry| Some((images::factor_of(&entry.file_name().to_string_lossy())?, entry.path())))
        .collect();
    found.sort();
    Ok(found)
}

/// The files of a scene's photos in the folder that suits the working resolution best.
pub(super) struct Source {
    /// A file for each photo. `None` for missing ones.
    pub(super) files: Vec<Option<PathBuf>>,
    /// The reduction factor in the folder's name.
    pub(super) factor: usize,
    /// Folders that were not used, for people.
    pub(super) passed: Vec<String>,
    /// Number of photos whose names differ from the model's in letter case or Unicode form.
    pub(super) renamed: usize,
    /// Where photos were found that are in no folder of images, for people.
    pub(super) moved: Option<String>,
}

impl Source {
    fn found(&self) -> usize {
        self.files.iter().flatten().count()
    }
}

/// Chooses a folder. For a factor: the folder of that factor, then `images`, then one whose factor divides it. For a
/// width: the smallest that is at least as wide. A folder without some of the photos is not used if another has them
/// all.
pub(super) fn find(dir: &Path, photographs: &[Photograph], size: Size) -> Result<Source> {
    let mut folders = folders(dir)?;
    match size {
        Size::Factor(wanted) => {
            let wanted = wanted.max(1);
            folders.retain(|(factor, _)| wanted.is_multiple_of(*factor));
            folders.sort_by_key(|(factor, _)| (*factor != wanted, *factor));
        }
        // Smaller ones first.
        Size::Width(_) => folders.reverse(),
    }
    let mut best: Option<Source> = None;
    let mut passed = Vec::new();
    for (factor, folder) in &folders {
        let mut files: Vec<_> = photographs.iter().map(|photograph| file(folder, &photograph.name)).collect();
        let renamed = find_renamed(folder, photographs, &mut files);
        let source = Source { files, factor: *factor, passed: Vec::new(), renamed, moved: None };
        let (found, all) = (source.found(), photographs.len());
        if let Size::Width(width) = size
            && widest(&source.files)?.is_some_and(|widest| widest < width)
        {
            continue;
        }
        if found < all {
            passed.push(format!("{} has {found} of {all} images", folder.display()));
        }
        if best.as_ref().is_none_or(|best| best.found() < found) {
            best = Some(source);
        }
        if found == all {
            break;
        }
    }
    let best = best.filter(|source| source.found() > 0).or_else(|| elsewhere(dir, photographs));
    let Some(source) = best else { return Err(none(dir, photographs, size)?) };
    if source.found() == photographs.len() {
        return Ok(Source { passed, ..source });
    }
    Ok(source)
}

/// Returns the columns of the widest of these files, by which a width is measured.
fn widest(files: &[Option<PathBuf>]) -> Result<Option<usize>> {
    let columns: Result<Vec<usize>> = files.iter().flatten().map(|file| Ok(images::size(file)?.0)).collect();
    Ok(columns?.into_iter().max())
}

fn none(dir: &Path, photographs: &[Photograph], size: Size) -> Result<Error> {
    let wanted = match size {
        Size::Factor(factor) => format!("data.downscale = {factor}"),
        Size::Width(width) => format!("data.width = {width}"),
    };
    let there: Vec<String> = folders(dir)?.iter().map(|(_, folder)| folder.display().to_string()).collect();
    let looked =
        if there.is_empty() { "there is no such folder".into() } else { format!("there is {}", there.join(", ")) };
    Ok(Error::Data(format!(
        "{} has none of the {} images of its COLMAP model, such as {:?}, for {wanted}, in images or a smaller images_2, images_4, \
         images_8: {looked}",
        dir.display(),
        photographs.len(),
        photographs.first().map_or("", |photograph| photograph.name.as_str())
    )))
}

/// Fills in the files of photos whose names differ from the model's in letter case or Unicode form, and counts them. A file
/// that is another photo's is left out.
fn find_renamed(folder: &Path, photographs: &[Photograph], files: &mut [Option<PathBuf>]) -> usize {
    if files.iter().all(Option::is_some) {
        return 0;
    }
    let taken: HashSet<PathBuf> = files.iter().flatten().cloned().collect();
    let there: Vec<PathBuf> =
        images::below(folder).into_iter().filter(|within| !taken.contains(&folder.join(within))).collect();
    fill(folder, photographs, files, |name| images::under_same_name(name, &there))
}

/// Fills in missing files below a folder, and counts them. A file that two photos mean is neither's.
fn fill<'a>(
    folder: &Path,
    photographs: &[Photograph],
    files: &mut [Option<PathBuf>],
    find: impl Fn(&str) -> Option<&'a Path>,
) -> usize {
    let missing = || (0..photographs.len()).filter(|&i| files[i].is_none());
    let found: Vec<(usize, &Path)> = missing().filter_map(|i| Some((i, find(&photographs[i].name)?))).collect();
    let mut times: HashMap<&Path, usize> = HashMap::new();
    found.iter().for_each(|(_, path)| *times.entry(path).or_default() += 1);
    let single: Vec<(usize, &Path)> = found.iter().copied().filter(|(_, path)| times[path] == 1).collect();
    single.iter().for_each(|(i, path)| files[*i] = Some(folder.join(path)));
    single.len()
}

/// Looks for the photos anywhere below the scene's folder, but for smaller copies.
fn elsewhere(dir: &Path, photographs: &[Photograph]) -> Option<Source> {
    let is_smaller = |path: &PathBuf| {
        let top = path.components().next().map(|top| top.as_os_str().to_string_lossy().into_owned());
        top.and_then(|top| images::factor_of(&top)).is_some_and(|factor| factor > 1)
    };
    let there: Vec<PathBuf> = images::below(dir).into_iter().filter(|path| !is_smaller(path)).collect();
    let mut files = vec![None; photographs.len()];
    let found = fill(dir, photographs, &mut files, |name| images::place_of(name, &there));
    let moved = files.iter().flatten().next().and_then(|file| file.strip_prefix(dir).ok()).map(|file| {
        format!("{found} photos are in no folder images, and were found elsewhere: such as {}", file.display())
    });
    moved.map(|moved| Source { files, factor: 1, passed: Vec::new(), renamed: 0, moved: Some(moved) })
}

/// Returns a photo's file: with its name, or with another extension, as smaller copies may have.
fn file(folder: &Path, name: &str) -> Option<PathBuf> {
    let file = folder.join(name);
    if file.is_file() && images::is_image(&file) {
        return Some(file);
    }
    let endings = images::ENDINGS.iter().flat_map(|ending| [ending.to_string(), ending.to_ascii_uppercase()]);
    endings.map(|ending| file.with_extension(ending)).find(|file| file.is_file())
}
