//! Where a scene lies, besides its views.

use super::rig::Rig;
use super::{Camera, WorldToScene};

/// What is known of the space that a scene's views show.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneSpace {
    /// From the units of the capture's files to the scene's.
    pub world: WorldToScene,
    /// Lower and upper corner of the box that most cameras look at, scene units: where a surface is looked for, and what a hash
    /// grid fills. None where the format says it, or nothing does.
    pub domain: Option<[[f64; 3]; 2]>,
    /// Points of the scene, where the capture has some (COLMAP), scene units.
    pub points: Vec<[f32; 3]>,
    /// What the reader chose, and why, for people: label and words.
    pub notes: Vec<(&'static str, String)>,
}

impl SceneSpace {
    /// A place whose ray ends and box are those that the cameras' geometry tells; `unknown` where it tells none.
    pub(super) fn of_cameras(cameras: &[Camera], world: WorldToScene, unknown: [f64; 2]) -> (SceneSpace, (f64, f64)) {
        let mut space = SceneSpace { world, ..SceneSpace::default() };
        let Some(subject) = Rig::of(cameras).subject else {
            let [near, far] = unknown;
            let words = "cameras look at no common point: usual bounds, no box; set data.near and data.far";
            space.note("bounds from", words.into());
            return (space, (near, far));
        };
        space.domain = Some(subject.domain());
        space.note("bounds from", subject.bounds_words());
        (space, subject.bounds())
    }

    /// Adds a line for people.
    pub(super) fn note(&mut self, label: &'static str, words: String) {
        self.notes.push((label, words));
    }
}
