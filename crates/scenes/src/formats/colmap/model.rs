//! The content of a COLMAP model, for both ways of writing.

use std::collections::HashMap;

use crate::formats::transforms::distortion::{Distortion, Intrinsics};
use crate::pose::{self, Pose, Vec3};
use crate::{LARGEST, SMALLEST};
use augnerf_base::number_text;

/// Longest name of an image.
pub(super) const MOST_NAME: usize = 1024;
/// How far a quaternion's length may be from 1, since files print few digits.
const LENGTH_TOLERANCE: f64 = 1e-2;

/// COLMAP's camera models: number, name, parameters. The first [`READ`] are supported; later ones bend rays as no
/// pinhole camera does.
const MODELS: [(i32, &str, usize); 12] = [
    (0, "SIMPLE_PINHOLE", 3),
    (1, "PINHOLE", 4),
    (2, "SIMPLE_RADIAL", 4),
    (3, "RADIAL", 5),
    (4, "OPENCV", 8),
    (6, "FULL_OPENCV", 12),
    (5, "OPENCV_FISHEYE", 8),
    (7, "FOV", 5),
    (8, "SIMPLE_RADIAL_FISHEYE", 4),
    (9, "RADIAL_FISHEYE", 5),
    (10, "THIN_PRISM_FISHEYE", 12),
    (11, "RAD_TAN_THIN_PRISM_FISHEYE", 16),
];
/// Number of models that are pinholes with or without OpenCV's distortion.
const READ: usize = 6;

/// A camera of photos.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Lens {
    pub(super) model: &'static str,
    /// Columns and rows of its photos.
    pub(super) size: [f64; 2],
    pub(super) intrinsics: Intrinsics,
    pub(super) distortion: Distortion,
}

/// A photo whose pose was found.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Photograph {
    pub(super) id: u32,
    pub(super) camera: u32,
    /// Its file below the folder of images.
    pub(super) name: String,
    /// Camera to world, OpenGL axes.
    pub(super) pose: Pose,
}

/// A triangulated point.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Point {
    pub(super) place: Vec3,
    /// Photos in which it is seen.
    pub(super) seen_in: Vec<u32>,
}

/// Cameras, photos (sorted by name) and points.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Model {
    /// The folder below the scene's.
    pub(super) folder: String,
    pub(super) lenses: HashMap<u32, Lens>,
    pub(super) photographs: Vec<Photograph>,
    pub(super) points: Vec<Point>,
}

impl Model {
    /// Returns the numbers of the points that each photo sees, by photo.
    pub(super) fn sightings(&self) -> Vec<Vec<u32>> {
        let places: HashMap<u32, usize> =
            self.photographs.iter().enumerate().map(|(place, photograph)| (photograph.id, place)).collect();
        let mut seen = vec![Vec::new(); self.photographs.len()];
        for (number, point) in self.points.iter().enumerate() {
            for place in point.seen_in.iter().filter_map(|id| places.get(id)) {
                seen[*place].push(number as u32);
            }
        }
        seen
    }

    /// Returns the depths of the points that each photo sees, sorted, by photo.
    pub(super) fn depths(&self) -> Vec<Vec<f64>> {
        let of_photograph = |(photograph, seen): (&Photograph, Vec<u32>)| {
            let pose = &photograph.pose;
            let depth =
                |point: &Point| -pose::dot(pose::sub(point.place, pose::column(pose, 3)), pose::column(pose, 2));
            let mut depths: Vec<f64> = seen.iter().map(|number| depth(&self.points[*number as usize])).collect();
            depths.sort_by(f64::total_cmp);
            depths
        };
        self.photographs.iter().zip(self.sightings()).map(of_photograph).collect()
    }
}

/// Returns name and number of parameters of a model, by its name.
pub(super) fn model_of_name(name: &str) -> std::result::Result<(&'static str, usize), String> {
    let known = MODELS.iter().find(|(_, known, _)| *known == name);
    known.map(|&(_, name, parameters)| (name, parameters)).ok_or_else(|| unknown(name))
}

/// Returns name and number of parameters of a model, by its number.
pub(super) fn model_of_number(number: i32) -> std::result::Result<(&'static str, usize), String> {
    let known = MODELS.iter().find(|(known, ..)| *known == number);
    known.map(|&(_, name, parameters)| (name, parameters)).ok_or_else(|| unknown(&format!("number {number}")))
}

fn unknown(model: &str) -> String {
    let read: Vec<&str> = MODELS[..READ].iter().map(|(_, name, _)| *name).collect();
    format!(
        "its camera model is {model}, but only {} are read; undistort the images first with COLMAP's image_undistorter",
        read.join(", ")
    )
}

/// Returns the lens from a camera's model, size and parameters, as many as the model has, or what is wrong with them.
pub(super) fn lens(model: &'static str, size: [f64; 2], values: &[f64]) -> std::result::Result<Lens, String> {
    if MODELS[READ..].iter().any(|(_, name, _)| *name == model) {
        return Err(unknown(model));
    }
    if let Some(value) = values.iter().find(|value| value.is_nan() || value.abs() > LARGEST) {
        return Err(format!(
            "it has the parameter {}: every number must be finite, of at most {LARGEST:e}",
            number_text(*value)
        ));
    }
    let at = |i: usize| values.get(i).copied().unwrap_or(0.0);
    let one_focal = matches!(model, "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL");
    let first = if one_focal { 1 } else { 2 };
    let focal = if one_focal { [at(0); 2] } else { [at(0), at(1)] };
    let further = |i: usize| at(first + 2 + i);
    let radial_only = Distortion { radial: [further(0), further(1), 0.0], ..Distortion::default() };
    let distortion = match model {
        "SIMPLE_RADIAL" | "RADIAL" => radial_only,
        "OPENCV" => Distortion { tangential: [further(2), further(3)], ..radial_only },
        "FULL_OPENCV" => Distortion {
            radial: [further(0), further(1), further(4)],
            tangential: [further(2), further(3)],
            rational: [further(5), further(6), further(7)],
        },
        _ => Distortion::default(),
    };
    if focal.iter().chain(&size).any(|value| *value < SMALLEST) {
        return Err(format!("it has {size:?} pixels and the focal lengths {focal:?}: all must be positive"));
    }
    Ok(Lens { model, size, intrinsics: Intrinsics { focal, centre: [at(first), at(first + 1)] }, distortion })
}

/// Returns the camera-to-world pose in OpenGL axes, or what is wrong with it. The rotation (a quaternion w, x, y, z)
/// and the shift lead from the world to COLMAP's camera (x right, y down, z forward).
pub(super) fn pose(quaternion: [f64; 4], shift: Vec3) -> std::result::Result<Pose, String> {
    let length = quaternion.iter().map(|v| v * v).sum::<f64>().sqrt();
    if shift.iter().any(|v| v.is_nan() || v.abs() > LARGEST) || (length - 1.0).abs().is_nan() {
        return Err(format!(
            "its pose is {quaternion:?} and {shift:?}: every number must be finite, of at most {LARGEST:e}"
        ));
    }
    if (length - 1.0).abs() > LENGTH_TOLERANCE {
        return Err(format!("its quaternion has length {}, and that of a rotation is 1", number_text(length)));
    }
    let [w, x, y, z] = quaternion.map(|v| v / length);
    // Rows: the camera's right, down and forward axes in the world.
    let right = [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)];
    let down = [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)];
    let forward = [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)];
    let origin =
        std::array::from_fn(|axis| -(right[axis] * shift[0] + down[axis] * shift[1] + forward[axis] * shift[2]));
    Ok(pose::from_columns([right, down.map(|v| -v), forward.map(|v| -v), origin]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_leads_from_the_camera_to_the_world() {
        let quaternion = [0.5f64, -0.1, 0.7, 0.2];
        let length = quaternion.iter().map(|v| v * v).sum::<f64>().sqrt();
        let shift = [0.3, -1.0, 2.0];
        let found = pose(quaternion.map(|v| v / length), shift).unwrap();
        assert_eq!(pose::check_rotation(&found), Ok(()));
        // The camera's own place is the world's origin where the shift is 0.
        let origin = pose::column(&found, 3);
        // R origin + shift = 0, the rows of R being right, down, forward.
        let rows = [pose::column(&found, 0), pose::column(&found, 1).map(|v| -v), pose::column(&found, 2).map(|v| -v)];
        for (row, shift) in rows.iter().zip(shift) {
            assert!((pose::dot(*row, origin) + shift).abs() < 1e-12);
        }
        assert!(pose([0.0; 4], shift).unwrap_err().contains("length 0"));
        assert!(pose([f64::NAN, 0.0, 0.0, 1.0], shift).unwrap_err().contains("finite"));
    }

    #[test]
    fn parameters_are_those_of_colmap_s_models() {
        let read = |model, values: &[f64]| lens(model, [8.0, 6.0], values).unwrap();
        let opencv = read("OPENCV", &[7.0, 7.5, 4.0, 3.0, 0.1, 0.2, 0.3, 0.4]);
        assert_eq!((opencv.intrinsics.focal, opencv.intrinsics.centre), ([7.0, 7.5], [4.0, 3.0]));
        assert_eq!((opencv.distortion.radial, opencv.distortion.tangential), ([0.1, 0.2, 0.0], [0.3, 0.4]));
        let radial = read("SIMPLE_RADIAL", &[7.0, 4.0, 3.0, 0.1]);
        assert_eq!((radial.intrinsics.focal, radial.distortion.radial), ([7.0; 2], [0.1, 0.0, 0.0]));
        let full = read("FULL_OPENCV", &[7.0, 7.0, 4.0, 3.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]).distortion;
        assert_eq!((full.radial, full.tangential, full.rational), ([0.1, 0.2, 0.5], [0.3, 0.4], [0.6, 0.7, 0.8]));
        assert!(read("SIMPLE_PINHOLE", &[7.0, 4.0, 3.0]).distortion.is_none());
        let refused = |model, values: &[f64]| lens(model, [8.0, 6.0], values).unwrap_err();
        assert!(refused("OPENCV_FISHEYE", &[1.0; 8]).contains("image_undistorter"));
        assert!(refused("PINHOLE", &[0.0, 1.0, 4.0, 3.0]).contains("positive"));
        assert!(model_of_number(99).unwrap_err().contains("number 99"));
    }
}
