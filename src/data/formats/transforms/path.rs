//! The video path of a capture with arbitrary poses.

use std::f64::consts::TAU;

use crate::base::Result;
use crate::data::formats::llff::{POSES, spiral};
use crate::data::pose::{self, Pose};

/// Mean of the unit viewing directions above which all cameras look the same way.
const FORWARD_FACING: f64 = 0.8;

/// A circle through the cameras' mean height and distance around the point they look at; a spiral
/// where they look the same way, or at nothing in common.
pub(in crate::data::formats) fn around(poses: &[Pose]) -> Result<Vec<Pose>> {
    let agreement = pose::length(pose::mean(poses.iter().map(|p| pose::column(p, 2))));
    let circle = if agreement < FORWARD_FACING { orbit(poses) } else { None };
    match circle {
        Some(path) => Ok(path),
        None => {
            let distance = focus_distance(poses);
            spiral(poses, distance, distance)
        }
    }
}

/// `None` where the cameras look at no common point or have no common up.
fn orbit(poses: &[Pose]) -> Option<Vec<Pose>> {
    let focus = pose::focus_point(poses)?;
    let up = pose::normalized(pose::mean(poses.iter().map(|p| pose::column(p, 1))))?;
    let offsets: Vec<_> = poses.iter().map(|p| pose::sub(pose::column(p, 3), focus)).collect();
    let flat = |o| pose::add_scaled(o, -pose::dot(o, up), up);
    let height = offsets.iter().map(|&o| pose::dot(o, up)).sum::<f64>() / poses.len() as f64;
    let radius = offsets.iter().map(|&o| pose::length(flat(o))).sum::<f64>() / poses.len() as f64;
    let first = offsets.iter().find_map(|&o| pose::normalized(flat(o)))?;
    let second = pose::cross(up, first);
    let at = |i: usize| {
        let (sin, cos) = (TAU * i as f64 / POSES as f64).sin_cos();
        let side = pose::add_scaled(first.map(|v| v * cos), sin, second);
        let offset = pose::add_scaled(up.map(|v| v * height), radius, side);
        pose::look_along(offset, up, pose::add_scaled(focus, 1.0, offset))
    };
    (0..POSES).map(at).collect()
}

/// How far in front of the cameras their axes meet; 1 where they do not.
fn focus_distance(poses: &[Pose]) -> f64 {
    let Some(focus) = pose::focus_point(poses) else { return 1.0 };
    let ahead = |p: &Pose| -pose::dot(pose::sub(focus, pose::column(p, 3)), pose::column(p, 2));
    let distance = poses.iter().map(ahead).sum::<f64>() / poses.len() as f64;
    if distance > 0.0 && distance.is_finite() { distance } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ring_of_cameras_is_followed() {
        let at = |i: usize| {
            let (sin, cos) = (TAU * i as f64 / 12.0).sin_cos();
            pose::look_along([2.0 * cos, 2.0 * sin, 1.0], [0.0, 0.0, 1.0], [3.0 + 2.0 * cos, 2.0 * sin, 1.0]).unwrap()
        };
        let ring: Vec<Pose> = (0..12).map(at).collect();
        let path = around(&ring).unwrap();
        assert_eq!(path.len(), POSES);
        for (a, b) in path.iter().step_by(10).zip(&ring) {
            for (a, b) in a.iter().flatten().zip(b.iter().flatten()) {
                assert!((a - b).abs() < 1e-9, "{a} {b}");
            }
        }
    }

    #[test]
    fn cameras_side_by_side_get_a_spiral() {
        let at = |i: usize| pose::look_along([0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [i as f64, 0.0, 0.0]).unwrap();
        let row: Vec<Pose> = (0..5).map(at).collect();
        assert!(around(&row).unwrap().iter().all(|p| p.iter().flatten().all(|v| v.is_finite())));
    }
}
