//! Rendering of the solids with lights.

use rayon::prelude::*;

use super::shading::{SAMPLES, SIDE, display, shade};
use super::stage::Stage;
use crate::Camera;
use crate::settings::PixelOrigin;
use crate::vector::{Vec3, add, scale};
use augnerf_base::Image;

/// Number of mirror reflections that are followed.
const BOUNCES: u32 = 2;

/// A rendered view.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// RGBA, straight alpha. Alpha is the covered fraction of the pixel.
    pub image: Image,
    /// Depth along the view's z axis in scene units, row-major, `f32::INFINITY` for nothing.
    pub depth: Vec<f32>,
}

impl Stage {
    /// Returns the display colour (0..=1) along a ray in the cameras' frame, lit by one of a pixel's `SAMPLES` samples
    /// of the lights. `None` if it hits nothing.
    pub fn colour(&self, origin: Vec3, direction: Vec3, sample: usize) -> Option<Vec3> {
        let (o, d) = (self.frame().point(origin), self.frame().direction(direction));
        let hit = self.nearest(o, d)?;
        Some(display(shade(self, &hit, o, d, sample % SAMPLES, BOUNCES)))
    }

    /// Renders a view. The bytes do not depend on the number of threads.
    pub fn render(&self, camera: &Camera, origin: PixelOrigin) -> Picture {
        let shift = origin.shift();
        let rows = (0..camera.height).into_par_iter().map(|y| {
            let pixel = |x: usize| self.pixel(camera, x as f64 + shift, y as f64 + shift);
            (0..camera.width).map(pixel).collect::<Vec<_>>()
        });
        let rows: Vec<_> = rows.collect();
        let image = Image {
            width: camera.width,
            height: camera.height,
            channels: 4,
            pixels: rows.iter().flatten().flat_map(|(rgba, _)| *rgba).collect(),
        };
        Picture { image, depth: rows.iter().flatten().map(|&(_, depth)| depth).collect() }
    }

    /// Returns RGBA of the unit square around pixel coordinates (`x`, `y`), and the depth there.
    fn pixel(&self, camera: &Camera, x: f64, y: f64) -> ([f32; 4], f32) {
        let (mut sum, mut covered) = ([0.0; 3], 0);
        for sample in 0..SAMPLES {
            let offset = |i: usize| (i as f64 + 0.5) / SIDE as f64 - 0.5;
            let (o, d) = camera.ray(x + offset(sample % SIDE), y + offset(sample / SIDE));
            if let Some(colour) = self.colour(o, d, sample) {
                sum = add(sum, colour);
                covered += 1;
            }
        }
        let (o, d) = camera.ray(x, y);
        let depth = self.first_hit(o, d).map_or(f32::INFINITY, |hit| hit.t as f32);
        let [r, g, b] = scale(sum, 1.0 / f64::from(covered.max(1))).map(|v| v.clamp(0.0, 1.0) as f32);
        ([r, g, b, covered as f32 / SAMPLES as f32], depth)
    }
}
