//! The planes of a camera, and their intersections with rays.

use crate::data::Camera;
use crate::data::pose::{Pose, column};
use crate::data::vector::{Vec3, dot, sub};
use crate::grids::planes::Locations;

/// Returns depths of planes from `far` to `near`, evenly spaced in disparity. As in LLFF, number 0 is the farthest.
pub fn depths(near: f64, far: f64, planes: usize) -> Vec<f64> {
    let last = (planes.max(2) - 1) as f64;
    (0..planes).map(|k| 1.0 / (1.0 / far + k as f64 / last * (1.0 / near - 1.0 / far))).collect()
}

/// Returns a vector in the camera's axes.
fn turned(pose: &Pose, v: Vec3) -> Vec3 {
    [0, 1, 2].map(|axis| dot(column(pose, axis), v))
}

/// A camera whose pixels are counted from the centre of the first, which is at `shift`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewpoint {
    /// The camera in the scene.
    pub camera: Camera,
    /// Pixel coordinates of the centre of the first pixel.
    pub shift: f64,
}

impl Viewpoint {
    /// Returns its position.
    pub fn position(&self) -> Vec3 {
        column(&self.camera.pose, 3)
    }

    /// Returns the pixel of a point in the camera's axes, or NaN behind the camera.
    #[inline(always)]
    fn pixel(&self, [x, y, z]: Vec3) -> [f64; 2] {
        let Camera { focal, centre, .. } = &self.camera;
        let inverse = if z < 0.0 { -1.0 / z } else { f64::NAN };
        [centre[0] + focal[0] * x * inverse - self.shift, centre[1] - focal[1] * y * inverse - self.shift]
    }

    /// Returns origin and direction of the ray through a pixel. t is depth along the camera's axis.
    pub fn ray(&self, [column, row]: [f64; 2]) -> (Vec3, Vec3) {
        self.camera.ray(column + self.shift, row + self.shift)
    }

    /// Intersects a ray with this camera's planes at `depths`: a pixel and the ray's t for each. They are NaN if the
    /// ray meets the plane before its origin, or from behind.
    pub fn hits(&self, origin: Vec3, direction: Vec3, depths: &[f64], mut each: impl FnMut(usize, [f64; 2], f64)) {
        let pose = &self.camera.pose;
        let origin = turned(pose, sub(origin, column(pose, 3)));
        let direction = turned(pose, direction);
        for (k, depth) in depths.iter().enumerate() {
            let t = (-depth - origin[2]) / direction[2];
            let met = t > 0.0 && direction[2] < 0.0;
            let t = if met { t } else { f64::NAN };
            let [x, y] = [0, 1].map(|axis| origin[axis] + t * direction[axis]);
            each(k, self.pixel([x, y, -depth]), t);
        }
    }

    /// Returns the same for many rays, without t.
    pub fn places(&self, rays: &[(Vec3, Vec3)], depths: &[f64]) -> Locations {
        let mut of_rays = vec![[f64::NAN; 2]; rays.len() * depths.len()];
        for ((origin, direction), places) in rays.iter().zip(of_rays.chunks_exact_mut(depths.len())) {
            self.hits(*origin, *direction, depths, |k, pixel, _| places[k] = pixel);
        }
        Locations { planes: depths.len(), of_rays }
    }
}

/// The projection of a plane of this camera into another camera: the other pixel is linear in this one's before the
/// division.
#[derive(Clone, Copy, Debug)]
pub struct Homography {
    base: Vec3,
    per_column: Vec3,
    per_row: Vec3,
    seen_by: Viewpoint,
}

impl Homography {
    /// Creates the homography to `seen_by` for the plane at `depth` of `own`.
    pub fn new(own: &Viewpoint, seen_by: &Viewpoint, depth: f64) -> Homography {
        let direction = |pixel: [f64; 2]| own.ray(pixel).1;
        let (origin, first) = own.ray([0.0, 0.0]);
        let pose = &seen_by.camera.pose;
        let along = |v: Vec3| turned(pose, v.map(|value| value * depth));
        let base = sub(std::array::from_fn(|i| origin[i] + depth * first[i]), column(pose, 3));
        Homography {
            base: turned(pose, base),
            per_column: along(sub(direction([1.0, 0.0]), first)),
            per_row: along(sub(direction([0.0, 1.0]), first)),
            seen_by: *seen_by,
        }
    }

    /// Returns the pixel of the other camera, or NaN behind it.
    #[inline(always)]
    pub fn pixel(&self, column: f64, row: f64) -> [f64; 2] {
        let at = |i: usize| self.base[i] + column * self.per_column[i] + row * self.per_row[i];
        self.seen_by.pixel([at(0), at(1), at(2)])
    }
}

/// Returns views by their distance from `place`, the nearest first. For equal distances the first view comes first.
pub fn nearest(eyes: &[Viewpoint], place: Vec3) -> Vec<(usize, f64)> {
    let distance = |eye: &Viewpoint| dot(sub(eye.position(), place), sub(eye.position(), place)).sqrt();
    let mut all: Vec<(usize, f64)> = eyes.iter().map(distance).enumerate().collect();
    all.sort_by(|a, b| a.1.total_cmp(&b.1));
    all
}

/// Returns the input views of the network for the planes of view `own`: itself and the nearest others of `eyes`,
/// without `left_out`. If there are too few, it is repeated.
pub fn inputs_of(eyes: &[Viewpoint], own: usize, count: usize, left_out: Option<usize>) -> Vec<usize> {
    let others = nearest(eyes, eyes[own].position()).into_iter().map(|(view, _)| view);
    let others = others.filter(|view| *view != own && Some(*view) != left_out);
    std::iter::once(own).chain(others).chain(std::iter::repeat(own)).take(count).collect()
}
