//! The space of a scene: units, box and points.

use super::rig::Rig;
use super::{Camera, WorldToScene};

/// What is known of the space that a scene's views show.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneSpace {
    /// From the units of the capture's files to the scene's.
    pub world: WorldToScene,
    /// Lower and upper corner of the box that most cameras look at, in scene units. Surfaces are searched in it, and a
    /// hash grid fills it. `None` if the format states it, or nothing does.
    pub domain: Option<[[f64; 3]; 2]>,
    /// Points of the scene, if the capture has some (COLMAP), in scene units.
    pub points: Vec<[f32; 3]>,
    /// By name of a view, the numbers of the points that were triangulated in it (COLMAP).
    pub sightings: Vec<(String, Vec<u32>)>,
    /// The reader's choices and their reasons, for people: label and words.
    pub notes: Vec<(&'static str, String)>,
}

impl SceneSpace {
    /// Returns the space, with ray ends and box from the cameras' geometry. `unknown` are the ray ends if the geometry
    /// does not tell them.
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
