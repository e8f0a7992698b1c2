//! `scene.json`: the scene as a run saw it, for whoever puts its results beside the capture, and for the run itself: its weights
//! are of these coordinates and these views.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::base::files::{read_json, write_json};
use crate::base::{Error, Result};
use crate::data::formats::transforms::BOUNDS;
use crate::data::{Scene, View, WorldToScene};
use crate::settings::{DataConfig, DataKind};
use crate::train::checkpoint;

use super::RunDir;

/// By how much numbers may differ, relative to the larger of 1 and their size, that two machines compute of the same files.
const ROUNDING: f64 = 1e-6;
/// So many names of views stand in an error.
const NAMES: usize = 8;

/// From the capture's units to the scene's, as files tell it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
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
#[derive(Serialize, Deserialize)]
struct SceneFile {
    scene: String,
    kind: String,
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
    /// Names of the views that are trained on and evaluated; files of runs that were begun before have none.
    #[serde(default)]
    views: Option<Views>,
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
    // Where the folders lie is no part of what a run leaves.
    let told = space.notes.iter().filter(|(label, _)| !["images", "passed over"].contains(label));
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
            domain: space.domain,
            notes,
            views: Some(Views { trained: names(&scene.train), evaluated: names(&scene.test) }),
        },
    )
}

fn names(views: &[View]) -> Vec<String> {
    views.iter().map(|view| view.name.clone()).collect()
}

/// Whether rays have the ends that they all had in captures with a `transforms.json` before those came from what cameras look at.
pub(super) fn is_early((near, far): (f64, f64)) -> bool {
    [near, far] == BOUNDS
}

/// The scene as a run saw it when it began.
pub(super) struct RecordedScene {
    file: PathBuf,
    recorded: Option<SceneFile>,
    /// The run was trained by a version that left no such file. One that a kill left without it has no checkpoint either.
    early: bool,
}

impl RecordedScene {
    /// That of a run.
    pub(super) fn of(run: &RunDir) -> Result<RecordedScene> {
        let file = run.scene_file();
        let recorded = read_json(&file, "bring back a copy, or delete it to take the scene as it is now")?;
        let early = recorded.is_none() && !checkpoint::list(&run.checkpoints())?.is_empty();
        Ok(RecordedScene { file, recorded, early })
    }

    /// The ends of its rays; none where the scene's files say them now as then.
    pub(super) fn bounds(&self, data: &DataConfig) -> Option<(f64, f64)> {
        match &self.recorded {
            Some(recorded) => Some((recorded.near, recorded.far)),
            None => (self.early && data.kind == DataKind::Transforms).then_some(BOUNDS.into()),
        }
    }

    /// Gives the scene's rays the ends that they had, where the settings name none and others were found now.
    pub(super) fn restore_bounds(&self, scene: &mut Scene, data: &DataConfig) {
        let Some((near, far)) = self.bounds(data) else { return };
        // Of numbers that only a file's digits differ in, those that were found are what the run computes with.
        if data.near.is_none() && !is_close(near, scene.near) {
            scene.near = near;
        }
        if data.far.is_none() && !is_close(far, scene.far) {
            scene.far = far;
        }
    }

    /// Refuses a scene of other coordinates or other views; those that are `evaluated` may be others on demand.
    pub(super) fn check(&self, scene: &Scene, data: &DataConfig, evaluated: bool) -> Result<()> {
        let from = if data.dir.is_empty() { &scene.name } else { &data.dir };
        let refuse = |what: String| {
            Err(Error::Data(format!(
                "{from}: the scene is not the one that the run was begun with ({}): {what}; bring back its files as they were, name \
                 their folder with --data, or train anew",
                self.file.display()
            )))
        };
        if let Some((near, far)) = self.bounds(data) {
            let (near, far) = (data.near.unwrap_or(near), data.far.unwrap_or(far));
            if !(is_close(near, scene.near) && is_close(far, scene.far)) {
                let (now_near, now_far) = scene.bounds();
                return refuse(format!("rays went from {near} to {far}, and go from {now_near} to {now_far}"));
            }
        }
        let Some(recorded) = &self.recorded else { return Ok(()) };
        let (then, now) = (recorded.world_to_scene, WorldMatrix::of(&scene.space.world));
        let (a, b) = (then.matrix.as_flattened(), now.matrix.as_flattened());
        if recorded.ndc != scene.ndc.is_some() || !a.iter().zip(b).all(|(a, b)| is_close(*a, *b)) {
            let what = "its poses lead to other coordinates than those of the weights (world_to_scene, ndc)";
            return refuse(what.into());
        }
        let Some(views) = &recorded.views else { return Ok(()) };
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

/// How two lists of names differ, in words.
fn difference(then: &[String], now: &[String]) -> Option<String> {
    let without = |all: &[String], others: &[String], what: &str| {
        let lack: Vec<&str> = all.iter().filter(|name| !others.contains(name)).map(String::as_str).collect();
        let more = if lack.len() > NAMES { ", ..." } else { "" };
        (!lack.is_empty())
            .then(|| format!("{} {what} ({}{more})", lack.len(), lack[..lack.len().min(NAMES)].join(", ")))
    };
    let parts = [without(then, now, "are gone"), without(now, then, "are new")];
    let words = parts.into_iter().flatten().collect::<Vec<String>>().join(" and ");
    match (words.is_empty(), then == now) {
        (false, _) => Some(words),
        (true, false) => Some("the order is another".into()),
        (true, true) => None,
    }
}
