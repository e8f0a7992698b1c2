//! Metrics of a rendered view against its photograph (PSNR, SSIM, LPIPS and their average) and against its depth.
//!
//! A metric that is undefined or was not measured is `None`: `null` in JSON and an empty cell in
//! CSV, never a stand-in number. PSNR is undefined where two images are equal (it is infinite
//! there), SSIM where a side is below its window, LPIPS where its weights are not at hand.

mod depth;
mod floor;
mod lpips;
mod masked;
mod registry;
mod ssim;
mod values;
mod weights;

pub use depth::{depth_errors, mean, measure_depth};
pub use floor::{Floor, OneColour, no_better_than_one_colour};
pub use lpips::{Backbone, Lpips};
pub use masked::{share, unmasked_or};
pub use registry::*;
pub use ssim::ssim;
pub use values::{MeanMetrics, Values, ViewMetrics};
pub use weights::Weights;

use rayon::prelude::*;

use augnerf_base::{Error, Image, Result};

/// Measures one view. SSIM and LPIPS, like `psnr`, see the 8-bit rounded images, so that the
/// written PNG files give the same numbers. LPIPS is `None` for backbones that are not among
/// `lpips` and for images below the backbone's smallest side.
///
/// ```
/// # mod augnerf { pub use {augnerf_base as base, augnerf_measure::metrics}; }
/// use augnerf::base::Image;
/// use augnerf::metrics::{Backbone, PSNR, measure};
///
/// let grey = |value| Image { width: 16, height: 16, channels: 3, pixels: vec![value; 16 * 16 * 3] };
/// let metrics = measure("view", &grey(102.0 / 255.0), &grey(127.5 / 255.0), &[])?;
/// // -10 log10 of the mean squared error of the 8-bit colours 102 and 128.
/// let psnr = -20.0 * (26.0f64 / 255.0).log10();
/// assert!((metrics.get(&PSNR).unwrap() - psnr).abs() < 1e-4);
/// assert_eq!(metrics.get(Backbone::Squeeze.lpips()), None);
/// # Ok::<(), augnerf::base::Error>(())
/// ```
pub fn measure(name: &str, rendered: &Image, truth: &Image, lpips: &[Lpips]) -> Result<ViewMetrics> {
    measure_unmasked(name, rendered, truth, None, lpips)
}

/// The same of the pixels that count, where a mask says which do: squared errors are means over these, SSIM is the mean over
/// windows that hold no other. For LPIPS the rendered picture is the photograph where it is masked, and the distance, to which
/// these pixels then add next to nothing, is divided by the share of the others, so that it is a mean over their area.
pub fn measure_unmasked(
    name: &str,
    rendered: &Image,
    truth: &Image,
    mask: Option<&[bool]>,
    lpips: &[Lpips],
) -> Result<ViewMetrics> {
    check_finite(name, rendered)?;
    check_mask(truth, mask)?;
    let error = masked::mse(rendered, truth, mask)?;
    let (rendered, truth) = (quantise(rendered), quantise(truth));
    let mut view = ViewMetrics::new(name);
    view.values.set(&PSNR, masked::mse(&rendered, &truth, mask)?.and_then(psnr_from_mse));
    view.values.set(&PSNR_FLOAT, error.and_then(psnr_from_mse));
    view.values.set(&MSE, error);
    view.values.set(&SSIM, masked::ssim(&rendered, &truth, mask)?);
    let rendered = unmasked_or(rendered, &truth, mask);
    let share = share(mask);
    for model in lpips.iter().filter(|model| share > 0.0 && model.backbone().fits(truth.width, truth.height)) {
        let distance = model.distance(&rendered, &truth)?;
        view.values.set(model.backbone().lpips(), Some(distance / share));
    }
    Ok(view)
}

/// Mean squared error over all pixels and channels, summed in `f64`. The images must have one
/// shape.
pub fn mse(a: &Image, b: &Image) -> Result<f64> {
    check_same_shape(a, b)?;
    let row = a.width * a.channels;
    let rows = a.pixels.par_chunks(row).zip(b.pixels.par_chunks(row)).map(squared_error).collect::<Vec<f64>>();
    // Summed in row order, so that the result does not depend on the number of threads.
    Ok(rows.iter().sum::<f64>() / a.pixels.len() as f64)
}

fn squared_error((a, b): (&[f32], &[f32])) -> f64 {
    a.iter().zip(b).map(|(&x, &y)| (f64::from(x) - f64::from(y)).powi(2)).sum()
}

/// PSNR in dB of images in 0..=1 from their mean squared error: `-10 log10(mse)`. `None` for an
/// error of 0, where PSNR is infinite.
pub fn psnr_from_mse(mse: f64) -> Option<f64> {
    (mse > 0.0).then(|| -10.0 * mse.log10())
}

/// The image after a round trip through 8 bits: clamped to 0..=1 and rounded to multiples of
/// 1/255.
pub fn quantise(image: &Image) -> Image {
    let pixels = image.pixels.iter().map(|p| (p.clamp(0.0, 1.0) * 255.0).round() / 255.0).collect();
    Image { pixels, ..*image }
}

/// PSNR in dB of the images as they are; `None` where they are equal.
pub fn psnr_float(a: &Image, b: &Image) -> Result<Option<f64>> {
    Ok(psnr_from_mse(mse(a, b)?))
}

/// The geometric mean of three errors, `cbrt(10^(-PSNR/10) * sqrt(1 - SSIM) * LPIPS)`, as the
/// Aug-NeRF paper's "average" (after mip-NeRF, section 6). Takes PSNR in dB.
pub fn average(psnr: f64, ssim: f64, lpips: f64) -> f64 {
    // SSIM of nearly equal images may exceed 1 by rounding.
    (10f64.powf(-psnr / 10.0) * (1.0 - ssim).max(0.0).sqrt() * lpips).cbrt()
}

fn check_same_shape(a: &Image, b: &Image) -> Result<()> {
    let shape = |i: &Image| format!("{}x{} with {} channels", i.width, i.height, i.channels);
    if (a.width, a.height, a.channels) != (b.width, b.height, b.channels) {
        let (a, b) = (shape(a), shape(b));
        return Err(Error::Data(format!("cannot compare an image of {a} with one of {b}: they need one size")));
    }
    let count = a.width * a.height * a.channels;
    if count == 0 || a.pixels.len() != count || b.pixels.len() != count {
        let (found, other, shape) = (a.pixels.len(), b.pixels.len(), shape(a));
        return Err(Error::Data(format!("cannot compare images of {shape} that hold {found} and {other} values")));
    }
    Ok(())
}

fn check_mask(image: &Image, mask: Option<&[bool]>) -> Result<()> {
    let pixels = image.width * image.height;
    match mask.map(<[bool]>::len) {
        Some(count) if count != pixels => Err(Error::Data(format!(
            "a mask of {count} pixels is not that of an image of {}x{}",
            image.width, image.height
        ))),
        _ => Ok(()),
    }
}

fn check_finite(name: &str, image: &Image) -> Result<()> {
    match image.pixels.iter().filter(|p| !p.is_finite()).count() {
        0 => Ok(()),
        n => Err(Error::Diverged(format!("rendered view {name} holds {n} values that are not finite"))),
    }
}
