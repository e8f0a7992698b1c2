//! The video path of a capture with arbitrary poses: around what its cameras look at, no further than they went.

use std::f64::consts::{PI, TAU};

use super::pose::{self, Pose, Vec3};
use super::rig;

/// Poses of a path, as nerf-pytorch's.
pub const POSES: usize = 120;
/// Cameras go all around where they leave no gap of more than this, radians.
const WIDEST_GAP: f64 = 0.25 * TAU;
/// The share of the cameras that must have the common point before them.
const FACING: f64 = 0.9;
/// Mean of the unit viewing directions above which cameras without a common point look the same way.
const AGREEMENT: f64 = 0.5;
/// A swing covers the cameras' places but for this share on either end.
const MARGIN: f64 = 0.1;
/// Elevation from which a camera that looks at the centre has no up, radians.
const STEEPEST: f64 = 80.0 / 180.0 * PI;
/// How strongly up follows the cameras' mean up where their horizons leave it open.
const TOWARDS_MEAN: f64 = 0.01;

/// A path for these cameras:
///
/// - a circle around the point that they look at, at their mean height and distance, where they go all around it;
/// - a swing before it, an ellipse in azimuth and elevation within the range of the cameras, where they do not;
/// - a swing across their mean viewing direction, where they look the same way and at nothing in common;
/// - the cameras themselves, one after the other, where they do neither (a walk, a panorama).
///
/// In the first two the point is in the middle of every picture.
pub fn around(poses: &[Pose]) -> Vec<Pose> {
    let around = up(poses).and_then(|up| Around::of(poses, up));
    let path = around.and_then(|seen| if seen.widest_gap().0 <= WIDEST_GAP { seen.circle() } else { seen.swing() });
    path.or_else(|| across(poses)).unwrap_or_else(|| poses.to_vec())
}

/// The cameras look at a common point, and go around it without a wide gap.
pub fn goes_around(poses: &[Pose]) -> bool {
    up(poses).and_then(|up| Around::of(poses, up)).is_some_and(|seen| seen.widest_gap().0 <= WIDEST_GAP)
}

/// The point that cameras look at: next to all their viewing axes, and before nearly all of them.
pub fn centre(poses: &[Pose]) -> Option<Vec3> {
    let focus = pose::focus_point(poses)?;
    let faces = |p: &&Pose| pose::dot(pose::sub(focus, pose::column(p, 3)), pose::column(p, 2)) < 0.0;
    (poses.iter().filter(faces).count() as f64 >= FACING * poses.len() as f64).then_some(focus)
}

/// The direction across the cameras' right axes (people hold cameras level), and along their mean up as far as those leave
/// it open: the least squares of `right . up` with a ridge towards the mean. The mean alone leans away from cameras that
/// look down from one side.
fn up(poses: &[Pose]) -> Option<Vec3> {
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

/// Where cameras stand around the point that they look at.
struct Around {
    centre: Vec3,
    /// Axes: the first camera's side, the one a quarter turn on, up.
    axes: [Vec3; 3],
    /// Azimuth (radians), elevation (radians) and distance of each camera.
    places: Vec<[f64; 3]>,
    /// Mean height over the centre and mean distance from the axis.
    height: f64,
    radius: f64,
}

impl Around {
    /// None where they look at no common point, or all stand above it.
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

    /// The widest gap between neighbours in azimuth, and the azimuth where it ends.
    fn widest_gap(&self) -> (f64, f64) {
        let mut azimuths: Vec<f64> = self.places.iter().map(|place| place[0]).collect();
        azimuths.sort_by(f64::total_cmp);
        let next = azimuths.iter().skip(1).copied().chain([azimuths[0] + TAU]);
        let gaps = azimuths.iter().zip(next).map(|(from, to)| (to - from, to));
        gaps.max_by(|a, b| a.0.total_cmp(&b.0)).expect("there is a camera")
    }

    /// The pose at an azimuth, height over the centre and distance from the axis that looks at the centre.
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

/// A swing in the plane of the mean camera, which keeps its direction; none where the cameras' directions differ much.
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

/// Middle and half width of what numbers cover, [`MARGIN`] on either end left out.
fn range(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let values: Vec<f64> = values.collect();
    let (low, high) = (percentile(values.clone(), MARGIN), percentile(values, 1.0 - MARGIN));
    [0.5 * (low + high), 0.5 * (high - low)]
}

/// A percentile of at least one number, as NumPy's default.
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
