//! Metrics of a rendered view against its photograph (PSNR, SSIM, LPIPS and their average) and against its depth.
//!
//! A metric that is undefined or was not measured is `None`: `null` in JSON and an empty cell in
//! CSV, never a stand-in number. PSNR is undefined where two images are equal (it is infinite
//! there), SSIM where a side is below its window, LPIPS where its weights are not at hand.

mod depth;
mod lpips;
mod ssim;
mod weights;

pub use depth::DepthMetrics;
pub use lpips::{Backbone, Lpips};
pub use ssim::ssim;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::base::{Error, Image, Result};

/// The metrics of one rendered view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewMetrics {
    /// The view's name.
    pub name: String,
    /// PSNR in dB of the 8-bit rounded images; `None` where they are equal.
    pub psnr: Option<f64>,
    /// PSNR in dB of the unrounded images; `None` where they are equal.
    pub psnr_float: Option<f64>,
    /// Mean squared error of the unrounded images.
    pub mse: f64,
    /// SSIM of the 8-bit rounded images; `None` where a side is below 11 pixels.
    pub ssim: Option<f64>,
    /// LPIPS on AlexNet of the 8-bit rounded images; `None` without its weights.
    pub lpips_alex: Option<f64>,
    /// LPIPS on VGG-16 of the 8-bit rounded images; `None` without its weights.
    pub lpips_vgg: Option<f64>,
    /// LPIPS on SqueezeNet 1.1 of the 8-bit rounded images; `None` without its weights.
    pub lpips_squeeze: Option<f64>,
    /// Geometry; filled where the view has a reference depth.
    #[serde(flatten)]
    pub depth: DepthMetrics,
}

/// Means over views. A mean over views of which one lacks the metric is `None`, because a mean
/// over the others would not be comparable.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MeanMetrics {
    /// Mean of the views' `psnr` in dB.
    pub psnr: Option<f64>,
    /// Mean of the views' `psnr_float` in dB.
    pub psnr_float: Option<f64>,
    /// PSNR in dB of the mean of the views' `mse`.
    pub psnr_of_mean: Option<f64>,
    /// Mean SSIM.
    pub ssim: Option<f64>,
    /// Mean LPIPS on AlexNet.
    pub lpips_alex: Option<f64>,
    /// Mean LPIPS on VGG-16.
    pub lpips_vgg: Option<f64>,
    /// Mean LPIPS on SqueezeNet 1.1.
    pub lpips_squeeze: Option<f64>,
    /// [`average`] of the means `psnr`, `ssim` and `lpips_alex`.
    pub average_alex: Option<f64>,
    /// [`average`] of the means `psnr`, `ssim` and `lpips_vgg`.
    pub average_vgg: Option<f64>,
    /// [`average`] of the means `psnr`, `ssim` and `lpips_squeeze`.
    pub average_squeeze: Option<f64>,
    /// Means of the views' geometry.
    #[serde(flatten)]
    pub depth: DepthMetrics,
    /// Chamfer distance of the surface to the reference mesh, scene units; `None` where it was not asked for or
    /// there is no surface.
    #[serde(default)]
    pub chamfer: Option<f64>,
    /// F-score of the surface at the distance that the protocol names.
    #[serde(default)]
    pub f_score: Option<f64>,
}

impl MeanMetrics {
    /// The means over `views`; everything is `None` for no views.
    pub fn from_views(views: &[ViewMetrics]) -> MeanMetrics {
        let over = |metric: fn(&ViewMetrics) -> Option<f64>| mean(views, metric);
        let mut means = MeanMetrics {
            psnr: over(|v| v.psnr),
            psnr_float: over(|v| v.psnr_float),
            psnr_of_mean: over(|v| Some(v.mse)).and_then(psnr_from_mse),
            ssim: over(|v| v.ssim),
            lpips_alex: over(|v| v.lpips_alex),
            lpips_vgg: over(|v| v.lpips_vgg),
            lpips_squeeze: over(|v| v.lpips_squeeze),
            depth: DepthMetrics::mean(&views.iter().map(|v| v.depth).collect::<Vec<_>>()),
            ..MeanMetrics::default()
        };
        means.average_alex = means.average_with(means.lpips_alex);
        means.average_vgg = means.average_with(means.lpips_vgg);
        means.average_squeeze = means.average_with(means.lpips_squeeze);
        means
    }

    fn average_with(&self, lpips: Option<f64>) -> Option<f64> {
        Some(average(self.psnr?, self.ssim?, lpips?))
    }
}

fn mean(views: &[ViewMetrics], metric: fn(&ViewMetrics) -> Option<f64>) -> Option<f64> {
    let values = views.iter().map(metric).collect::<Option<Vec<f64>>>()?;
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Measures one view. SSIM and LPIPS, like `psnr`, see the 8-bit rounded images, so that the
/// written PNG files give the same numbers. LPIPS is `None` for backbones that are not among
/// `lpips` and for images below the backbone's smallest side.
pub fn measure(name: &str, rendered: &Image, truth: &Image, lpips: &[Lpips]) -> Result<ViewMetrics> {
    check_finite(name, rendered)?;
    let error = mse(rendered, truth)?;
    let (rendered, truth) = (quantise(rendered), quantise(truth));
    let mut view = ViewMetrics {
        name: name.to_string(),
        psnr: psnr_from_mse(mse(&rendered, &truth)?),
        psnr_float: psnr_from_mse(error),
        mse: error,
        ssim: ssim(&rendered, &truth)?,
        lpips_alex: None,
        lpips_vgg: None,
        lpips_squeeze: None,
        depth: DepthMetrics::default(),
    };
    for model in lpips.iter().filter(|model| model.backbone().fits(truth.width, truth.height)) {
        let distance = Some(model.distance(&rendered, &truth)?);
        match model.backbone() {
            Backbone::Alex => view.lpips_alex = distance,
            Backbone::Vgg => view.lpips_vgg = distance,
            Backbone::Squeeze => view.lpips_squeeze = distance,
        }
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

/// PSNR in dB of the 8-bit rounded images; `None` where these are equal.
pub fn psnr(a: &Image, b: &Image) -> Result<Option<f64>> {
    psnr_float(&quantise(a), &quantise(b))
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

fn check_finite(name: &str, image: &Image) -> Result<()> {
    match image.pixels.iter().filter(|p| !p.is_finite()).count() {
        0 => Ok(()),
        n => Err(Error::Diverged(format!("rendered view {name} holds {n} values that are not finite"))),
    }
}
