//! The photos of a COLMAP scene, by the names in its model.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use crate::found::{self, Below};
use crate::images::{self, Size};
use crate::photo_files::{Chooser, Chosen};
use augnerf_base::{Error, Result};

/// Finds the photos of these names. `columns` returns those of the widest of them.
pub(super) fn find(
    dir: &Path,
    names: &[&str],
    size: Size,
    columns: &dyn Fn(&[Option<PathBuf>]) -> Result<usize>,
) -> Result<Chosen> {
    let files_in = |folder: &Path| Ok(within(folder, names));
    let count = |found, all| format!("{found} of {all} images");
    let chooser = Chooser { dir, size, all: names.len(), files_in: &files_in, columns, count };
    let chosen = chooser.choose(images::folders(dir)?, false)?.or_else(|| elsewhere(dir, names));
    let chosen = if chosen.is_none() { chooser.reduced()? } else { chosen };
    chosen.map_or_else(|| Err(none(dir, names, size)?), Ok)
}

/// Returns the photos in a folder. Letter case and Unicode form count only if two photos differ in nothing else.
fn within(folder: &Path, names: &[&str]) -> Vec<Option<PathBuf>> {
    let mut files: Vec<_> = names.iter().map(|name| file(folder, name)).collect();
    if files.contains(&None) {
        let taken: HashSet<&PathBuf> = files.iter().flatten().collect();
        let others = found::below(folder).into_iter().filter(|within| !taken.contains(&folder.join(within)));
        let others = Below::of(others.collect());
        fill(folder, names, &mut files, |name| others.under_same_name(name));
    }
    files
}

fn none(dir: &Path, names: &[&str], size: Size) -> Result<Error> {
    let wanted = match size {
        Size::Factor(factor) => format!("data.downscale = {factor}"),
        Size::Width(width) => format!("data.width = {width}"),
    };
    Ok(Error::Data(format!(
        "{} has none of the {} images of its COLMAP model, such as {:?}, for {wanted}, in images or a smaller images_2, images_4, \
         images_8; it has {}",
        dir.display(),
        names.len(),
        names.first().unwrap_or(&""),
        images::folder_names(dir)?
    )))
}

/// Fills in missing files below a folder. A file that two photos mean is neither's.
fn fill<'a>(folder: &Path, names: &[&str], files: &mut [Option<PathBuf>], find: impl Fn(&str) -> Option<&'a Path>) {
    let missing = (0..names.len()).filter(|&i| files[i].is_none());
    let found: Vec<(usize, &Path)> = missing.filter_map(|i| Some((i, find(names[i])?))).collect();
    let mut times: HashMap<&Path, usize> = HashMap::new();
    found.iter().for_each(|(_, path)| *times.entry(path).or_default() += 1);
    let single = found.into_iter().filter(|(_, path)| times[path] == 1);
    single.for_each(|(i, path)| files[i] = Some(folder.join(path)));
}

/// Looks for the photos anywhere below the scene's folder, but for smaller copies.
fn elsewhere(dir: &Path, names: &[&str]) -> Option<Chosen> {
    let there = Below::of(found::below(dir).into_iter().filter(|path| found::factor_in(path) == 1).collect());
    let mut files = vec![None; names.len()];
    fill(dir, names, &mut files, |name| there.by_end(name));
    if files.iter().all(Option::is_none) {
        let (_, of_folder) = there.renamed_folder(names, 1)?;
        files = of_folder.into_iter().map(|file| file.map(|file| dir.join(file))).collect();
    }
    let found: Vec<&PathBuf> = files.iter().flatten().collect();
    let words = format!(
        "{} photos are not where the model says, and were found elsewhere: such as {}",
        found.len(),
        found.first()?.strip_prefix(dir).ok()?.display()
    );
    Some(Chosen { files, factor: 1, passed: Vec::new(), elsewhere: Some(words) })
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
