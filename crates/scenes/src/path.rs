//! The video path of a capture with arbitrary poses: around what its cameras look at, within the range of the cameras.

use std::f64::consts::{PI, TAU};

use super::pose::{self, Pose, Vec3};
use super::rig;

/// Number of poses on a path, as in nerf-pytorch.
pub const POSES: usize = 120;
/// Cameras go all around if no gap is larger than this, in radians.
const WIDEST_GAP: f64 = 0.25 * TAU;
/// The fraction of the cameras that must have the common point in front of them.
const FACING: f64 = 0.9;
/// Length of the mean viewing direction above which cameras without a common point look the same way.
const AGREEMENT: f64 = 0.5;
/// A swing covers the cameras' positions except for this fraction at either end.
const MARGIN: f64 = 0.1;
/// Elevation above which a camera that looks at the centre has no up, in radians.
const STEEPEST: f64 = 80.0 / 180.0 * PI;
/// How strongly up follows the cameras' mean up if their horizons leave it open.
const TOWARDS_MEAN: f64 = 0.01;

/// Returns a path for these cameras:
///
/// - a circle around the point that they look at, at their mean height and distance, if they go all around it;
/// - a swing in front of it, an ellipse in azimuth and elevation within the range of the cameras, if they do not;
/// - a swing across their mean viewing direction, if they look the same way but at no common point;
/// - the cameras themselves, one after the other, otherwise (a walk, a panorama).
///
/// In the first two the point is in the middle of every image.
pub fn around(poses: &[Pose]) -> Vec<Pose> {
    let around = up(poses).and_then(|up| Around::of(poses, up));
    let path = around.and_then(|seen| if seen.widest_gap().0 <= WIDEST_GAP { seen.circle() } else { seen.swing() });
    path.or_else(|| across(poses)).unwrap_or_else(|| poses.to_vec())
}

/// Returns whether the cameras look at a common point, and go around it without a wide gap.
pub fn goes_around(poses: &[Pose]) -> bool {
    up(poses).and_then(|up| Around::of(poses, up)).is_some_and(|seen| seen.widest_gap().0 <= WIDEST_GAP)
}

/// Returns the point that cameras look at: close to all their viewing axes, and in front of nearly all of them.
pub fn centre(poses: &[Pose]) -> Option<Vec3> {
    let focus = pose::focus_point(poses)?;
    let faces = |p: &&Pose| pose::dot(pose::sub(focus, pose::column(p, 3)), pose::column(p, 2)) < 0.0;
    (poses.iter().filter(faces).count() as f64 >= FACING * poses.len() as f64).then_some(focus)
}

/// Returns the up direction: perpendicular to the cameras' right axes (people hold cameras level), and otherwise along
/// their mean up. It is the least squares solution of `right . up` with a ridge towards the mean. The mean alone leans
/// away from cameras that look down from one side.
pub(super) fn up(poses: &[Pose]) -> Option<Vec3> {
    let mean = pose::mean(poses.iter().map(|p| pose::column(p, 1)));
    let mut matrix = [[0.0; 3]; 3];
    for right in poses.iter().map(|p| pose::column(p, 0)) {
        for (i, row) in matrix.iter_mut().enumerate() {
            row.iter_mut().zip(right).for_each(|(value, across)| *value += right[i] * across / poses.len() as f64);
        }
    }
    (0..3).for_each(|i| matrix[i][i] += TOWARDS_MEAN);
    pose::normalized(pose::solve(matrix, mean)?).or_else(|| pose::normalized(mean))
}

/// The cameras' positions around the point that they look at.
struct Around {
    centre: Vec3,
    /// Axes: the first camera's side, the one a quarter turn on, and up.
    axes: [Vec3; 3],
    /// Azimuth (radians), elevation (radians) and distance of each camera.
    places: Vec<[f64; 3]>,
    /// Mean height over the centre and mean distance from the axis.
    height: f64,
    radius: f64,
}

impl Around {
    /// Returns `None` if they look at no common point, or are all above it.
    fn of(poses: &[Pose], up: Vec3) -> Option<Around> {
        let centre = centre(poses)?;
        let offsets: Vec<Vec3> = poses.iter().map(|p| pose::sub(pose::column(p, 3), centre)).collect();
        let flat = |o: Vec3| pose::add_scaled(o, -pose::dot(o, up), up);
        let first = offsets.iter().find_map(|&o| pose::normalized(flat(o)))?;
        let axes = [first, pose::cross(up, first), up];
        let place = |o: &Vec3| {
            let [x, y, z] = axes.map(|axis| pose::dot(*o, axis));
            [y.atan2(x), z.atan2(x.hypot(y)), pose::length(*o)]
        };
        let mean = |of: &dyn Fn(Vec3) -> f64| offsets.iter().map(|&o| of(o)).sum::<f64>() / offsets.len() as f64;
        let (height, radius) = (mean(&|o| pose::dot(o, up)), mean(&|o| pose::length(flat(o))));
        Some(Around { centre, axes, places: offsets.iter().map(place).collect(), height, radius })
    }

    /// Returns the widest gap between neighbours in azimuth, and the azimuth where it ends.
    fn widest_gap(&self) -> (f64, f64) {
        let mut azimuths: Vec<f64> = self.places.iter().map(|place| place[0]).collect();
        azimuths.sort_by(f64::total_cmp);
        let next = azimuths.iter().skip(1).copied().chain([azimuths[0] + TAU]);
        let gaps = azimuths.iter().zip(next).map(|(from, to)| (to - from, to));
        gaps.max_by(|a, b| a.0.total_cmp(&b.0)).expect("there is a camera")
    }

    /// Returns the pose at an azimuth, height over the centre and distance from the axis that looks at the centre.
    fn pose(&self, azimuth: f64, height: f64, radius: f64) -> Option<Pose> {
        let [first, second, up] = self.axes;
        let (sin, cos) = azimuth.sin_cos();
        let side = pose::add_scaled(first.map(|v| v * cos), sin, second);
        let offset = pose::add_scaled(up.map(|v| v * height), radius, side);
        pose::look_along(offset, up, pose::add_scaled(self.centre, 1.0, offset))
    }

    fn circle(&self) -> Option<Vec<Pose>> {
        (0..POSES).map(|i| self.pose(TAU * i as f64 / POSES as f64, self.height, self.radius)).collect()
    }

    fn swing(&self) -> Option<Vec<Pose>> {
        let (_, start) = self.widest_gap();
        let azimuth = range(self.places.iter().map(|place| (place[0] - start).rem_euclid(TAU)));
        let elevation = range(self.places.iter().map(|place| place[1].clamp(-STEEPEST, STEEPEST)));
        let distance = self.places.iter().map(|place| place[2]).sum::<f64>() / self.places.len() as f64;
        let at = |i: usize| {
            let (sin, cos) = (TAU * i as f64 / POSES as f64).sin_cos();
            let (rise, along) = (elevation[0] + sin * elevation[1]).sin_cos();
            self.pose(start + azimuth[0] + cos * azimuth[1], distance * rise, distance * along)
        };
        (0..POSES).map(at).collect()
    }
}

/// Returns a swing in the plane of the mean camera, which keeps its direction. `None` if the cameras' directions differ
/// too much.
fn across(poses: &[Pose]) -> Option<Vec<Pose>> {
    let agreement = pose::length(pose::mean(poses.iter().map(|p| pose::column(p, 2))));
    let average = &pose::average(poses).filter(|_| agreement >= AGREEMENT)?;
    let inverse = pose::inverse_rigid(average);
    let places: Vec<Vec3> = poses.iter().map(|p| pose::transform(&inverse, pose::column(p, 3))).collect();
    let [x, y] = [0, 1].map(|axis| range(places.iter().map(|place| place[axis])));
    let at = |i: usize| {
        let (sin, cos) = (TAU * i as f64 / POSES as f64).sin_cos();
        let origin = pose::transform(average, [x[0] + cos * x[1], y[0] + sin * y[1], 0.0]);
        pose::from_columns([0, 1, 2, 3].map(|i| if i < 3 { pose::column(average, i) } else { origin }))
    };
    Some((0..POSES).map(at).collect())
}

/// Returns middle and half width of the range of numbers, without [`MARGIN`] at either end.
fn range(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let values: Vec<f64> = values.collect();
    let (low, high) = (percentile(values.clone(), MARGIN), percentile(values, 1.0 - MARGIN));
    [0.5 * (low + high), 0.5 * (high - low)]
}

/// Returns a percentile of at least one number, as NumPy's default.
pub fn percentile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    rig::percentile(&values, share)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(count: usize, share: f64) -> Vec<Pose> {
        let at = |i: usize| {
            let (sin, cos) = (share * TAU * i as f64 / count as f64).sin_cos();
            pose::look_along([2.0 * cos, 2.0 * sin, 1.0], [0.0, 0.0, 1.0], [3.0 + 2.0 * cos, 2.0 * sin, 1.0]).unwrap()
        };
        (0..count).map(at).collect()
    }

    #[test]
    fn percentile_interpolates() {
        assert_eq!(percentile(vec![3.0, 1.0, 2.0], 0.75), 2.5);
        assert_eq!(percentile(vec![4.0], 0.9), 4.0);
    }

    #[test]
    fn a_ring_of_cameras_is_followed() {
        let ring = ring(12, 1.0);
        let path = around(&ring);
        assert!(goes_around(&ring) && path.len() == POSES);
        for (a, b) in path.iter().step_by(10).zip(&ring) {
            for (a, b) in a.iter().flatten().zip(b.iter().flatten()) {
                assert!((a - b).abs() < 1e-9, "{a} {b}");
            }
        }
    }

    /// Up is the ring's axis although all cameras look down from one side, and no frame leaves their range.
    #[test]
    fn an_arc_of_cameras_is_swung_along() {
        let arc = ring(12, 0.27);
        let (path, centre) = (around(&arc), centre(&arc).unwrap());
        assert!(!goes_around(&arc));
        let azimuth = |p: &Pose| p[1][3].atan2(p[0][3] - 3.0).to_degrees();
        for p in &path {
            let offset = pose::sub(pose::column(p, 3), centre);
            assert!(pose::length(pose::cross(offset, pose::column(p, 2))) < 1e-9, "it looks at the centre");
            assert!((0.0..=97.2 * 11.0 / 12.0).contains(&azimuth(p)), "{}", azimuth(p));
            assert!((pose::length(offset) - 5f64.sqrt()).abs() < 1e-6);
            assert!(p[2][0].abs() < 0.03, "level but for the ridge's pull to the mean");
        }
        let reached = path.iter().map(azimuth).fold(0.0, f64::max);
        assert!(reached > 75.0, "{reached}");
    }

    #[test]
    fn cameras_side_by_side_are_swung_across() {
        let at = |i: usize| pose::look_along([0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [i as f64, 0.0, 0.0]).unwrap();
        let row: Vec<Pose> = (0..5).map(at).collect();
        for p in around(&row) {
            assert_eq!(pose::column(&p, 2), [0.0, 0.0, 1.0]);
            assert!((0.0..=4.0).contains(&p[0][3]) && p[1][3] == 0.0 && p[2][3] == 0.0);
        }
    }

    #[test]
    fn a_panorama_is_its_own_path() {
        let outward: Vec<Pose> = ring(8, 1.0)
            .iter()
            .map(|p| pose::look_along(pose::column(p, 2).map(|v| -v), [0.0, 0.0, 1.0], pose::column(p, 3)).unwrap())
            .collect();
        assert_eq!(around(&outward), outward);
    }
}
