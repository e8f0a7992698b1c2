//! What formats without splits have in common: posed views of which every N-th is held out.

use crate::settings::DataConfig;
use crate::views::split;
use crate::{Camera, Ndc, Scene, SceneSpace, View};

/// Posed photos in their order, before any is held out.
pub struct Capture {
    /// The views at the working resolution, poses final.
    pub views: Vec<View>,
    /// Cameras of the video path.
    pub path: Vec<Camera>,
    /// Start of a ray's interval, in the units of `t_vals` (0 under NDC).
    pub near: f64,
    /// End of a ray's interval (1 under NDC).
    pub far: f64,
    /// Set if rays are mapped to normalized device coordinates.
    pub ndc: Option<Ndc>,
    /// The colour behind transparent pixels; `None` for opaque photos.
    pub background: Option<[f32; 3]>,
    /// The scene's space: units, box, points.
    pub space: SceneSpace,
}

impl Capture {
    /// Returns the scene. Every `config.holdout`-th view is held out, starting with that of `config.holdout_offset`.
    /// The middle one of every `config.validation` others becomes a validation view. Of the evaluated views every
    /// `config.test_skip`-th is kept. `kind` is the format's name in files and tables.
    pub fn hold_out(self, name: String, kind: &'static str, config: &DataConfig) -> Scene {
        let there = vec![true; self.views.len()];
        self.hold_out_listed(name, kind, config, &there)
    }

    /// The same for a list of photos, `there` of which have a view. The roles depend on the complete list, so that a
    /// missing photo does not change the role of others.
    pub(super) fn hold_out_listed(
        mut self,
        name: String,
        kind: &'static str,
        config: &DataConfig,
        there: &[bool],
    ) -> Scene {
        let (train, test) = split(self.places(there), config);
        self.into_scene(name, kind, train.into_iter().flatten().collect(), test.into_iter().flatten().collect())
    }

    /// Returns the scene with a given split: views at the indices of `train`, and every `config.test_skip`-th of those
    /// at the indices of `test`, in a list as above.
    pub(super) fn split_as(
        mut self,
        name: String,
        kind: &'static str,
        config: &DataConfig,
        there: &[bool],
        [train, test]: [&[bool]; 2],
    ) -> Scene {
        let views = self.places(there);
        let of = |chosen: &[bool], step: usize| {
            let chosen = views.iter().zip(chosen).filter(|(_, chosen)| **chosen);
            chosen.step_by(step).filter_map(|(view, _)| view.clone()).collect()
        };
        let (train, test) = (of(train, 1), of(test, config.test_skip.max(1)));
        self.into_scene(name, kind, train, test)
    }

    /// Returns the views at their indices of a list.
    fn places(&mut self, there: &[bool]) -> Vec<Option<View>> {
        let mut views = std::mem::take(&mut self.views).into_iter();
        there.iter().map(|there| there.then(|| views.next().expect("a view for each that is there"))).collect()
    }

    fn into_scene(self, name: String, kind: &'static str, train: Vec<View>, test: Vec<View>) -> Scene {
        let Capture { path, near, far, ndc, background, space, .. } = self;
        Scene { name, kind, train, test, near, far, ndc, background, path, corrupted: None, lacks_split: false, space }
    }
}
