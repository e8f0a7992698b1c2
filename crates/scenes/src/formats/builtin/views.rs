//! The cameras of the built-in scene.

use std::f64::consts::{PI, TAU};

use super::stage::Frame;
use crate::Camera;
use crate::formats::transforms::Role;
use crate::vector::{Vec3, add, cross, scale, sub, unit};

/// Horizontal field of view of the Blender-style cameras in radians, as in NeRF-synthetic.
pub const ANGLE_X: f64 = 0.691_111_207_008_361_8;
/// Distance of the Blender-style cameras to the origin.
const DISTANCE: f64 = 4.0;
/// Height over width of the forward-facing images.
pub const FORWARD_ASPECT: f64 = 0.76;
/// Focal length over width of the forward-facing cameras.
const FORWARD_FOCAL: f64 = 1.05;
/// Still-life units per unit of the forward-facing frame.
const FORWARD_SCALE: f64 = 1.6;
/// Depth of the point that the forward-facing cameras turn towards, in their frame.
const FOCUS: f64 = 2.6;
/// Range of the forward-facing cameras to the sides, up and along the view.
const SPREAD: Vec3 = [0.30, 0.20, 0.08];

/// Returns named cameras of a split on the upper hemisphere, with square images of `width` pixels per side.
pub fn around(split: Role, width: usize) -> Vec<(String, Camera)> {
    let directions: Vec<Vec3> = match split {
        Role::Train => (0..40).map(|i| fibonacci(i, 40)).collect(),
        Role::Val => (0..4).map(|i| on_ring(i as f64 / 4.0 + 0.06, [0.35, 0.75][i % 2])).collect(),
        Role::Test => (0..8).map(|i| on_ring(i as f64 / 8.0 + 0.03, [0.45, 0.20, 0.65, 0.90][i % 4])).collect(),
    };
    let named = |(i, d): (usize, Vec3)| (format!("r_{i}"), square(scale(d, DISTANCE), width));
    directions.into_iter().enumerate().map(named).collect()
}

/// Returns the video path around the scene, 30 degrees above the ground.
pub fn orbit(width: usize) -> Vec<Camera> {
    (0..40).map(|i| square(scale(on_ring(f64::from(i) / 40.0, PI / 6.0), DISTANCE), width)).collect()
}

/// Returns a point of an even spread over the upper hemisphere: equal steps in height, the golden angle between.
fn fibonacci(i: usize, count: usize) -> Vec3 {
    let height = 0.04 + 0.92 * (i as f64 + 0.5) / count as f64;
    let (s, c) = (i as f64 * PI * (3.0 - 5f64.sqrt())).sin_cos();
    let radius = (1.0 - height * height).sqrt();
    [radius * c, radius * s, height]
}

/// Returns a unit vector at a fraction of a full turn (0 at the front, -y) and an elevation in radians.
fn on_ring(turn: f64, elevation: f64) -> Vec3 {
    let (s, c) = (turn * TAU - 0.5 * PI).sin_cos();
    [elevation.cos() * c, elevation.cos() * s, elevation.sin()]
}

fn square(from: Vec3, width: usize) -> Camera {
    let focal = 0.5 * width as f64 / (0.5 * ANGLE_X).tan();
    camera(look_at(from, [0.0; 3], [0.0, 0.0, 1.0]), [width, width], focal)
}

fn camera(pose: [[f64; 4]; 3], size: [usize; 2], focal: f64) -> Camera {
    let [width, height] = size;
    Camera { width, height, focal: [focal; 2], centre: [0.5 * width as f64, 0.5 * height as f64], pose }
}

/// Returns the camera-to-world matrix of a camera at `from` that looks at `to`, in OpenGL axes.
fn look_at(from: Vec3, to: Vec3, up: Vec3) -> [[f64; 4]; 3] {
    let z = unit(sub(from, to));
    let x = unit(cross(up, z));
    let y = cross(z, x);
    std::array::from_fn(|i| [x[i], y[i], z[i], from[i]])
}

/// Returns the normalized frame of the forward-facing scene: its origin is in front of the still life, and it looks a
/// little down.
pub fn forward_frame() -> Frame {
    let pose = look_at([0.0, -3.35, 0.46], [0.0, 0.1, -0.02], [0.0, 0.0, 1.0]);
    Frame { scale: FORWARD_SCALE, axes: pose.map(|row| [row[0], row[1], row[2]]), shift: pose.map(|row| row[3]) }
}

fn forward_camera(origin: Vec3, width: usize) -> Camera {
    let height = (FORWARD_ASPECT * width as f64).round() as usize;
    let pose = look_at(origin, [0.0, 0.0, -FOCUS], [0.0, 1.0, 0.0]);
    camera(pose, [width, height], FORWARD_FOCAL * width as f64)
}

/// Returns named cameras in front of the scene: five columns and four rows, moved off the grid by low-discrepancy steps
/// like hand-held ones.
pub fn before(width: usize) -> Vec<(String, Camera)> {
    let place = |i: usize| {
        let grid = [(i % 5) as f64 / 2.0 - 1.0, (i / 5) as f64 / 1.5 - 1.0, 0.0];
        let step = |g: f64| 2.0 * (0.5 + g * (i as f64 + 1.0)).fract() - 1.0;
        let off = [0.2 * step(0.819_172_5), 0.2 * step(0.671_043_6), step(0.549_700_5)];
        let [x, y, z] = add(grid, off);
        [SPREAD[0] * x, SPREAD[1] * y, SPREAD[2] * z]
    };
    (0..20).map(|i| (format!("view_{i:03}"), forward_camera(place(i), width))).collect()
}

/// Returns the video path of forward-facing scenes: two turns of a spiral towards the same focus.
pub fn spiral(width: usize) -> Vec<Camera> {
    let place = |i: usize| {
        let angle = 2.0 * TAU * i as f64 / 60.0;
        [SPREAD[0] * angle.cos(), -SPREAD[1] * angle.sin(), -SPREAD[2] * (0.5 * angle).sin()]
    };
    (0..60).map(|i| forward_camera(place(i), width)).collect()
}
