//! Masks: which pixels of a photograph count (nerfstudio's `mask_path`).

use std::path::{Path, PathBuf};

use crate::base::{Error, Image, Result};
use crate::data::json::Object;
use crate::data::{images, resample};

/// Its name in files.
pub(super) const KEY: &str = "mask_path";
/// Share of a pixel's area that has to count for the pixel to count: all of it, but for rounding.
const WHOLE: f32 = 1.0 - 1e-4;

/// The mask that a frame names, or the document for all frames.
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

/// A photograph that is masked.
pub(super) struct Masked<'a> {
    /// Its file.
    pub(super) path: &'a Path,
    /// Its width and height.
    pub(super) size: (usize, usize),
}

/// Which pixels of the photograph's view of `width` x `height` count, row by row: those of whose area the mask is black nowhere.
/// `rectified` undoes the photograph's distortion.
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
            "{} is {}x{} pixels, but the photograph that it masks, {}, is {columns}x{rows}: a mask has its size, or is larger and of \
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
            "{} leaves no pixel of {} at {width}x{height} (black is masked): remove the frame, or mend the mask",
            file.display(),
            photograph.path.display()
        )));
    }
    Ok(kept)
}

/// 1 where a mask counts, 0 where it is black or clear. Where values may have been lost on the way, as by JPEG, black has dark
/// specks around it that are none of its author's: there what is brighter than half counts.
fn counting(file: &Path) -> Result<Image> {
    let darkest = if images::may_be_lossy(file)? { u16::MAX / 2 } else { 0 };
    let mask = images::decode(file)?.into_luma_alpha16();
    let (width, height) = (mask.width() as usize, mask.height() as usize);
    let pixels = mask.pixels().map(|pixel| f32::from(u8::from(pixel.0[0] > darkest && pixel.0[1] > 0))).collect();
    Ok(Image { width, height, channels: 1, pixels })
}
