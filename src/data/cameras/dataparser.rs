//! nerfstudio's own units.

use std::path::Path;

use super::super::json::{self, Object};
use super::super::pose::{self, Pose};
use super::super::{SMALLEST, WorldToScene, brief};
use crate::base::Result;

/// What nerfstudio did to a capture's poses, from the `dataparser_transforms.json` beside its checkpoints:
/// `x_nerfstudio = scale * transform * x`, where `x` is in the units before the capture's `applied_transform`.
#[derive(Clone, Debug, PartialEq)]
pub struct Dataparser {
    to_nerfstudio: WorldToScene,
    /// From there to the capture's units.
    applied: Pose,
}

const IDENTITY: Pose = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];

impl Dataparser {
    /// Reads the file; `transforms` is the capture's `transforms.json`, which may state an `applied_transform`.
    ///
    /// # Errors
    /// A file that is not such a one.
    pub fn read(file: &Path, transforms: &Path) -> Result<Dataparser> {
        let value = json::read(file)?;
        let document = Object::document(file, &value)?;
        let transform = document.pose_at("transform")?;
        let scale = match document.number("scale")? {
            Some(scale) if scale >= SMALLEST => scale,
            Some(scale) => {
                let found = brief(scale);
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
            if capture.get("applied_transform").is_some() {
                applied = capture.pose_at("applied_transform")?;
            }
        }
        let rotation_and_origin = transform.map(|[a, b, c, t]| [a, b, c, t * scale]);
        Ok(Dataparser { to_nerfstudio: WorldToScene { scale, rotation_and_origin }, applied })
    }

    /// A camera of nerfstudio in the capture's units.
    pub fn to_capture(&self, camera: &Pose) -> Pose {
        let before = super::write::to_capture(&self.to_nerfstudio, camera);
        pose::compose(&self.applied, &before)
    }
}
