//! How well, and how smoothly, a rendered view's depth follows the scene's own.
//!
//! All lengths are scene units along the viewing axis. A pixel counts where the reference has a surface, of known
//! depth, and the rendering is solid there (accumulation of at least a half); what of the reference's surface does not
//! count is reported as a share. Roughness is measured on what lies in one surface of the reference: not across
//! neighbours whose reference depths differ by more than 2.5 % of the nearer one.

use serde::{Deserialize, Serialize};

use crate::data::Camera;
use crate::data::vector::{Vec3, add, cross, dot, length, scale, sub};

/// Accumulation from which on a rendered pixel has a depth.
const SOLID: f32 = 0.5;
/// Neighbours that differ by a larger share of their depth lie on different surfaces.
const EDGE: f64 = 0.025;

/// Geometry of one rendered view, or means over views. Everything is `None` for a view without reference depth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct DepthMetrics {
    /// Mean absolute depth error over the counted pixels.
    pub depth_mae: Option<f64>,
    /// Root of the mean squared depth error.
    pub depth_rmse: Option<f64>,
    /// Share of the pixels with known reference depth whose rendering is not solid.
    pub depth_left_out: Option<f64>,
    /// Mean absolute second difference of depth, d(i-1) - 2 d(i) + d(i+1), over rows and columns.
    pub depth_roughness: Option<f64>,
    /// The reference's own over the same pixels; `None` where its depth is not exact.
    pub depth_roughness_truth: Option<f64>,
    /// Mean angle in degrees between the normals of neighbouring pixels, each the normal through the points of the
    /// pixel and of its right and lower neighbour.
    pub normal_roughness: Option<f64>,
    /// The reference's own over the same pixels; `None` where its depth is not exact.
    pub normal_roughness_truth: Option<f64>,
}

/// A view's depth and where it may be compared.
struct Compared<'a> {
    camera: &'a Camera,
    /// Reference depth where the pixel counts, NaN elsewhere.
    reference: Vec<f64>,
    rendered: Vec<f64>,
}

impl DepthMetrics {
    /// Compares `rendered` depth (along the viewing axis, scene units, any value where `acc` is low) with the
    /// reference's, row-major; `exact` says whether the reference's own roughness means anything.
    pub fn of(camera: &Camera, rendered: &[f32], acc: &[f32], reference: &[f32], exact: bool) -> DepthMetrics {
        let known = reference.iter().filter(|depth| depth.is_finite()).count();
        let counts = |i: usize| reference[i].is_finite() && acc[i] >= SOLID && rendered[i].is_finite();
        let counted = |i: usize| if counts(i) { f64::from(reference[i]) } else { f64::NAN };
        let view = Compared {
            camera,
            reference: (0..reference.len()).map(counted).collect(),
            rendered: rendered.iter().copied().map(f64::from).collect(),
        };
        let errors = || (0..reference.len()).filter(|&i| counts(i)).map(|i| view.rendered[i] - view.reference[i]);
        let truth = |roughness: Option<f64>| roughness.filter(|_| exact);
        DepthMetrics {
            depth_mae: mean(errors().map(f64::abs)),
            depth_rmse: mean(errors().map(|error| error * error)).map(f64::sqrt),
            depth_left_out: (known > 0).then(|| 1.0 - errors().count() as f64 / known as f64),
            depth_roughness: view.depth_roughness(&view.rendered),
            depth_roughness_truth: truth(view.depth_roughness(&view.reference)),
            normal_roughness: view.normal_roughness(&view.rendered),
            normal_roughness_truth: truth(view.normal_roughness(&view.reference)),
        }
    }

    /// Means over views; `None` where a view lacks the metric.
    pub fn mean(views: &[DepthMetrics]) -> DepthMetrics {
        let over = |metric: fn(&DepthMetrics) -> Option<f64>| {
            views.iter().map(metric).collect::<Option<Vec<f64>>>().and_then(|values| mean(values.into_iter()))
        };
        DepthMetrics {
            depth_mae: over(|v| v.depth_mae),
            depth_rmse: over(|v| v.depth_rmse),
            depth_left_out: over(|v| v.depth_left_out),
            depth_roughness: over(|v| v.depth_roughness),
            depth_roughness_truth: over(|v| v.depth_roughness_truth),
            normal_roughness: over(|v| v.normal_roughness),
            normal_roughness_truth: over(|v| v.normal_roughness_truth),
        }
    }
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0u64), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / count as f64)
}

impl Compared<'_> {
    /// Whether two pixels count and lie on one surface.
    fn joined(&self, a: usize, b: usize) -> bool {
        let (a, b) = (self.reference[a], self.reference[b]);
        (a - b).abs() <= EDGE * a.min(b)
    }

    /// Index of the pixel at (x, y), none outside.
    fn at(&self, x: usize, y: usize) -> Option<usize> {
        (x < self.camera.width && y < self.camera.height).then(|| y * self.camera.width + x)
    }

    /// All pairs (pixel, neighbour, next neighbour) to the right and downwards.
    fn triples(&self) -> impl Iterator<Item = [usize; 3]> {
        let from = |x: usize, y: usize, dx: usize, dy: usize| {
            Some([self.at(x, y)?, self.at(x + dx, y + dy)?, self.at(x + 2 * dx, y + 2 * dy)?])
        };
        let of = move |i: usize| {
            let (x, y) = (i % self.camera.width, i / self.camera.width);
            [from(x, y, 1, 0), from(x, y, 0, 1)].into_iter().flatten()
        };
        (0..self.reference.len()).flat_map(of)
    }

    fn depth_roughness(&self, depth: &[f64]) -> Option<f64> {
        let one_surface = |&[a, b, c]: &[usize; 3]| self.joined(a, b) && self.joined(b, c);
        mean(self.triples().filter(one_surface).map(|[a, b, c]| (depth[a] - 2.0 * depth[b] + depth[c]).abs()))
    }

    /// Mean angle between neighbouring normals of a depth map, degrees.
    fn normal_roughness(&self, depth: &[f64]) -> Option<f64> {
        let normals: Vec<Option<Vec3>> = (0..depth.len()).map(|i| self.normal(depth, i)).collect();
        let width = self.camera.width;
        let neighbours = |i: usize| {
            let (x, y) = (i % width, i / width);
            [self.at(x + 1, y), self.at(x, y + 1)].into_iter().flatten().map(move |j| (i, j))
        };
        let angle = |(i, j): (usize, usize)| {
            let (a, b) = (normals[i]?, normals[j]?);
            self.joined(i, j).then(|| length(cross(a, b)).atan2(dot(a, b)).to_degrees())
        };
        mean((0..depth.len()).flat_map(neighbours).filter_map(angle))
    }

    /// The unit normal through a pixel's point and those of its right and lower neighbour.
    fn normal(&self, depth: &[f64], i: usize) -> Option<Vec3> {
        let (x, y) = (i % self.camera.width, i / self.camera.width);
        let (right, below) = (self.at(x + 1, y)?, self.at(x, y + 1)?);
        if !self.joined(i, right) || !self.joined(i, below) {
            return None;
        }
        let point = |x: usize, y: usize, depth: f64| {
            let (origin, direction) = self.camera.ray(x as f64, y as f64);
            add(origin, scale(direction, depth))
        };
        let here = point(x, y, depth[i]);
        let normal = cross(sub(point(x, y + 1, depth[below]), here), sub(point(x + 1, y, depth[right]), here));
        let size = length(normal);
        (size > 0.0).then(|| scale(normal, 1.0 / size))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Camera = Camera {
        width: 12,
        height: 10,
        focal: [20.0; 2],
        centre: [6.0, 5.0],
        pose: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
    };

    fn view(depth: impl Fn(usize, usize) -> f32) -> Vec<f32> {
        (0..120).map(|i| depth(i % 12, i / 12)).collect()
    }

    #[test]
    fn a_constant_offset_is_the_error_and_adds_no_roughness() {
        let truth = view(|_, _| 4.0);
        let metrics = DepthMetrics::of(&CAMERA, &view(|_, _| 4.25), &[1.0; 120], &truth, true);
        assert_eq!(
            (metrics.depth_mae, metrics.depth_rmse, metrics.depth_left_out),
            (Some(0.25), Some(0.25), Some(0.0))
        );
        assert_eq!((metrics.depth_roughness, metrics.depth_roughness_truth), (Some(0.0), Some(0.0)));
        assert!(metrics.normal_roughness.unwrap() < 1e-4);
        let inexact = DepthMetrics::of(&CAMERA, &truth, &[1.0; 120], &truth, false);
        assert_eq!((inexact.depth_roughness_truth, inexact.normal_roughness_truth), (None, None));
    }

    #[test]
    fn only_solid_pixels_on_known_surface_count() {
        let truth = view(|x, _| [f32::INFINITY, f32::NAN, 3.0, 3.0][x % 4]);
        let acc: Vec<f32> = (0..120).map(|i| if i % 4 == 3 { 0.4 } else { 1.0 }).collect();
        let metrics =
            DepthMetrics::of(&CAMERA, &view(|x, _| if x % 4 == 2 { 3.5 } else { f32::NAN }), &acc, &truth, true);
        assert_eq!((metrics.depth_mae, metrics.depth_left_out), (Some(0.5), Some(0.5)));
        let empty = DepthMetrics::of(&CAMERA, &truth, &acc, &view(|_, _| f32::INFINITY), true);
        assert_eq!(empty, DepthMetrics::default());
    }

    #[test]
    fn roughness_is_that_of_the_rendering_and_not_of_the_edges() {
        // A step of the reference that the rendering follows is no roughness; ripples are.
        let truth = view(|x, _| if x < 6 { 3.0 } else { 4.0 });
        let same = DepthMetrics::of(&CAMERA, &truth, &[1.0; 120], &truth, true);
        assert_eq!((same.depth_roughness, same.depth_mae), (Some(0.0), Some(0.0)));
        let rippled = view(|x, y| if x < 6 { 3.0 } else { 4.0 } + 0.01 * ((x + y) % 2) as f32);
        let metrics = DepthMetrics::of(&CAMERA, &rippled, &[1.0; 120], &truth, true);
        assert!((metrics.depth_roughness.unwrap() - 0.02).abs() < 1e-6);
        assert!(metrics.normal_roughness.unwrap() > 5.0, "{metrics:?}");
    }

    #[test]
    fn a_slanted_plane_has_one_normal() {
        // z = -(4 + x): depth t with t = 4 + t (px - 6) / 20.
        let plane = view(|x, _| 4.0 / (1.0 - (x as f32 - 6.0) / 20.0));
        let metrics = DepthMetrics::of(&CAMERA, &plane, &[1.0; 120], &plane, true);
        assert!(metrics.normal_roughness.is_none() || metrics.normal_roughness.unwrap() < 1e-3, "{metrics:?}");
        let gentle = view(|x, _| 4.0 / (1.0 - 0.3 * (x as f32 - 6.0) / 20.0));
        let metrics = DepthMetrics::of(&CAMERA, &gentle, &[1.0; 120], &gentle, true);
        assert!(metrics.normal_roughness.unwrap() < 1e-2, "{metrics:?}");
    }

    #[test]
    fn a_mean_over_views_of_which_one_lacks_the_metric_is_missing() {
        let one = DepthMetrics { depth_mae: Some(1.0), ..DepthMetrics::default() };
        let two = DepthMetrics { depth_mae: Some(2.0), depth_rmse: Some(1.0), ..DepthMetrics::default() };
        let means = DepthMetrics::mean(&[one, two]);
        assert_eq!((means.depth_mae, means.depth_rmse), (Some(1.5), None));
        assert_eq!(DepthMetrics::mean(&[]), DepthMetrics::default());
    }
}
