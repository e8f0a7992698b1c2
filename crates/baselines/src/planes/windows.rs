//! The inputs of a step: a crop of a view that is left out, and windows of views around it.

use crate::base::rng::{Random, Stream};
use crate::base::{Error, Result};
use crate::data::vector::Vec3;
use crate::grids::planes::Locations;
use crate::settings::PlanesConfig;

use super::geometry::{Viewpoint, nearest};
use super::sweep::{Window, padded};

/// Number of tries to find a crop.
const TRIES: usize = 16;

/// A pixel counts if this fraction of its planes is in each window, or not in the window's view at all.
const HELD: f64 = 0.75;

/// A crop is used if this fraction of its pixels counts; otherwise the best crop is. If disparities are too large for
/// the window, no pixel of any crop may count. Then those count that have a plane in every window.
const ENOUGH: f64 = 0.5;

/// A view whose planes a step predicts.
pub struct Reference {
    /// Its index.
    pub view: usize,
    /// The part that is predicted.
    pub window: Window,
    /// Intersections of the crop's rays with its planes, as pixels of the window.
    pub places: Locations,
    /// The distance of its camera from that of the left-out view.
    pub distance: f64,
}

/// The inputs of a step.
pub struct Work {
    /// The view that is left out, which is no input of any network.
    pub target: usize,
    /// The pixels of the crop, as column and row.
    pub pixels: Vec<[usize; 2]>,
    /// Which of them count.
    pub counts: Vec<bool>,
    /// Which of them have a plane in every window.
    shown: Vec<bool>,
    /// The views whose planes are blended.
    pub references: Vec<Reference>,
}

impl Work {
    /// Returns the number of pixels that count.
    pub fn counted(&self) -> usize {
        number(&self.counts)
    }

    /// Draws the inputs of the step after `step` finished ones.
    ///
    /// # Errors
    /// If no crop is covered by the planes of the views around it.
    pub fn draw(config: &PlanesConfig, seed: u64, step: u64, eyes: &[Viewpoint], depths: &[f64]) -> Result<Work> {
        let mut random = Random::new(seed, Stream::Batches, step);
        let mut best: Option<Work> = None;
        let worth = |work: &Work| (work.counted(), number(&work.shown));
        for _ in 0..TRIES {
            let work = Work::try_one(config, &mut random, eyes, depths);
            if work.counted() as f64 >= ENOUGH * work.pixels.len() as f64 {
                return Ok(work);
            }
            if best.as_ref().is_none_or(|best| worth(best) < worth(&work)) {
                best = Some(work);
            }
        }
        let mut best = best.expect("there are tries");
        if best.counted() == 0 {
            best.counts.clone_from(&best.shown);
        }
        if best.counted() > 0 {
            return Ok(best);
        }
        Err(Error::Config(format!(
            "method llff learns a view from the planes of the views next to it, and in {TRIES} crops of views no ray met a plane of all \
             {} of them: the training views see too little of the same; train on more views, or set llff.references to fewer",
            best.references.len()
        )))
    }

    fn try_one(config: &PlanesConfig, random: &mut Random, eyes: &[Viewpoint], depths: &[f64]) -> Work {
        let target = random.below(eyes.len() as u32) as usize;
        let others: Vec<(usize, f64)> =
            nearest(eyes, eyes[target].position()).into_iter().filter(|(view, _)| *view != target).collect();
        // Any of those from which an image of the view would be blended.
        let near = others.len().min(config.blend.max(config.references));
        let chosen = random.distinct(config.references.min(near), near as u32);
        let camera = &eyes[target].camera;
        let [left, top] = [camera.width, camera.height].map(|size| {
            let side = config.crop.min(size);
            random.below((size - side + 1) as u32) as usize
        });
        let (columns, rows) = (config.crop.min(camera.width), config.crop.min(camera.height));
        let pixels: Vec<[usize; 2]> =
            (top..top + rows).flat_map(|row| (left..left + columns).map(move |column| [column, row])).collect();
        let ray = |pixel: [f64; 2]| eyes[target].ray(pixel);
        let rays: Vec<(Vec3, Vec3)> = pixels.iter().map(|pixel| ray(pixel.map(|at| at as f64))).collect();
        let middle = ray([left as f64 + 0.5 * (columns - 1) as f64, top as f64 + 0.5 * (rows - 1) as f64]);
        let plane = random.below(depths.len() as u32) as usize;
        let [mut counts, mut shown] = [0, 1].map(|_| vec![true; pixels.len()]);
        let reference = |place: &u32| {
            let (view, distance) = others[*place as usize];
            let window = window(&eyes[view], config.window, middle, depths, plane);
            let mut places = eyes[view].places(&rays, depths);
            count(&eyes[view], window, &places, &mut counts);
            show(window, &places, &mut shown);
            let shift = [window.left, window.top].map(|first| first as f64);
            places.of_rays.iter_mut().for_each(|[x, y]| (*x, *y) = (*x - shift[0], *y - shift[1]));
            Reference { view, window, places, distance }
        };
        let references = chosen.iter().map(reference).collect();
        Work { target, pixels, counts, shown, references }
    }
}

fn number(of: &[bool]) -> usize {
    of.iter().filter(|holds| **holds).count()
}

/// Returns the window of a view around the intersection of the crop's middle ray with a plane.
fn window(eye: &Viewpoint, side: usize, middle: (Vec3, Vec3), depths: &[f64], plane: usize) -> Window {
    let at = eye.places(&[middle], &depths[plane..plane + 1]).of_rays[0];
    let along = |at: f64, size: usize| {
        let side = side.min(padded(size));
        let last = size.saturating_sub(side);
        // A ray that meets nothing gives the middle of the view.
        let at = if at.is_finite() { at - 0.5 * (side - 1) as f64 } else { 0.5 * last as f64 };
        (at.round().clamp(0.0, last as f64) as usize, side)
    };
    let ((left, width), (top, height)) = (along(at[0], eye.camera.width), along(at[1], eye.camera.height));
    Window { left, top, width, height }
}

/// Removes the pixels for which the window holds too few planes, and those that meet nothing of the view.
fn count(eye: &Viewpoint, window: Window, places: &Locations, counts: &mut [bool]) {
    let (width, height) = (eye.camera.width as f64, eye.camera.height as f64);
    for (counts, places) in counts.iter_mut().zip(places.of_rays.chunks_exact(places.planes)) {
        let seen = |[x, y]: [f64; 2]| x > -1.0 && y > -1.0 && x < width && y < height;
        let missed = places.iter().filter(|place| seen(**place) && !window.holds(**place)).count();
        let met = places.iter().any(|place| seen(*place));
        *counts &= met && missed as f64 <= (1.0 - HELD) * places.len() as f64;
    }
}

/// Removes the pixels for which the window has no plane.
fn show(window: Window, places: &Locations, shown: &mut [bool]) {
    for (shown, places) in shown.iter_mut().zip(places.of_rays.chunks_exact(places.planes)) {
        *shown &= places.iter().any(|place| window.holds(*place));
    }
}
