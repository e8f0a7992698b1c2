//! Rays of photographs through points of a scene that were triangulated in them.

use crate::settings::PixelOrigin;
use augnerf_base::rng::Random;

use super::pose::{self, Vec3};
use super::{Camera, Scene, UnseenRay, View};

/// Rays of the training views through points whose place is known, from COLMAP's tracks.
pub struct PointRays {
    /// With the point's depth along the camera's axis, which is t on the ray.
    rays: Vec<(UnseenRay, f32)>,
}

impl PointRays {
    /// Finds the rays of a scene's training views. A ray is that of the pixel that the point is in. Points behind a camera,
    /// beside its image or in masked pixels have none.
    pub fn of(scene: &Scene, origin: PixelOrigin) -> PointRays {
        let of_view = |view: &View| {
            let seen = scene.space.sightings.iter().find(|(name, _)| *name == view.name);
            let points = seen.into_iter().flat_map(|(_, points)| points);
            let ray = |point: &u32| ray(view, scene.space.points[*point as usize].map(f64::from), origin);
            points.filter_map(ray).collect::<Vec<_>>()
        };
        // In NDC t is no depth. No format has both.
        let views = if scene.ndc.is_some() { &[][..] } else { &scene.train[..] };
        PointRays { rays: views.iter().flat_map(of_view).collect() }
    }

    /// Returns the number of rays.
    pub fn count(&self) -> usize {
        self.rays.len()
    }

    /// Draws rays, with the points' t on them.
    pub fn draw(&self, count: usize, random: &mut Random) -> (Vec<UnseenRay>, Vec<f32>) {
        (0..count).map(|_| self.rays[random.below(self.rays.len() as u32) as usize]).unzip()
    }
}

fn ray(view: &View, point: Vec3, origin: PixelOrigin) -> Option<(UnseenRay, f32)> {
    let Camera { width, height, focal, centre, pose } = view.camera;
    let offset = pose::sub(point, pose::column(&pose, 3));
    let [right, up, back] = [0, 1, 2].map(|axis| pose::dot(offset, pose::column(&pose, axis)));
    let depth = -back;
    if depth <= 0.0 {
        return None;
    }
    // The nearest ray.
    let x = (centre[0] + focal[0] * right / depth - origin.shift()).round();
    let y = (centre[1] - focal[1] * up / depth - origin.shift()).round();
    let inside = (0.0..width as f64).contains(&x) && (0.0..height as f64).contains(&y);
    let (column, row) = (x as u32, y as u32);
    let counts = || view.mask.as_ref().is_none_or(|mask| mask[row as usize * width + column as usize]);
    (inside && counts()).then_some(((view.camera, column, row), depth as f32))
}
