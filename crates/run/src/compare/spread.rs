//! Mean and standard deviation of the renderings of one row's seeds, and how well the deviation says where errors are.

use serde::Serialize;
use serde::ser::Serializer;

use crate::base::{Image, Result};
use crate::data::View;
use crate::metrics::{PSNR, SSIM, ViewMetrics, measure_unmasked, unmasked_or};
use crate::report::calibration::{Predicted, root_mean_square, sparsification, spearman, within};
use crate::report::statistics::{mean, standard_deviation};
use crate::run::RenderedView;

/// Key and definition of each number of a view.
pub const NUMBERS: [(&str, &str); 11] = [
    ("psnr_of_mean", "PSNR of the mean image, in dB; images are rounded to 8 bits first, as in every measurement"),
    ("psnr_of_seeds", "mean over seeds of the PSNR of one seed's image, in dB"),
    ("ssim_of_mean", "SSIM of the mean image"),
    ("ssim_of_seeds", "mean over seeds of the SSIM of one seed's image"),
    ("spread_rms", "root mean square over pixels of the spread"),
    ("error_rms", "root mean square over pixels of the error"),
    ("spearman", "Spearman's rank correlation of spread and error over pixels; ties share their mean rank"),
    (
        "ause",
        "area under the sparsification error (Ilg et al. 2018): remove the fraction f of the pixels with the largest \
         spread, take the root mean square error of the others, subtract that after removing the largest errors first, \
         divide by that of all pixels; mean over all f; 0 if spread orders pixels as error does",
    ),
    ("ause_constant", "the same area for a spread that is equal in all pixels, and so says nothing"),
    ("within_1", "fraction of pixels with error <= spread"),
    ("within_2", "fraction of pixels with error <= 2 spread"),
];

/// Definitions of the quantities that the numbers are of.
pub const QUANTITIES: [(&str, &str); 3] = [
    (
        "spread",
        "of a pixel: the standard deviation over seeds (n - 1) of each colour channel, as root mean square over red, \
         green and blue; colours are 0 to 1 and not rounded",
    ),
    (
        "error",
        "of a pixel: the mean image's difference to the photo, as root mean square over red, green and blue; colours \
         are not rounded",
    ),
    (
        "calibration",
        "bins of equal numbers of pixels by spread, over all views: lowest, highest, mean and root mean square spread; \
         root mean square error",
    ),
];

/// The values of [`NUMBERS`], in their order. A value that is not defined is `None`, such as the PSNR of equal images.
#[derive(Clone, Debug, PartialEq)]
pub struct SpreadNumbers(pub [Option<f64>; NUMBERS.len()]);

impl SpreadNumbers {
    /// Returns the value with that key.
    pub fn get(&self, key: &str) -> Option<f64> {
        NUMBERS.iter().zip(self.0).find(|((known, _), _)| *known == key).and_then(|(_, value)| value)
    }

    /// Returns the mean of each number over views; `None` if one of them is not defined.
    pub(super) fn mean<'a>(views: impl Iterator<Item = &'a SpreadNumbers> + Clone) -> SpreadNumbers {
        SpreadNumbers(std::array::from_fn(|i| mean_of(views.clone().map(|view| view.0[i]))))
    }
}

impl Serialize for SpreadNumbers {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.collect_map(NUMBERS.iter().zip(self.0).map(|((key, _), value)| (key, value)))
    }
}

/// Returns the mean, or `None` if a value is missing or there is none.
fn mean_of(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    mean(&values.collect::<Option<Vec<f64>>>()?)
}

/// A held-out view as the seeds render it together.
pub struct ViewSpread {
    /// The view's name.
    pub name: String,
    /// Mean of the seeds' images.
    pub mean: Image,
    /// Standard deviation of each pixel, as [`QUANTITIES`] defines it.
    pub spread: Vec<f32>,
    /// Error of each pixel of the mean image; 0 where the photo is masked.
    pub error: Vec<f32>,
    /// Mean depth; NaN where a seed has none.
    pub depth: Vec<f32>,
    /// Standard deviation of depth over seeds (n - 1); NaN where a seed has none.
    pub depth_spread: Vec<f32>,
    /// Mean accumulation.
    pub acc: Vec<f32>,
    /// Spread and error of the pixels that count.
    pub predicted: Vec<Predicted>,
    /// Numbers over these pixels.
    pub numbers: SpreadNumbers,
}

impl ViewSpread {
    /// Computes mean, spread and error of a view from the renderings of at least two seeds.
    ///
    /// # Errors
    /// A rendering has another size than the photo, or a value that is not finite.
    pub fn new(view: &View, rendered: &[RenderedView]) -> Result<ViewSpread> {
        let truth = &*view.image;
        let (colours, deviations) = moments(rendered, |seed| &seed.image.pixels);
        let (depth, depth_spread) = moments(rendered, |seed| &seed.depth);
        let (acc, _) = moments(rendered, |seed| &seed.acc);
        let mean = Image { pixels: colours, ..rendered[0].image };
        let measured = Measured::new(view, &mean, rendered)?;
        let counted = unmasked_or(mean.clone(), truth, view.mask.as_deref());
        let differences: Vec<f32> = counted.pixels.iter().zip(&truth.pixels).map(|(a, b)| a - b).collect();
        let (spread, error) = (over_channels(&deviations), over_channels(&differences));
        let predicted = predicted(view, &spread, &error);
        Ok(ViewSpread {
            name: view.name.clone(),
            numbers: measured.with(&predicted),
            predicted,
            mean,
            spread,
            error,
            depth,
            depth_spread,
            acc,
        })
    }
}

/// PSNR and SSIM of a view.
struct Measured {
    of_mean: ViewMetrics,
    of_seeds: Vec<ViewMetrics>,
}

impl Measured {
    fn new(view: &View, mean: &Image, rendered: &[RenderedView]) -> Result<Measured> {
        let measure = |image: &Image| measure_unmasked(&view.name, image, &view.image, view.mask.as_deref(), &[]);
        let of_seeds = rendered.iter().map(|seed| measure(&seed.image)).collect::<Result<_>>()?;
        Ok(Measured { of_mean: measure(mean)?, of_seeds })
    }

    /// Adds what is measured of spread and error.
    fn with(&self, predicted: &[Predicted]) -> SpreadNumbers {
        let of_mean = |metric| self.of_mean.get(metric);
        let of_seeds = |metric| mean_of(self.of_seeds.iter().map(|seed| seed.get(metric)));
        let order = sparsification(predicted);
        let finite = |value: f64| value.is_finite().then_some(value);
        SpreadNumbers([
            of_mean(&PSNR),
            of_seeds(&PSNR),
            of_mean(&SSIM),
            of_seeds(&SSIM),
            finite(root_mean_square(predicted.iter().map(|pixel| pixel.spread))),
            finite(root_mean_square(predicted.iter().map(|pixel| pixel.error))),
            spearman(predicted),
            order.map(|order| order.ause),
            order.map(|order| order.ause_constant),
            finite(within(predicted, 1.0)),
            finite(within(predicted, 2.0)),
        ])
    }
}

/// Returns mean and standard deviation over seeds of each value. A value that a seed has as NaN is NaN.
fn moments(rendered: &[RenderedView], values: fn(&RenderedView) -> &Vec<f32>) -> (Vec<f32>, Vec<f32>) {
    let mut of_seeds = vec![0.0; rendered.len()];
    let at = |index: usize| {
        of_seeds.iter_mut().zip(rendered).for_each(|(value, seed)| *value = f64::from(values(seed)[index]));
        let deviation = standard_deviation(&of_seeds).expect("two seeds");
        (mean(&of_seeds).expect("two seeds") as f32, deviation as f32)
    };
    (0..values(&rendered[0]).len()).map(at).unzip()
}

/// Returns the root mean square over the three channels of each pixel.
fn over_channels(values: &[f32]) -> Vec<f32> {
    values.chunks_exact(3).map(|pixel| root_mean_square(pixel.iter().copied()) as f32).collect()
}

/// Returns the pixels that count.
fn predicted(view: &View, spread: &[f32], error: &[f32]) -> Vec<Predicted> {
    let counts = |pixel: &usize| view.mask.as_ref().is_none_or(|mask| mask[*pixel]);
    let pixel = |pixel: usize| Predicted { spread: spread[pixel], error: error[pixel] };
    (0..spread.len()).filter(counts).map(pixel).collect()
}
