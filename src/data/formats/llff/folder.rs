//! Which of an LLFF folder's image folders is read.

use std::path::{Path, PathBuf};

use crate::base::{Error, Result};
use crate::data::images::{self, Size};

/// The files to read and the size to bring them to.
pub(super) struct Source {
    /// Image files in the order of the poses.
    pub(super) paths: Vec<PathBuf>,
    /// Width and height that they have now.
    pub(super) stored: (usize, usize),
    /// Width and height to average them down to.
    pub(super) target: (usize, usize),
}

impl Source {
    /// Which files are read, and what is made of them.
    pub(super) fn words(&self) -> String {
        images::folder_words(&self.paths, self.stored, self.target)
    }
}

/// Finds the images: for a factor, `images_{factor}` as it is or `images` averaged down; for a
/// width, the smallest folder that is at least as wide.
pub(super) fn find(dir: &Path, size: Size) -> Result<Source> {
    match size {
        Size::Factor(factor) => by_factor(dir, factor),
        Size::Width(width) => by_width(dir, width),
    }
}

fn by_factor(dir: &Path, factor: usize) -> Result<Source> {
    let (ready, full) = (dir.join(format!("images_{factor}")), dir.join("images"));
    if factor > 1 && ready.is_dir() {
        let (paths, stored) = open(&ready)?;
        return Ok(Source { paths, stored, target: stored });
    }
    if !full.is_dir() {
        let wanted = if factor > 1 { format!("neither images_{factor} nor images") } else { "no images".into() };
        return Err(Error::Data(format!(
            "{} has {wanted} to read with data.downscale = {factor}; it has {}; \
             set data.downscale to a factor that is there, or data.width to the columns that you want, or add the folder",
            dir.display(),
            describe_folders(dir)?
        )));
    }
    let (paths, stored) = open(&full)?;
    // To the nearest, as ImageMagick made the published folders.
    let divide = |n: usize| ((n as f64 / factor as f64).round() as usize).max(1);
    Ok(Source { paths, stored, target: (divide(stored.0), divide(stored.1)) })
}

fn by_width(dir: &Path, width: usize) -> Result<Source> {
    let mut best: Option<(Vec<PathBuf>, (usize, usize))> = None;
    for name in folders(dir)? {
        let paths = images::list(&dir.join(name))?;
        let Some(first) = paths.first() else { continue };
        let stored = images::size(first)?;
        let better = best.as_ref().is_none_or(|(_, found)| stored.0 < found.0);
        if stored.0 >= width && better {
            best = Some((paths, stored));
        }
    }
    let Some((paths, _)) = best else {
        return Err(Error::Data(format!(
            "{} has no images of at least data.width = {width} columns; it has {}",
            dir.display(),
            describe_folders(dir)?
        )));
    };
    let stored = images::common_size(&paths)?;
    let target = Size::Width(width).apply(stored, &paths[0])?;
    Ok(Source { paths, stored, target })
}

fn open(dir: &Path) -> Result<(Vec<PathBuf>, (usize, usize))> {
    let paths = images::list(dir)?;
    if paths.is_empty() {
        return Err(Error::Data(format!("{} holds no PNG or JPEG files", dir.display())));
    }
    let stored = images::common_size(&paths)?;
    Ok((paths, stored))
}

/// Names of the folders `images` and `images_*`, sorted.
fn folders(dir: &Path) -> Result<Vec<String>> {
    let entries = std::fs::read_dir(dir).map_err(|e| Error::unreadable(dir, &e))?;
    let mut names: Vec<String> = entries
        .flatten()
        .filter(|entry| entry.path().is_dir())
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .filter(|name| name == "images" || name.starts_with("images_"))
        .collect();
    names.sort();
    Ok(names)
}

fn describe_folders(dir: &Path) -> Result<String> {
    let names = folders(dir)?;
    Ok(if names.is_empty() { "no images_* folder at all".into() } else { names.join(", ") })
}
