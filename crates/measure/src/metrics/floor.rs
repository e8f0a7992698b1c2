//! What a picture of a single colour would reach: the floor beside which a metric means something.

use rayon::prelude::*;

use super::{FLOOR_PSNR, MeanMetrics, Metric, PSNR, ViewMetrics, masked, psnr_from_mse, quantise};
use augnerf_base::image::{colour_spread, counting};
use augnerf_base::{Image, Result};
use augnerf_scenes::{MANY_COLOURS, View};

/// Channels of a colour.
const RGB: usize = 3;

/// Colours (0 to 1) of a rendered picture that differ less count as one colour: they have one or two 8-bit values.
const ONE_COLOUR: f32 = 1.0 / 255.0;

/// The best single colour of some views: the mean of the pixels that count, which has the least squared error there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Floor([f32; RGB]);

/// Says that mean metrics are no better than one colour's, if that is so.
pub fn no_better_than_one_colour(mean: &MeanMetrics) -> Option<String> {
    let [psnr, floor] = [&PSNR, &FLOOR_PSNR].map(|metric: &Metric| mean.get(metric));
    let (psnr, floor) = psnr.zip(floor).filter(|(psnr, floor)| psnr <= floor)?;
    Some(format!(
        "no better than one colour: PSNR is {psnr:.2} dB, and the best single colour of the training views has {floor:.2} dB"
    ))
}

impl Floor {
    /// Returns that of a scene's views.
    pub fn of_views(views: &[View]) -> Option<Floor> {
        Floor::of(views.iter().map(|view| (&*view.image, view.mask.as_deref())))
    }

    /// Returns that of views, each an RGB image with the pixels that count. `None` if none counts.
    pub fn of<'a>(views: impl IntoIterator<Item = (&'a Image, Option<&'a [bool]>)>) -> Option<Floor> {
        let views: Vec<_> = views.into_iter().collect();
        let sum = |(image, mask): &(&Image, Option<&[bool]>)| {
            let mut sum = ([0.0f64; RGB], 0u64);
            for texel in counting(image, *mask) {
                sum.0.iter_mut().zip(texel).for_each(|(sum, value)| *sum += f64::from(*value));
                sum.1 += 1;
            }
            sum
        };
        // Summed in the order of views, so that the colour does not depend on the number of threads.
        let sums: Vec<([f64; RGB], u64)> = views.par_iter().map(sum).collect();
        let count: u64 = sums.iter().map(|(_, count)| count).sum();
        let mean = |channel: usize| (sums.iter().map(|(sum, _)| sum[channel]).sum::<f64>() / count as f64) as f32;
        (count > 0).then(|| Floor(std::array::from_fn(mean)))
    }

    /// Sets [`FLOOR_PSNR`] of a view: the PSNR of a picture of that colour, rounded to 8 bits as PSNR is.
    ///
    /// # Errors
    /// The mask is not one of the image.
    pub fn measure(&self, view: &mut ViewMetrics, truth: &Image, mask: Option<&[bool]>) -> Result<()> {
        let pixels = self.0.repeat(truth.width * truth.height);
        let flat = quantise(&Image { width: truth.width, height: truth.height, channels: RGB, pixels });
        let error = masked::mse(&flat, &quantise(truth), mask)?;
        view.values.set(&FLOOR_PSNR, error.and_then(psnr_from_mse));
        Ok(())
    }
}

/// Whether all rendered pictures are of one colour each, while photos are not: then nothing was learned.
#[derive(Clone, Copy, Debug, Default)]
pub struct OneColour {
    rendered_differs: bool,
    photo_differs: bool,
}

impl OneColour {
    /// Adds a rendered view and its photo.
    pub fn add(&mut self, rendered: &Image, photo: &Image, mask: Option<&[bool]>) {
        self.rendered_differs |= colour_spread([(rendered, mask)]) > ONE_COLOUR;
        self.photo_differs |= colour_spread([(photo, mask)]) > MANY_COLOURS;
    }

    /// Returns the answer for the views so far.
    pub fn holds(&self) -> bool {
        self.photo_differs && !self.rendered_differs
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::{PSNR, measure};

    fn image(pixels: &[[f32; 3]]) -> Image {
        Image { width: pixels.len(), height: 1, channels: 3, pixels: pixels.concat() }
    }

    /// By hand: of black and white the mean is grey 127.5, which is rounded to 128 and is half wrong everywhere.
    #[test]
    fn the_floor_of_black_and_white_is_grey() {
        let truth = image(&[[0.0; 3], [1.0; 3]]);
        let floor = Floor::of([(&truth, None)]).unwrap();
        assert_eq!(floor.0, [0.5; 3]);
        let mut view = ViewMetrics::new("view");
        floor.measure(&mut view, &truth, None).unwrap();
        let error = ((128.0f64 / 255.0).powi(2) + (127.0f64 / 255.0).powi(2)) / 2.0;
        assert!((view.get(&FLOOR_PSNR).unwrap() + 10.0 * error.log10()).abs() < 1e-6);
    }

    /// No other grey has a better PSNR on the views that it is made of.
    #[test]
    fn no_single_colour_is_better() {
        let truth = image(&[[0.1; 3], [0.2; 3], [0.9; 3], [0.35; 3]]);
        let mut view = ViewMetrics::new("view");
        Floor::of([(&truth, None)]).unwrap().measure(&mut view, &truth, None).unwrap();
        let best = view.get(&FLOOR_PSNR).unwrap();
        for grey in 0..=255 {
            let flat = image(&[[grey as f32 / 255.0; 3]; 4]);
            assert!(measure("view", &flat, &truth, &[]).unwrap().get(&PSNR).unwrap() <= best + 1e-9, "{grey}");
        }
    }

    #[test]
    fn masked_pixels_count_neither_for_the_colour_nor_for_its_psnr() {
        let truth = image(&[[0.0; 3], [1.0; 3], [0.2; 3]]);
        let mask = [false, false, true];
        let floor = Floor::of([(&truth, Some(&mask[..]))]).unwrap();
        assert_eq!(floor.0, [0.2; 3]);
        let mut view = ViewMetrics::new("view");
        floor.measure(&mut view, &truth, Some(&mask)).unwrap();
        assert_eq!(view.get(&FLOOR_PSNR), None, "equal pictures have no PSNR");
        assert_eq!(Floor::of([(&truth, Some(&[false; 3][..]))]), None);
    }

    #[test]
    fn pictures_of_one_colour_are_told_from_photos_of_one_colour() {
        let (flat, black) = (image(&[[0.5, 0.1, 0.0]; 3]), image(&[[0.0; 3]; 3]));
        let nearly = image(&[[0.5; 3], [0.503; 3], [0.5; 3]]);
        let photo = image(&[[0.0; 3], [0.3, 0.0, 0.0], [0.0; 3]]);
        let of = |pairs: &[(&Image, &Image)]| {
            let mut one = OneColour::default();
            pairs.iter().for_each(|(rendered, photo)| one.add(rendered, photo, None));
            one.holds()
        };
        assert!(of(&[(&flat, &photo), (&black, &photo)]) && of(&[(&nearly, &photo)]));
        assert!(of(&[(&black, &black), (&black, &photo)]), "one photo that differs is enough");
        assert!(!of(&[(&black, &black)]) && !of(&[(&photo, &photo)]) && !of(&[(&flat, &photo), (&photo, &photo)]));
        assert!(!of(&[]));
    }
}
