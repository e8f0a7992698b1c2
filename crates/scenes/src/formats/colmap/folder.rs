//! The choice among a COLMAP scene's image folders: `images`, or a smaller `images_{factor}` next to it.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use super::model::Photograph;
use crate::found::{self, Below};
use crate::images::{self, Size};
use augnerf_base::{Error, Result};

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
    let mut folders = images::folders(dir)?;
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
        let source = within(folder, *factor, photographs);
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
    let best = best.or_else(|| reduced(dir, photographs, size));
    let Some(source) = best else { return Err(none(dir, photographs, size)?) };
    if source.found() == photographs.len() {
        return Ok(Source { passed, ..source });
    }
    Ok(source)
}

/// Returns the photos in a folder.
fn within(folder: &Path, factor: usize, photographs: &[Photograph]) -> Source {
    let mut files: Vec<_> = photographs.iter().map(|photograph| file(folder, &photograph.name)).collect();
    let renamed = find_renamed(folder, photographs, &mut files);
    Source { files, factor, passed: Vec::new(), renamed, moved: None }
}

/// Returns the photos in the largest of the reduced folders, if no other has them.
fn reduced(dir: &Path, photographs: &[Photograph], size: Size) -> Option<Source> {
    let Size::Factor(_) = size else { return None };
    let all =
        images::folders(dir).ok()?.into_iter().map(|(factor, folder)| (within(&folder, factor, photographs), folder));
    let (source, folder) = all.into_iter().find(|(source, _)| source.found() > 0)?;
    let words = found::reduced_words(folder.strip_prefix(dir).unwrap_or(&folder), source.factor, size);
    Some(Source { moved: Some(words), ..source })
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
    let there: Vec<String> = images::folders(dir)?.iter().map(|(_, folder)| folder.display().to_string()).collect();
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
    let there = found::below(folder).into_iter().filter(|within| !taken.contains(&folder.join(within))).collect();
    let there = Below::of(there);
    fill(folder, photographs, files, |name| there.under_same_name(name))
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
    let there = Below::of(found::below(dir).into_iter().filter(|path| !is_smaller(path)).collect());
    let mut files = vec![None; photographs.len()];
    let mut found = fill(dir, photographs, &mut files, |name| there.by_end(name));
    if found == 0 {
        let names: Vec<&str> = photographs.iter().map(|photograph| photograph.name.as_str()).collect();
        let (_, of_folder) = there.renamed_folder(&names, 1)?;
        files = of_folder.into_iter().map(|file| file.map(|file| dir.join(file))).collect();
        found = files.iter().flatten().count();
    }
    let moved = files.iter().flatten().next().and_then(|file| file.strip_prefix(dir).ok()).map(|file| {
        format!("{found} photos are not where the model says, and were found elsewhere: such as {}", file.display())
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
