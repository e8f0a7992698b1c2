//! Writing of cameras.

use std::path::Path;

use serde_json::{Map, Value, json};

use super::super::pose::{self, Pose};
use super::super::{Camera, WorldToScene};
use augnerf_base::Result;
use augnerf_base::files::write_named;

/// Distance in pixels from the lens of a field of view above which a lens is written out.
const ROUNDING: f64 = 1e-9;

/// Writes cameras of a scene in the units of its capture, as nerfstudio's `camera_path.json`. [`read`](super::read) restores
/// the same cameras.
///
/// # Errors
/// If the name has another extension, there are too many cameras, or the file cannot be written.
pub fn write(file: &Path, cameras: &[Camera], world: &WorldToScene, fps: f64) -> Result<()> {
    super::check_count(file, cameras.len())?;
    super::check_ending(file)?;
    write_named(file, format!("{:#}\n", camera_path(cameras, world, fps)).as_bytes())
}

/// Returns the contents of a `camera_path.json` with these cameras.
pub fn camera_path(cameras: &[Camera], world: &WorldToScene, fps: f64) -> Value {
    let (width, height) = cameras.first().map_or((0, 0), |camera| (camera.width, camera.height));
    let camera = |camera: &Camera| {
        let mut entry = Map::new();
        let pose = to_capture(world, &camera.pose);
        let matrix: Vec<f64> = pose.into_iter().flatten().chain([0.0, 0.0, 0.0, 1.0]).collect();
        entry.insert("camera_to_world".into(), matrix.into());
        entry.insert("fov".into(), (2.0 * (0.5 * camera.height as f64 / camera.focal[1]).atan().to_degrees()).into());
        entry.insert("aspect".into(), (camera.width as f64 / camera.height as f64).into());
        unsaid(camera, (width, height)).into_iter().for_each(|(key, value)| drop(entry.insert(key.into(), value)));
        Value::Object(entry)
    };
    json!({
        "camera_type": "perspective",
        "render_height": height,
        "render_width": width,
        "fps": fps,
        "seconds": cameras.len() as f64 / fps,
        "camera_path": cameras.iter().map(camera).collect::<Vec<Value>>(),
    })
}

/// Returns what field of view and common size do not state about a camera.
fn unsaid(camera: &Camera, size: (usize, usize)) -> Vec<(&'static str, Value)> {
    let mut said = Vec::new();
    if (camera.width, camera.height) != size {
        said.extend([("w", camera.width.into()), ("h", camera.height.into())]);
    }
    if (camera.focal[0] - camera.focal[1]).abs() > ROUNDING {
        said.extend([("fl_x", camera.focal[0].into()), ("fl_y", camera.focal[1].into())]);
    }
    let middle = [0.5 * camera.width as f64, 0.5 * camera.height as f64];
    if camera.centre.iter().zip(middle).any(|(centre, middle)| (centre - middle).abs() > ROUNDING) {
        said.extend([("cx", camera.centre[0].into()), ("cy", camera.centre[1].into())]);
    }
    said
}

/// Maps a camera of the scene to the capture's units.
fn to_capture(world: &WorldToScene, camera: &Pose) -> Pose {
    let [right, up, back] = [0, 1, 2].map(|axis| world.direction_to_capture(pose::column(camera, axis)));
    pose::from_columns([right, up, back, world.to_capture(pose::column(camera, 3))])
}
