//! What a step works on: a crop of a view that is left out, and windows of views around it.

use std::sync::Arc;

use crate::base::rng::{Random, Stream};
use crate::base::{Error, Result};
use crate::data::vector::Vec3;
use crate::grids::planes::Locations;
use crate::settings::PlanesConfig;

use super::geometry::{Viewpoint, nearest};
use super::sweep::{Window, padded};

/// Times that a step looks for a crop.
const TRIES: usize = 16;

/// A pixel counts where so many of its planes are in each window, or not in the window's view at all.
const HELD: f64 = 0.75;

/// A crop is taken where so many of its pixels count; of those that have fewer the best. Where disparities are large for the
/// window no pixel of any crop may: then those count that have a plane in every window.
const ENOUGH: f64 = 0.5;

/// A view whose planes a step predicts.
pub struct Reference {
    /// Its number.
    pub view: usize,
    /// The part that is predicted.
    pub window: Window,
    /// Where the crop's rays meet its planes: pixels of the window.
    pub places: Arc<Locations>,
    /// The distance of its camera from that of the view that is left out.
    pub distance: f64,
}

/// A step's work.
pub struct Work {
    /// The view that is left out: no input of any network.
    pub target: usize,
    /// The pixels that are asked for, as column and row.
    pub pixels: Vec<[usize; 2]>,
    /// Which of them count.
    pub counts: Vec<bool>,
    /// Which have a plane in every window.
    shown: Vec<bool>,
    /// Whose planes are blended.
    pub references: Vec<Reference>,
}

impl Work {
    /// How many pixels count.
    pub fn counted(&self) -> usize {
        number(&self.counts)
    }

    /// The work of the step that follows `step` finished ones.
    ///
    /// # Errors
    /// Views around no crop of which there are planes.
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
            nearest(eyes, eyes[target].place()).into_iter().filter(|(view, _)| *view != target).collect();
        // Any of those that a picture of the view would be blended of.
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
            Reference { view, window, places: Arc::new(places), distance }
        };
        let references = chosen.iter().map(reference).collect();
        Work { target, pixels, counts, shown, references }
    }
}

fn number(of: &[bool]) -> usize {
    of.iter().filter(|holds| **holds).count()
}

/// The window of a view around where the crop's middle ray meets a plane.
fn window(eye: &Viewpoint, side: usize, middle: (Vec3, Vec3), depths: &[f64], plane: usize) -> Window {
    let at = eye.places(&[middle], &depths[plane..plane + 1]).of_rays[0];
    let along = |at: f64, size: usize| {
        let side = side.min(padded(size));
        let last = size.saturating_sub(side);
        // A ray that meets nothing leaves the middle of the view.
        let at = if at.is_finite() { at - 0.5 * (side - 1) as f64 } else { 0.5 * last as f64 };
        (at.round().clamp(0.0, last as f64) as usize, side)
    };
    let ((left, width), (top, height)) = (along(at[0], eye.camera.width), along(at[1], eye.camera.height));
    Window { left, top, width, height }
}

/// Takes out the pixels that the window holds too few planes of, and those that meet nothing of the view.
fn count(eye: &Viewpoint, window: Window, places: &Locations, counts: &mut [bool]) {
    let (width, height) = (eye.camera.width as f64, eye.camera.height as f64);
    for (counts, places) in counts.iter_mut().zip(places.of_rays.chunks_exact(places.planes)) {
        let seen = |[x, y]: [f64; 2]| x > -1.0 && y > -1.0 && x < width && y < height;
        let missed = places.iter().filter(|place| seen(**place) && !window.holds(**place)).count();
        let met = places.iter().any(|place| seen(*place));
        *counts &= met && missed as f64 <= (1.0 - HELD) * places.len() as f64;
    }
}

/// Takes out the pixels that the window has no plane of.
fn show(window: Window, places: &Locations, shown: &mut [bool]) {
    for (shown, places) in shown.iter_mut().zip(places.of_rays.chunks_exact(places.planes)) {
        *shown &= places.iter().any(|place| window.holds(*place));
    }
}
