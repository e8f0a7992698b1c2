//! Files of cameras to render: a nerfstudio `camera_path.json`, or a `transforms.json`.
//!
//! A file's poses are camera-to-world matrices in the coordinates of the capture's files, with columns right, up, back
//! (OpenGL). A `transforms.json`, which may be the capture's own, has the axes of `data.axes` instead. The scene's
//! [`WorldToScene`] maps poses to the scene: `x_scene = scale * R x_file + t` for points, `R` only for directions. The
//! inverse is used for writing.
//!
//! A field of view, or focal lengths and principal point, are read from the file. Lens distortion is not.

mod lens;
mod write;

use std::path::Path;

use serde_json::{Map, Value};

use super::json::{self, Object};
use super::pose::{self, Pose};
use super::{Camera, LARGEST, WorldToScene};
use crate::settings::Axes;
use augnerf_base::{Error, Result};

pub use lens::MOST_PIXELS;
pub use write::{camera_path, write};

/// Largest number of cameras in a file: an hour at 25 per second.
const MOST_CAMERAS: usize = 90_000;
/// Keys of a camera in a `camera_path.json`. The last one follows from the size, and is not read.
pub const CAMERA_KEYS: [&str; 9] = [POSE, "fov", "fl_x", "fl_y", "cx", "cy", "w", "h", "aspect"];
/// The key of its pose.
const POSE: &str = "camera_to_world";

/// The cameras of a file, in scene units.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraFile {
    /// Its cameras, in their order.
    pub cameras: Vec<Camera>,
    /// Frames per second, if the file states them.
    pub fps: Option<f64>,
}

/// Reads a file of cameras for a scene. `like` is one of the scene's own cameras, and fills what the file leaves open.
/// Images of a `transforms.json` have its height. `axes` are those of the matrices in a `transforms.json`; a
/// `camera_path.json` has right, up, back.
///
/// # Errors
/// If the file is none of the two, or its poses or lenses are invalid.
pub fn read(file: &Path, like: &Camera, world: &WorldToScene, axes: Axes) -> Result<CameraFile> {
    check_ending(file)?;
    let mut read = read_json(file, like, axes)?;
    check_count(file, read.cameras.len())?;
    for camera in &mut read.cameras {
        camera.pose = world.camera(&camera.pose);
    }
    for (index, camera) in read.cameras.iter().enumerate() {
        check_position(camera, || format!("{}: camera {index} (counted from 0)", file.display()))?;
    }
    Ok(read)
}

/// Reads one camera for a scene from the text of a JSON object with [`CAMERA_KEYS`], as [`read`] reads each of a
/// `camera_path.json`. Returns also the object's other entries. `place` says in errors where the text is from.
///
/// # Errors
/// If the text is not such an object, or its pose or lens is invalid.
pub fn parse_camera(
    place: &str,
    text: &[u8],
    like: &Camera,
    world: &WorldToScene,
) -> Result<(Camera, Map<String, Value>)> {
    let place = Path::new(place);
    let value = json::parse(place, text)?;
    let object = Object::document(place, &value)?;
    let lens = lens::of_camera_path(object, object, like)?;
    let camera = Camera { pose: world.camera(&camera_to_world(object)?), ..lens };
    check_position(&camera, || format!("{}: the camera", place.display()))?;
    let entries = value.as_object().into_iter().flatten();
    let others = entries.filter(|(key, _)| !CAMERA_KEYS.contains(&key.as_str()));
    Ok((camera, others.map(|(key, value)| (key.clone(), value.clone())).collect()))
}

/// Returns an error for a camera that is beyond the limits of scenes. `subject` begins it.
fn check_position(camera: &Camera, subject: impl Fn() -> String) -> Result<()> {
    if camera.pose.iter().flatten().all(|value| value.abs() <= LARGEST) {
        return Ok(());
    }
    Err(Error::Data(format!(
        "{} is at {:?} in the scene's units: rendering computes with numbers from -{LARGEST:e} to {LARGEST:e}; check the \
         file's units",
        subject(),
        pose::column(&camera.pose, 3)
    )))
}

/// Returns an error for more cameras than the limit, for reading and for writing.
fn check_count(file: &Path, cameras: usize) -> Result<()> {
    if cameras <= MOST_CAMERAS {
        return Ok(());
    }
    Err(Error::Data(format!("{}: it has {cameras} cameras, but at most {MOST_CAMERAS} are rendered", file.display())))
}

/// Returns an error for a name that no file of cameras has, for reading and for writing.
fn check_ending(file: &Path) -> Result<()> {
    if file.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("json")) {
        return Ok(());
    }
    Err(Error::Config(format!(
        "{}: a file of cameras ends in .json (nerfstudio's camera_path.json, transforms.json)",
        file.display()
    )))
}

fn read_json(file: &Path, like: &Camera, axes: Axes) -> Result<CameraFile> {
    let value = json::read(file)?;
    let document = Object::document(file, &value)?;
    if document.get("camera_path").is_some() {
        return read_camera_path(document, like);
    }
    if document.get("frames").is_none() {
        return Err(document
            .error("it has neither \"camera_path\" (nerfstudio's camera_path.json) nor \"frames\" (transforms.json)"));
    }
    let camera = |frame: Object| {
        let lens = lens::of_transforms(frame, document, like)?;
        Ok(Camera { pose: frame.pose(axes)?.0, ..lens.with_height(like.height) })
    };
    Ok(CameraFile { cameras: document.objects("frames")?.into_iter().map(camera).collect::<Result<_>>()?, fps: None })
}

fn read_camera_path(document: Object, like: &Camera) -> Result<CameraFile> {
    match document.text("camera_type")? {
        None | Some("perspective") => {}
        Some(other) => {
            return Err(
                document.error(&format!("\"camera_type\" is \"{other}\", but only \"perspective\" is rendered"))
            );
        }
    }
    let fps = document.number("fps")?;
    if let Some(fps) = fps.filter(|fps| *fps <= 0.0) {
        return Err(document.error(&format!("\"fps\" is {fps}, but it must be positive")));
    }
    let camera = |object: Object| {
        let lens = lens::of_camera_path(object, document, like)?;
        Ok(Camera { pose: camera_to_world(object)?, ..lens })
    };
    let cameras = document.objects("camera_path")?.into_iter().map(camera).collect::<Result<_>>()?;
    Ok(CameraFile { cameras, fps })
}

/// Reads `camera_to_world`: 16 numbers, row by row, also as four rows.
fn camera_to_world(object: Object) -> Result<Pose> {
    let value = object.required(POSE)?;
    let wrong = || {
        object.error(&format!(
            "\"{POSE}\" must be the 16 numbers of a 4x4 matrix, row by row, each from -{LARGEST:e} to {LARGEST:e}"
        ))
    };
    let mut numbers = Vec::new();
    for value in value.as_array().ok_or_else(wrong)? {
        match value {
            Value::Array(row) => numbers.extend(row.iter().map(Value::as_f64)),
            number => numbers.push(number.as_f64()),
        }
    }
    let numbers: Option<Vec<f64>> = numbers.into_iter().map(|n| n.filter(|v| v.abs() <= LARGEST)).collect();
    let numbers = numbers.filter(|numbers| numbers.len() == 16).ok_or_else(wrong)?;
    let pose: Pose = std::array::from_fn(|row| std::array::from_fn(|column| numbers[4 * row + column]));
    pose::check_rotation(&pose).map_err(|what| {
        object.error(&format!("the left 3x3 part of \"{POSE}\" must be a rotation, but it has {what}"))
    })?;
    Ok(pose)
}

#[cfg(test)]
mod tests;
