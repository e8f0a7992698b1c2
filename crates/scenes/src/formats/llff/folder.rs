//! The choice among an LLFF folder's image folders.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::found;
use crate::images::{self, Header, Size};
use augnerf_base::{Error, Result};

/// The files to read, and their working size.
pub(super) struct Source {
    /// Image files in the order of the poses.
    pub(super) paths: Vec<PathBuf>,
    /// Their headers.
    pub(super) headers: Vec<Header>,
    /// Width and height as stored, or turned.
    pub(super) stored: (usize, usize),
    /// Width and height to average them down to.
    pub(super) target: (usize, usize),
    /// Folders that were not used, for people.
    pub(super) passed: Vec<String>,
    /// Says that reduced photos stand for others.
    pub(super) reduced: Option<String>,
}

/// Finds the images of `poses` poses. For a factor: `images_{factor}` as it is, `images` averaged down, or a folder
/// whose factor divides it, or the largest that is there. For a width: the smallest folder that is at least as wide. A folder without an image per
/// pose is not used if another has them.
///
/// `shape` are width and height for which the poses were made: photos that fit only if they are turned by their EXIF
/// orientation are. `listed` are the names of the photos that have poses, if they are known; endings do not count.
pub(super) fn find(
    dir: &Path,
    size: Size,
    (poses, shape): (usize, [f64; 2]),
    listed: Option<&BTreeSet<String>>,
) -> Result<Source> {
    let fits = |size: (usize, usize)| is_of_shape(size, shape);
    match size {
        Size::Factor(factor) => by_factor(dir, factor, poses, fits, listed),
        Size::Width(width) => by_width(dir, width, poses, fits, listed),
    }
}

/// Returns whether an image of this width and height is a scaled one of a shape.
pub(super) fn is_of_shape((columns, rows): (usize, usize), [width, height]: [f64; 2]) -> bool {
    (columns as f64 * height / width - rows as f64).abs() <= 1.0
}

fn by_factor(
    dir: &Path,
    factor: usize,
    poses: usize,
    fits: impl Fn((usize, usize)) -> bool,
    listed: Option<&BTreeSet<String>>,
) -> Result<Source> {
    let (mut found, mut smaller) = (Vec::new(), Vec::<(usize, Vec<PathBuf>)>::new());
    for name in photo_folders(dir, poses)? {
        let of = images::factor_of(&name).unwrap_or(1);
        let fitting = if factor.is_multiple_of(of) { &mut found } else { &mut smaller };
        fitting.push((of, with_poses(images::list(&dir.join(name))?, poses, listed)));
    }
    // Folders of the factor first, then the originals, then the smallest that can be averaged.
    found.sort_by_key(|(of, _)| (*of != factor, *of != 1, std::cmp::Reverse(*of)));
    found.retain(|(_, paths)| !paths.is_empty());
    let mut reduced = None;
    let of_smaller = smaller.into_iter().filter(|(_, paths)| paths.len() == poses).min_by_key(|(of, _)| *of);
    if let Some((of, paths)) = of_smaller.filter(|_| found.is_empty()) {
        let folder = PathBuf::from(format!("images_{of}"));
        reduced = Some(found::reduced_words(&folder, of, Size::Factor(factor)));
        found.push((of, paths));
    }
    let factor = if reduced.is_some() { found[0].0 } else { factor };
    let whole = found.iter().position(|(_, paths)| paths.len() == poses);
    let passed = found.iter().take(whole.unwrap_or(0)).map(|(_, paths)| passed_over(paths, poses)).collect();
    if found.is_empty() {
        let wanted = if factor > 1 { format!("no images in images_{factor} or images") } else { "no images".into() };
        return Err(Error::Data(format!(
            "{} has {wanted} to read with data.downscale = {factor}; it has {}; \
             set data.downscale to a factor that is there, or data.width to the columns that you want, or add the folder",
            dir.display(),
            describe_folders(dir)?
        )));
    }
    let (of, paths) = found.swap_remove(whole.unwrap_or(0));
    let headers = images::headers_of_one_size(&paths, fits)?;
    let stored = headers[0].size;
    // To the nearest pixel, as ImageMagick made the published folders.
    let divide = |n: usize| ((n as f64 * of as f64 / factor as f64).round() as usize).max(1);
    Ok(Source { paths, headers, stored, target: (divide(stored.0), divide(stored.1)), passed, reduced })
}

fn by_width(
    dir: &Path,
    width: usize,
    poses: usize,
    fits: impl Fn((usize, usize)) -> bool,
    listed: Option<&BTreeSet<String>>,
) -> Result<Source> {
    let mut found = Vec::new();
    for name in photo_folders(dir, poses)? {
        let paths = with_poses(images::list(&dir.join(name))?, poses, listed);
        let Some(first) = paths.first() else { continue };
        let stored = Header::read(first)?.turned_to_fit(&fits).size;
        if stored.0 >= width {
            found.push((paths.len() != poses, stored.0, paths));
        }
    }
    let best = (0..found.len()).min_by_key(|&i| (found[i].0, found[i].1));
    let Some((_, columns, paths)) = best.map(|i| found.swap_remove(i)) else {
        return Err(Error::Data(format!(
            "{} has no images of at least data.width = {width} columns; it has {}",
            dir.display(),
            describe_folders(dir)?
        )));
    };
    let headers = images::headers_of_one_size(&paths, fits)?;
    let stored = headers[0].size;
    let target = Size::Width(width).apply(stored, &paths[0])?;
    let smaller = found.iter().filter(|(lacking, ..)| *lacking).filter(|(_, other, _)| *other < columns);
    let passed = smaller.map(|(_, _, paths)| passed_over(paths, poses)).collect();
    Ok(Source { paths, headers, stored, target, passed, reduced: None })
}

/// Returns the photos that have poses, if a folder has more than these and all of them.
fn with_poses(paths: Vec<PathBuf>, poses: usize, listed: Option<&BTreeSet<String>>) -> Vec<PathBuf> {
    let paths = if paths.len() > poses { found::without_twins(paths) } else { paths };
    let Some(listed) = listed.filter(|_| paths.len() > poses) else { return paths };
    let stem = |name: &Path| name.file_stem().map(|stem| found::name_key(Path::new(stem)));
    let stems: BTreeSet<String> = listed.iter().filter_map(|name| stem(Path::new(name))).collect();
    let chosen: Vec<PathBuf> =
        paths.iter().filter(|path| stem(path).is_some_and(|stem| stems.contains(&stem))).cloned().collect();
    if chosen.len() == poses { chosen } else { paths }
}

fn passed_over(paths: &[PathBuf], poses: usize) -> String {
    let folder = paths.first().and_then(|path| path.parent()).unwrap_or(Path::new(""));
    format!("{} has {} images for {poses} poses", folder.display(), paths.len())
}

/// Returns the names of the folders `images` and `images_*`; without any, that of the only folder with an image per pose.
fn photo_folders(dir: &Path, poses: usize) -> Result<Vec<String>> {
    let named = folders(dir)?;
    if !named.is_empty() {
        return Ok(named);
    }
    let entries = std::fs::read_dir(dir).map_err(|e| Error::unreadable(dir, &e))?;
    let is_photos = |name: &str| found::is_photo(&name.to_lowercase());
    let has_all =
        |name: &String| is_photos(name) && images::list(&dir.join(name)).is_ok_and(|paths| paths.len() == poses);
    let names = entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned());
    let found: Vec<String> = names.filter(has_all).collect();
    Ok(if found.len() == 1 { found } else { Vec::new() })
}

/// Returns the names of the folders `images` and `images_*`.
fn folders(dir: &Path) -> Result<Vec<String>> {
    let name = |folder: &Path| folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Ok(images::folders(dir)?.iter().map(|(_, folder)| name(folder)).collect())
}

fn describe_folders(dir: &Path) -> Result<String> {
    let names = folders(dir)?;
    Ok(if names.is_empty() { "no images_* folder at all".into() } else { names.join(", ") })
}
