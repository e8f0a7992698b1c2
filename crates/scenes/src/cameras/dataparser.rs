//! nerfstudio's own units.

use std::path::Path;

use super::super::json::{self, Object};
use super::super::pose::{self, Pose};
use super::super::{SMALLEST, WorldToScene};
use augnerf_base::{Result, number_text};

/// nerfstudio's transform of a capture's poses, from the `dataparser_transforms.json` next to its checkpoints:
/// `x_nerfstudio = scale * transform * x`, where `x` is in the units before the capture's `applied_transform`.
#[derive(Clone, Debug, PartialEq)]
pub struct Dataparser {
    to_nerfstudio: WorldToScene,
    /// From there to the capture's units.
    applied: Pose,
}

/// The `applied_transform` that nerfstudio assumes for a folder with a COLMAP model that states none (its
/// nerfstudio_dataparser.py).
const OF_COLMAP: Pose = [[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0]];
const IDENTITY: Pose = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];

impl Dataparser {
    /// Reads the file. `transforms` is the capture's `transforms.json`, which may state an `applied_transform`.
    ///
    /// # Errors
    /// If the file is of another kind, or the capture has an `applied_scale`.
    pub fn read(file: &Path, transforms: &Path) -> Result<Dataparser> {
        let value = json::read(file)?;
        let document = Object::document(file, &value)?;
        let transform = document.pose_at("transform")?;
        let scale = match document.number("scale")? {
            Some(scale) if scale >= SMALLEST => scale,
            Some(scale) => {
                let found = number_text(scale);
                return Err(
                    document.error(&format!("\"scale\" is {found}, but it must be positive, at least {SMALLEST:e}"))
                );
            }
            None => return Err(document.error("the key \"scale\" is missing")),
        };
        let mut applied = IDENTITY;
        if transforms.is_file() {
            let value = json::read(transforms)?;
            let capture = Object::document(transforms, &value)?;
            if capture.number("applied_scale")?.is_some_and(|scale| scale != 1.0) {
                return Err(capture
                    .error("\"applied_scale\" is not 1, which is not supported for cameras in nerfstudio's units"));
            }
            if capture.get("applied_transform").is_some() {
                applied = capture.pose_at("applied_transform")?;
            } else if transforms.parent().is_some_and(|folder| folder.join("colmap/sparse/0").exists()) {
                applied = OF_COLMAP;
            }
        }
        let rotation_and_origin = transform.map(|[a, b, c, t]| [a, b, c, t * scale]);
        Ok(Dataparser { to_nerfstudio: WorldToScene { scale, rotation_and_origin }, applied })
    }

    /// Maps a camera of nerfstudio to the capture's units.
    pub fn to_capture(&self, camera: &Pose) -> Pose {
        let before = super::write::to_capture(&self.to_nerfstudio, camera);
        pose::compose(&self.applied, &before)
    }
}
