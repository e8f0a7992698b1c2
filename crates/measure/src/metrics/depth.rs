//! How well, and how smoothly, a rendered view's depth follows the scene's own.
//!
//! All lengths are scene units along the viewing axis. A pixel counts where the reference has a surface, of known
//! depth, and the rendering is solid there (accumulation of at least a half); what of the reference's surface does not
//! count is reported as a share. Roughness is measured on what lies in one surface of the reference: not across
//! neighbours whose reference depths differ by more than 2.5 % of the nearer one.

use super::{
    DEPTH_LEFT_OUT, DEPTH_MAE, DEPTH_RMSE, DEPTH_ROUGHNESS, DEPTH_ROUGHNESS_TRUTH, NORMAL_ROUGHNESS,
    NORMAL_ROUGHNESS_TRUTH, ViewMetrics,
};
use augnerf_scenes::Camera;
use augnerf_scenes::vector::{Vec3, add, cross, dot, length, scale, sub};

/// Accumulation from which on a rendered pixel has a depth.
const SOLID: f32 = 0.5;
/// Neighbours that differ by a larger share of their depth lie on different surfaces.
const EDGE: f64 = 0.025;

/// A view's depth and where it may be compared.
struct Compared<'a> {
    camera: &'a Camera,
    /// Reference depth where the pixel counts, NaN elsewhere.
    reference: Vec<f64>,
    rendered: Vec<f64>,
}

/// Fills a view's geometry. Compares `rendered` depth (along the viewing axis, scene units, any value where `acc` is low)
/// with the reference's, row-major; `exact` says whether the reference's own roughness means anything.
///
/// | metric | what |
/// |---|---|
/// | `depth_mae`, `depth_rmse` | mean absolute error and root of the mean squared one, over the pixels that count |
/// | `depth_left_out` | share of the pixels with known reference depth whose rendering is not solid |
/// | `depth_roughness` | mean absolute second difference of depth, d(i-1) - 2 d(i) + d(i+1), over rows and columns |
/// | `normal_roughness` | mean angle between the normals of neighbouring pixels, each the normal through the points of the pixel and of its right and lower neighbour |
/// | `*_truth` | the reference's own over the same pixels |
pub fn measure_depth(
    view: &mut ViewMetrics,
    camera: &Camera,
    rendered: &[f32],
    acc: &[f32],
    reference: &[f32],
    exact: bool,
) {
    let known = reference.iter().filter(|depth| depth.is_finite()).count();
    let counts = |i: usize| reference[i].is_finite() && acc[i] >= SOLID && rendered[i].is_finite();
    let counted = |i: usize| if counts(i) { f64::from(reference[i]) } else { f64::NAN };
    let compared = Compared {
        camera,
        reference: (0..reference.len()).map(counted).collect(),
        rendered: rendered.iter().copied().map(f64::from).collect(),
    };
    let errors = || (0..reference.len()).filter(|&i| counts(i)).map(|i| compared.rendered[i] - compared.reference[i]);
    let truth = |roughness: Option<f64>| roughness.filter(|_| exact);
    let values = &mut view.values;
    values.set(&DEPTH_MAE, mean(errors().map(f64::abs)));
    values.set(&DEPTH_RMSE, mean(errors().map(|error| error * error)).map(f64::sqrt));
    values.set(&DEPTH_LEFT_OUT, (known > 0).then(|| 1.0 - errors().count() as f64 / known as f64));
    values.set(&DEPTH_ROUGHNESS, compared.depth_roughness(&compared.rendered));
    values.set(&DEPTH_ROUGHNESS_TRUTH, truth(compared.depth_roughness(&compared.reference)));
    values.set(&NORMAL_ROUGHNESS, compared.normal_roughness(&compared.rendered));
    values.set(&NORMAL_ROUGHNESS_TRUTH, truth(compared.normal_roughness(&compared.reference)));
}

/// A view's depth errors, rendered minus reference, at the pixels whose reference depth is known, row-major; NaN where the
/// rendering is not solid. Over the others [`measure_depth`] takes its errors.
pub fn depth_errors(rendered: &[f32], acc: &[f32], reference: &[f32]) -> Vec<f32> {
    let error = |i: usize| match acc[i] >= SOLID && rendered[i].is_finite() {
        true => (f64::from(rendered[i]) - f64::from(reference[i])) as f32,
        false => f32::NAN,
    };
    (0..reference.len()).filter(|&i| reference[i].is_finite()).map(error).collect()
}

/// Returns the mean of some values, or `None` without any.
pub fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
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
    use crate::metrics::MeanMetrics;

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

    fn measured(rendered: &[f32], acc: &[f32], reference: &[f32], exact: bool) -> ViewMetrics {
        let mut view = ViewMetrics::new("v");
        measure_depth(&mut view, &CAMERA, rendered, acc, reference, exact);
        view
    }

    #[test]
    fn a_constant_offset_is_the_error_and_adds_no_roughness() {
        let truth = view(|_, _| 4.0);
        let metrics = measured(&view(|_, _| 4.25), &[1.0; 120], &truth, true);
        assert_eq!(
            (metrics.get(&DEPTH_MAE), metrics.get(&DEPTH_RMSE), metrics.get(&DEPTH_LEFT_OUT)),
            (Some(0.25), Some(0.25), Some(0.0))
        );
        assert_eq!((metrics.get(&DEPTH_ROUGHNESS), metrics.get(&DEPTH_ROUGHNESS_TRUTH)), (Some(0.0), Some(0.0)));
        assert!(metrics.get(&NORMAL_ROUGHNESS).unwrap() < 1e-4);
        let inexact = measured(&truth, &[1.0; 120], &truth, false);
        assert_eq!((inexact.get(&DEPTH_ROUGHNESS_TRUTH), inexact.get(&NORMAL_ROUGHNESS_TRUTH)), (None, None));
    }

    #[test]
    fn only_solid_pixels_on_known_surface_count() {
        let truth = view(|x, _| [f32::INFINITY, f32::NAN, 3.0, 3.0][x % 4]);
        let acc: Vec<f32> = (0..120).map(|i| if i % 4 == 3 { 0.4 } else { 1.0 }).collect();
        let metrics = measured(&view(|x, _| if x % 4 == 2 { 3.5 } else { f32::NAN }), &acc, &truth, true);
        assert_eq!((metrics.get(&DEPTH_MAE), metrics.get(&DEPTH_LEFT_OUT)), (Some(0.5), Some(0.5)));
        // The errors that are kept are those of the same pixels: 30 known ones of each kind, one kind solid.
        let errors = depth_errors(&view(|x, _| if x % 4 == 2 { 3.5 } else { f32::NAN }), &acc, &truth);
        assert_eq!((errors.len(), errors.iter().filter(|error| **error == 0.5).count()), (60, 30));
        assert_eq!(errors.iter().filter(|error| error.is_nan()).count(), 30);
        let empty = measured(&truth, &acc, &view(|_, _| f32::INFINITY), true);
        assert_eq!(empty, ViewMetrics::new("v"));
    }

    #[test]
    fn roughness_is_that_of_the_rendering_and_not_of_the_edges() {
        // A step of the reference that the rendering follows is no roughness; ripples are.
        let truth = view(|x, _| if x < 6 { 3.0 } else { 4.0 });
        let same = measured(&truth, &[1.0; 120], &truth, true);
        assert_eq!((same.get(&DEPTH_ROUGHNESS), same.get(&DEPTH_MAE)), (Some(0.0), Some(0.0)));
        let rippled = view(|x, y| if x < 6 { 3.0 } else { 4.0 } + 0.01 * ((x + y) % 2) as f32);
        let metrics = measured(&rippled, &[1.0; 120], &truth, true);
        assert!((metrics.get(&DEPTH_ROUGHNESS).unwrap() - 0.02).abs() < 1e-6);
        assert!(metrics.get(&NORMAL_ROUGHNESS).unwrap() > 5.0, "{metrics:?}");
    }

    #[test]
    fn a_slanted_plane_has_one_normal() {
        // z = -(4 + x): depth t with t = 4 + t (px - 6) / 20.
        let plane = view(|x, _| 4.0 / (1.0 - (x as f32 - 6.0) / 20.0));
        let metrics = measured(&plane, &[1.0; 120], &plane, true);
        assert!(
            metrics.get(&NORMAL_ROUGHNESS).is_none() || metrics.get(&NORMAL_ROUGHNESS).unwrap() < 1e-3,
            "{metrics:?}"
        );
        let gentle = view(|x, _| 4.0 / (1.0 - 0.3 * (x as f32 - 6.0) / 20.0));
        let metrics = measured(&gentle, &[1.0; 120], &gentle, true);
        assert!(metrics.get(&NORMAL_ROUGHNESS).unwrap() < 1e-2, "{metrics:?}");
    }

    #[test]
    fn a_mean_over_views_of_which_one_lacks_the_metric_is_missing() {
        let view = |mae: f64, rmse: Option<f64>| {
            let mut view = ViewMetrics::new("v");
            view.values.set(&DEPTH_MAE, Some(mae));
            view.values.set(&DEPTH_RMSE, rmse);
            view
        };
        let means = MeanMetrics::from_views(&[view(1.0, None), view(2.0, Some(1.0))]);
        assert_eq!((means.get(&DEPTH_MAE), means.get(&DEPTH_RMSE)), (Some(1.5), None));
    }
}
