//! nerf-pytorch's camera paths for videos of LLFF scenes.

use std::f64::consts::TAU;

use super::Poses;
use crate::path::{POSES, percentile};
use crate::pose::{self, Pose, Vec3};
use augnerf_base::{Error, Result};

/// Turns of the spiral.
const TURNS: f64 = 2.0;
/// Oscillations along the view axis per turn of the spiral.
const DEPTH_RATE: f64 = 0.5;
/// Fraction of the cameras that the spiral's radius covers on each axis.
const RADIUS_PERCENTILE: f64 = 0.9;

impl Poses {
    /// Returns a spiral around the average pose that looks at the distance of most of the scene. That is a mean in
    /// disparity between the nearest and the farthest bound, with the latter pushed out as in nerf-pytorch.
    pub fn spiral(&self) -> Result<Vec<Pose>> {
        const FAR_SHARE: f64 = 0.75;
        let (poses, close, distant) = (&self.poses, 0.9 * self.nearest(), 5.0 * self.farthest());
        let focus = 1.0 / ((1.0 - FAR_SHARE) / close + FAR_SHARE / distant);
        let average = pose::average(poses).ok_or_else(no_path)?;
        let up = pose::mean(poses.iter().map(|p| pose::column(p, 1)));
        let target = pose::transform(&average, [0.0, 0.0, -focus]);
        let radii: Vec3 =
            std::array::from_fn(|axis| percentile(poses.iter().map(|p| p[axis][3].abs()).collect(), RADIUS_PERCENTILE));
        let at = |i: usize| {
            let angle = TAU * TURNS * i as f64 / POSES as f64;
            let offset = [angle.cos() * radii[0], -angle.sin() * radii[1], -(angle * DEPTH_RATE).sin() * radii[2]];
            let origin = pose::transform(&average, offset);
            pose::look_along(pose::sub(origin, target), up, origin).ok_or_else(no_path)
        };
        (0..POSES).map(at).collect()
    }

    /// Returns a circle around the z axis at the cameras' mean height and mean distance from the origin, which it looks at.
    /// First and last pose coincide, and up is -z, both as in nerf-pytorch.
    pub fn circle(&self) -> Result<Vec<Pose>> {
        let poses = &self.poses;
        let origins = || poses.iter().map(|p| pose::column(p, 3));
        let height = pose::mean(origins())[2];
        let square = origins().map(|o| pose::dot(o, o)).sum::<f64>() / poses.len() as f64;
        let radius = (square - height * height).max(0.0).sqrt();
        let at = |i: usize| {
            let angle = TAU * i as f64 / (POSES - 1) as f64;
            let origin = [radius * angle.cos(), radius * angle.sin(), height];
            let back = pose::normalized(origin).ok_or_else(no_path)?;
            let right = pose::normalized(pose::cross(back, [0.0, 0.0, -1.0])).ok_or_else(no_path)?;
            let up = pose::normalized(pose::cross(back, right)).ok_or_else(no_path)?;
            Ok(pose::from_columns([right, up, back, origin]))
        };
        (0..POSES).map(at).collect()
    }
}

fn no_path() -> Error {
    Error::Data("the cameras' poses are degenerate (directions that cancel out): no video path goes around them".into())
}
