//! The photos of an LLFF scene: as many as there are poses, in the order of their names.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::found;
use crate::images::{self, Header, Size};
use crate::photo_files::Chooser;
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

/// Finds the images of `poses` poses.
///
/// `shape` are width and height for which the poses were made: photos that fit only if they are turned by their EXIF
/// orientation are. `listed` are the names of the photos that have poses, if they are known; endings do not count.
pub(super) fn find(
    dir: &Path,
    size: Size,
    (poses, shape): (usize, [f64; 2]),
    listed: Option<&BTreeSet<String>>,
) -> Result<Source> {
    let files_in = |folder: &Path| -> Result<Vec<Option<PathBuf>>> {
        Ok(with_poses(images::list(folder)?, poses, listed).into_iter().map(Some).collect())
    };
    // All photos of a folder must have one size: the first has it.
    let columns = |files: &[Option<PathBuf>]| -> Result<usize> {
        let Some(first) = files.iter().flatten().next() else { return Ok(0) };
        Ok(Header::read(first)?.turned_to_fit(|size| is_of_shape(size, shape)).size.0)
    };
    let count = |found, poses| format!("{found} images for {poses} poses");
    let chooser = Chooser { dir, size, all: poses, files_in: &files_in, columns: &columns, count };
    let chosen = match chooser.choose(photo_folders(dir, poses)?, true)? {
        None => chooser.reduced()?.filter(|reduced| reduced.found() == poses),
        chosen => chosen,
    };
    let Some(chosen) = chosen else { return Err(none(dir, size)?) };
    let paths: Vec<PathBuf> = chosen.files.iter().flatten().cloned().collect();
    let headers = images::headers_of_one_size(&paths, |size| is_of_shape(size, shape))?;
    let stored = headers[0].size;
    let target = match size {
        Size::Factor(factor) => chosen.reduced(stored, factor),
        width => width.apply(stored, &paths[0])?,
    };
    Ok(Source { paths, headers, stored, target, passed: chosen.passed, reduced: chosen.elsewhere })
}

/// Returns whether an image of this width and height is a scaled one of a shape.
pub(super) fn is_of_shape((columns, rows): (usize, usize), [width, height]: [f64; 2]) -> bool {
    (columns as f64 * height / width - rows as f64).abs() <= 1.0
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

/// Returns the folders `images` and `images_*`; without any, the only folder with an image per pose.
fn photo_folders(dir: &Path, poses: usize) -> Result<Vec<(usize, PathBuf)>> {
    let named = images::folders(dir)?;
    if !named.is_empty() {
        return Ok(named);
    }
    let entries = std::fs::read_dir(dir).map_err(|e| Error::unreadable(dir, &e))?;
    let is_photos =
        |path: &Path| path.file_name().is_some_and(|name| found::is_photo(&name.to_string_lossy().to_lowercase()));
    let has_all = |path: &PathBuf| is_photos(path) && images::list(path).is_ok_and(|paths| paths.len() == poses);
    let found: Vec<(usize, PathBuf)> =
        entries.flatten().map(|entry| entry.path()).filter(has_all).map(|path| (1, path)).collect();
    Ok(if found.len() == 1 { found } else { Vec::new() })
}

fn none(dir: &Path, size: Size) -> Result<Error> {
    let wanted = match size {
        Size::Factor(1) => "no images to read with data.downscale = 1".into(),
        Size::Factor(factor) => {
            format!("no images in images_{factor} or images to read with data.downscale = {factor}")
        }
        Size::Width(width) => format!("no images of at least data.width = {width} columns"),
    };
    Ok(Error::Data(format!(
        "{} has {wanted}; it has {}; set data.downscale to a factor that is there, or data.width to the columns that you want, or \
         add the folder",
        dir.display(),
        images::folder_names(dir)?
    )))
}
