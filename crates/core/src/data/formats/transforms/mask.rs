//! Masks: which pixels of a photo count (nerfstudio's `mask_path`).

use std::path::{Path, PathBuf};

use crate::base::{Error, Image, Result};
use crate::data::json::Object;
use crate::data::{images, resample};

/// Its key in files.
pub(super) const KEY: &str = "mask_path";
/// Fraction of a pixel's area that must count for the pixel to count: all of it, except for rounding.
const WHOLE: f32 = 1.0 - 1e-4;

/// Returns the mask that a frame names, or the document for all frames.
pub(super) fn file_of(frame: Object, document: Object) -> Result<Option<PathBuf>> {
    let Some(owner) = [frame, document].into_iter().find(|object| object.get(KEY).is_some()) else { return Ok(None) };
    let picture = owner.picture(KEY)?;
    let missing = || {
        let what = format!(
            "\"{KEY}\" is \"{}\", but there is no such image: what it masks would be trained on",
            picture.written
        );
        owner.error(&what)
    };
    picture.path.clone().map(Some).ok_or_else(missing)
}

/// A masked photo.
pub(super) struct Masked<'a> {
    /// Its file.
    pub(super) path: &'a Path,
    /// Its width and height.
    pub(super) size: (usize, usize),
}

/// Reads which pixels of the photo's view of `width` x `height` count, row by row: those without any black of the mask.
/// `rectified` removes the photo's distortion.
pub(super) fn read(
    file: &Path,
    photograph: &Masked,
    rectified: impl Fn(Image) -> Image,
    (width, height): (usize, usize),
) -> Result<Vec<bool>> {
    let mask = counting(file)?;
    let (columns, rows) = photograph.size;
    let shape = (mask.width as f64 * rows as f64 / columns as f64 - mask.height as f64).abs();
    if mask.width < columns || mask.height < rows || shape > 1.0 {
        return Err(Error::Data(format!(
            "{} is {}x{} pixels, but its photo {} is {columns}x{rows}; a mask must have the photo's size, or be larger and of \
             the same shape",
            file.display(),
            mask.width,
            mask.height,
            photograph.path.display()
        )));
    }
    let mask = rectified(resample::shrink(&mask, columns, rows));
    let kept: Vec<bool> = resample::shrink(&mask, width, height).pixels.iter().map(|&share| share >= WHOLE).collect();
    if !kept.contains(&true) {
        return Err(Error::Data(format!(
            "{} leaves no pixel of {} at {width}x{height} (black is masked): remove the frame, or correct the mask",
            file.display(),
            photograph.path.display()
        )));
    }
    Ok(kept)
}

/// Returns 1 where a mask counts, and 0 where it is black or transparent. In a lossy format such as JPEG, black has
/// dark artefacts around it; there everything brighter than half counts.
fn counting(file: &Path) -> Result<Image> {
    let darkest = if images::may_be_lossy(file)? { u16::MAX / 2 } else { 0 };
    let mask = images::decode(file)?.into_luma_alpha16();
    let (width, height) = (mask.width() as usize, mask.height() as usize);
    let pixels = mask.pixels().map(|pixel| f32::from(u8::from(pixel.0[0] > darkest && pixel.0[1] > 0))).collect();
    Ok(Image { width, height, channels: 1, pixels })
}
