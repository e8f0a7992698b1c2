//! What formats without splits have in common: posed views of which every N-th is held out.

use crate::base::Image;
use crate::data::views::split;
use crate::data::{Camera, Ndc, Scene, SceneSpace, View};
use crate::settings::DataConfig;

/// Posed photographs in their order, before any is held out.
pub struct Capture {
    /// The views at the working resolution, poses final.
    pub views: Vec<View>,
    /// Cameras of the video path.
    pub path: Vec<Camera>,
    /// Start of a ray's interval, in the units of `t_vals` (0 under NDC).
    pub near: f64,
    /// Its end (1 under NDC).
    pub far: f64,
    /// Set when rays are mapped to normalised device coordinates.
    pub ndc: Option<Ndc>,
    /// What see-through pixels were put on; none for opaque photographs.
    pub background: Option<[f32; 3]>,
    /// Where it lies: units, box, points.
    pub space: SceneSpace,
}

impl Capture {
    /// Views without reference depth from names, cameras and images of one order.
    pub fn views(names: Vec<String>, cameras: Vec<Camera>, images: Vec<Image>) -> Vec<View> {
        let view = |((name, camera), image): ((String, Camera), Image)| View {
            name,
            camera,
            image: image.into(),
            depth: None,
            mask: None,
        };
        names.into_iter().zip(cameras).zip(images).map(view).collect()
    }

    /// The scene: every `config.holdout`-th view is held out, starting with that of `config.holdout_offset`, the middle one
    /// of every `config.validation` others is kept for choices, and of those that are evaluated every `config.test_skip`-th
    /// stays. `kind` is the format's name in files and tables.
    pub fn hold_out(self, name: String, kind: &'static str, config: &DataConfig) -> Scene {
        let there = vec![true; self.views.len()];
        self.hold_out_listed(name, kind, config, &there)
    }

    /// The same of a list of photographs, `there` of which have a view: what each is for hangs on the whole list, so that one that
    /// is gone makes no other change sides.
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

    /// The scene whose split is given: views at the places of `train`, and every `config.test_skip`-th of those at the places of
    /// `test`, in a list as above.
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

    /// The views in their places of a list.
    fn places(&mut self, there: &[bool]) -> Vec<Option<View>> {
        let mut views = std::mem::take(&mut self.views).into_iter();
        there.iter().map(|there| there.then(|| views.next().expect("a view for each that is there"))).collect()
    }

    fn into_scene(self, name: String, kind: &'static str, train: Vec<View>, test: Vec<View>) -> Scene {
        let Capture { path, near, far, ndc, background, space, .. } = self;
        Scene { name, kind, train, test, near, far, ndc, background, path, corrupted: None, space }
    }
}
