//! `scene.json`: the scene as a run saw it, for whoever puts its results beside the capture.

use std::path::Path;

use serde::Serialize;

use crate::base::Result;
use crate::base::files::write_json;
use crate::data::{Scene, WorldToScene};

/// From the capture's units to the scene's, as files tell it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WorldMatrix {
    /// Scene units to one unit of the capture.
    pub scale: f64,
    /// `[scale R | t]`, rows: a point of the capture, with 1 as its fourth number, becomes one of the scene.
    pub matrix: [[f64; 4]; 3],
}

impl WorldMatrix {
    /// Of a scene's way from its capture.
    pub fn of(world: &WorldToScene) -> WorldMatrix {
        WorldMatrix { scale: world.scale, matrix: world.matrix() }
    }
}

/// What `scene.json` holds.
#[derive(Serialize)]
struct SceneFile<'a> {
    scene: &'a str,
    kind: &'a str,
    world_to_scene: WorldMatrix,
    /// Ends of a ray, in the units of `t_vals`.
    near: f64,
    far: f64,
    ndc: bool,
    /// What most cameras look at, scene units; `null` where nothing tells it.
    #[serde(rename = "box")]
    domain: Option<[[f64; 3]; 2]>,
    /// What the reader chose, and why.
    notes: serde_json::Map<String, serde_json::Value>,
}

/// Writes `scene.json`.
pub(super) fn write(path: &Path, scene: &Scene) -> Result<()> {
    let Scene { name, kind, near, far, ndc, place, .. } = scene;
    // Where the folders lie is no part of what a run leaves.
    let told = place.notes.iter().filter(|(label, _)| !["images", "passed over"].contains(label));
    let notes = told.map(|(label, words)| (label.to_string(), words.clone().into())).collect();
    write_json(
        path,
        &SceneFile {
            scene: name,
            kind,
            world_to_scene: WorldMatrix::of(&place.world),
            near: *near,
            far: *far,
            ndc: ndc.is_some(),
            domain: place.domain,
            notes,
        },
    )
}
