//! `scene.json`: the scene as the run loaded it. Users need it to match results with the capture. The run needs it
//! because its weights depend on these coordinates and views.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::base::files::{read_json, write_json};
use crate::base::{Error, Result, first_names};
use crate::data::{Scene, View, WorldToScene};
use crate::revision::revision;
use crate::settings::DataConfig;
use crate::train::checkpoint;

use super::{RunDir, protocol};

/// Tolerance for numbers that two machines compute from the same files, relative to the larger of 1 and their size.
const ROUNDING: f64 = 1e-6;
/// Most names of views in an error.
const NAMES: usize = 8;

/// The map from the capture's units to the scene's, as files write it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct WorldMatrix {
    /// Scene units in one unit of the capture.
    pub scale: f64,
    /// `[scale R | t]`, rows: maps a point of the capture, with 1 as its fourth number, to the scene.
    pub matrix: [[f64; 4]; 3],
}

impl WorldMatrix {
    /// Returns the matrix of a scene's map from its capture.
    pub fn of(world: &WorldToScene) -> WorldMatrix {
        WorldMatrix { scale: world.scale, matrix: world.matrix() }
    }

    /// Returns whether both are one map, except for the rounding of machines.
    pub(super) fn is_close(&self, other: &WorldMatrix) -> bool {
        let (a, b) = (self.matrix.as_flattened(), other.matrix.as_flattened());
        // Of captures in small units, all of a rotation's numbers are below the tolerance.
        is_close(self.scale / other.scale, 1.0) && a.iter().zip(b).all(|(a, b)| is_close(*a, *b))
    }
}

/// Content of `scene.json`.
#[derive(Serialize, Deserialize)]
struct SceneFile {
    scene: String,
    kind: String,
    world_to_scene: WorldMatrix,
    /// Ends of a ray, in the units of `t_vals`.
    near: f64,
    far: f64,
    ndc: bool,
    /// The colour behind transparent pixels, as the protocol names it.
    background: String,
    /// The box that most cameras look at, scene units; `null` if unknown.
    #[serde(rename = "box")]
    domain: Option<[[f64; 3]; 2]>,
    /// Choices of the reader, with reasons.
    notes: serde_json::Map<String, serde_json::Value>,
    views: Views,
}

/// Names of views.
#[derive(Serialize, Deserialize)]
struct Views {
    trained: Vec<String>,
    evaluated: Vec<String>,
}

/// Writes `scene.json`.
pub(super) fn write(path: &Path, scene: &Scene) -> Result<()> {
    let Scene { name, kind, near, far, ndc, space, .. } = scene;
    // Paths of folders do not belong in a run's files.
    let told = space.notes.iter().filter(|(label, _)| !["images", "orbit", "passed over"].contains(label));
    let notes = told.map(|(label, words)| (label.to_string(), words.clone().into())).collect();
    write_json(
        path,
        &SceneFile {
            scene: name.clone(),
            kind: kind.to_string(),
            world_to_scene: WorldMatrix::of(&space.world),
            near: *near,
            far: *far,
            ndc: ndc.is_some(),
            background: protocol::background(scene).into(),
            domain: space.domain,
            notes,
            views: Views { trained: names(&scene.train), evaluated: names(&scene.test) },
        },
    )
}

fn names(views: &[View]) -> Vec<String> {
    views.iter().map(|view| view.name.clone()).collect()
}

/// The scene as a run loaded it when it started.
pub(super) struct RecordedScene {
    file: PathBuf,
    recorded: Option<SceneFile>,
    /// The revision that the run started with, if it is not this one.
    other_revision: Option<String>,
}

impl RecordedScene {
    /// Reads the scene of a run.
    pub(super) fn of(run: &RunDir) -> Result<RecordedScene> {
        let file = run.scene_file();
        let recorded = read_json(&file, "restore a copy, or delete it to accept the scene as it is now")?;
        let newest = checkpoint::list(&run.checkpoints())?.pop();
        // A damaged checkpoint is an error where it is used.
        let state = newest.and_then(|(_, folder)| checkpoint::load_state(&folder).ok());
        let first = state.and_then(|state| state.revisions.into_iter().next());
        Ok(RecordedScene { file, recorded, other_revision: first.filter(|first| first != revision()) })
    }

    /// Returns an error for a scene with other coordinates, background or views. With `evaluated` false, other views may be
    /// evaluated.
    pub(super) fn check(&self, scene: &Scene, data: &DataConfig, evaluated: bool) -> Result<()> {
        let from = if data.dir.is_empty() { &scene.name } else { &data.dir };
        let refuse = |what: String| {
            let advice = match &self.other_revision {
                None => "restore its files, name their folder with --data, or train again".into(),
                Some(revision) => format!(
                    "revision {revision}, which trained the run, may have read the same files otherwise: if they are as they were, \
                     use the run with that revision or train again; else restore them, or name their folder with --data"
                ),
            };
            Err(Error::Data(format!(
                "{from}: the scene differs from the one that the run started with ({}): {what}; {advice}",
                self.file.display()
            )))
        };
        // There is none before the first checkpoint, or where somebody deleted it to accept the scene as it is.
        let Some(recorded) = &self.recorded else { return Ok(()) };
        let (near, far) = (data.near.unwrap_or(recorded.near), data.far.unwrap_or(recorded.far));
        if !(is_close(near, scene.near) && is_close(far, scene.far)) {
            let (now_near, now_far) = scene.bounds();
            return refuse(format!("rays went from {near} to {far}, but now go from {now_near} to {now_far}"));
        }
        let now = WorldMatrix::of(&scene.space.world);
        if recorded.ndc != scene.ndc.is_some() || !recorded.world_to_scene.is_close(&now) {
            let what = "its poses give other coordinates than the weights have (world_to_scene, ndc)";
            return refuse(what.into());
        }
        // It is there if any pixel is transparent, and rays then end on it.
        let background = protocol::background(scene);
        if recorded.background != background {
            let (then, now) = (&recorded.background, "by the transparent pixels of its images");
            return refuse(format!("its background was {then}, but now is {background}, {now}"));
        }
        let views = &recorded.views;
        let lists = [("trained on", &views.trained, &scene.train), ("evaluated", &views.evaluated, &scene.test)];
        for (what, then, now) in lists.into_iter().take(if evaluated { 2 } else { 1 }) {
            if let Some(difference) = difference(then, &names(now)) {
                return refuse(format!("of the views that are {what}, {difference}"));
            }
        }
        Ok(())
    }
}

fn is_close(a: f64, b: f64) -> bool {
    (a - b).abs() <= ROUNDING * a.abs().max(b.abs()).max(1.0)
}

/// Returns in words how two lists of names differ.
fn difference(then: &[String], now: &[String]) -> Option<String> {
    let without = |all: &[String], others: &[String], what: &str| {
        let lack: Vec<&str> = all.iter().filter(|name| !others.contains(name)).map(String::as_str).collect();
        (!lack.is_empty()).then(|| format!("{} {what} ({})", lack.len(), first_names(&lack, NAMES)))
    };
    let parts = [without(then, now, "are gone"), without(now, then, "are new")];
    let words = parts.into_iter().flatten().collect::<Vec<String>>().join(" and ");
    match (words.is_empty(), then == now) {
        (false, _) => Some(words),
        (true, false) => Some("the order differs".into()),
        (true, true) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Captures in small units have small matrices.
    #[test]
    fn coordinates_are_told_apart_by_their_scale() {
        let world = |scale: f64| WorldMatrix::of(&WorldToScene::default().scaled(scale));
        assert!(world(1e-9).is_close(&world(1e-9 * (1.0 + 1e-9))) && !world(1e-9).is_close(&world(2e-9)));
    }
}
