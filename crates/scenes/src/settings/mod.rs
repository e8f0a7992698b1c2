//! Section `data`: the scene and how it is read.

use serde::{Deserialize, Serialize};

use super::formats::{FORMATS, Format};
use super::may_have_box;
use augnerf_base as base;
use augnerf_base::settings::IdleKind::{Dropped, Noted};
use augnerf_base::settings::name_of;
use augnerf_base::settings::{IdleSettings, refuse, require};
use augnerf_base::settings::{numbers, path, section};

mod corruption;

pub use corruption::{CorruptionConfig, CorruptionKind};

/// The reader of a scene folder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DataKind {
    /// Chosen by the files found: `poses_bounds.npy`, `transforms_train.json`, `transforms.json`, `sparse/0`.
    #[default]
    Auto,
    /// `poses_bounds.npy` with `images_{factor}` or `images`.
    Llff,
    /// `transforms_{train,val,test}.json` with RGBA PNGs.
    Blender,
    /// One `transforms.json`, as instant-ngp and nerfstudio write it.
    Transforms,
    /// A COLMAP model in `sparse/0` with `images` or `images_{factor}`.
    Colmap,
    /// The built-in scene with cameras all around it, like a Blender scene.
    BuiltinBlender,
    /// The built-in scene with forward-facing cameras, like an LLFF scene.
    BuiltinForward,
}

impl DataKind {
    /// Returns the format, which knows all else of its scenes. `None` for `auto`.
    pub fn format(self) -> Option<&'static Format> {
        Format::of(self)
    }

    /// Returns whether the cameras are forward-facing, as far as the kind is known.
    pub fn forward_facing(self) -> bool {
        self.format().is_some_and(|format| format.forward_facing)
    }

    /// Returns half the side of the cube around the origin that holds the objects ([`Format::object_half`]).
    pub fn object_half(self) -> Option<f64> {
        self.format()?.object_half
    }

    /// Returns whether the scene comes with training, validation and test views. Otherwise every N-th view is held out.
    pub fn has_splits(self) -> bool {
        self.format().is_some_and(|format| format.has_splits)
    }

    /// Returns the name in files and tables.
    pub fn name(self) -> &'static str {
        name_of::<DataKind>(self as usize)
    }
}

/// The colour behind transparent pixels of RGBA images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Background {
    /// (1, 1, 1). Rendering adds it where accumulation is below 1.
    #[default]
    White,
    /// (0, 0, 0).
    Black,
}

/// The axes of a camera's matrix.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Axes {
    /// x right, y up, z back.
    #[default]
    Opengl,
    /// x right, y down, z ahead, as OpenCV and COLMAP have them.
    Opencv,
}

/// The views on which a Blender scene is evaluated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EvalSplit {
    /// `transforms_test.json`.
    #[default]
    Test,
    /// `transforms_val.json`.
    Val,
}

/// How the held-out views of a capture without fixed splits are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Split {
    /// The split of the capture's author: `train_filenames` and the like, or a `transforms_{train,val,test}.json` each.
    Own,
    /// Every N-th view.
    Every,
}

/// The point of a pixel through which its ray passes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PixelOrigin {
    /// Integer pixel coordinates, as in nerf-pytorch.
    #[default]
    Corner,
    /// Integer coordinates + 0.5.
    Centre,
}

impl PixelOrigin {
    /// Returns what is added to integer coordinates.
    pub fn shift(self) -> f64 {
        match self {
            PixelOrigin::Corner => 0.0,
            PixelOrigin::Centre => 0.5,
        }
    }
}

/// The name of a built-in scene: `builtin`, `builtin-forward`, or either with a number, such as `builtin:17`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BuiltinScene {
    /// Cameras all around, or forward-facing ones.
    pub kind: DataKind,
    /// Its number. `None` is the still life.
    pub seed: Option<u64>,
}

impl BuiltinScene {
    /// Reads a name. `None` if it names no built-in scene.
    ///
    /// ```
    /// # use augnerf_scenes::settings::{BuiltinScene, DataKind};
    /// let scene = BuiltinScene::named("builtin-forward:17").unwrap();
    /// assert_eq!((scene.kind, scene.seed), (DataKind::BuiltinForward, Some(17)));
    /// assert!(BuiltinScene::named("builtin:x").is_none() && BuiltinScene::named("fern").is_none());
    /// ```
    pub fn named(name: &str) -> Option<BuiltinScene> {
        let (kind, seed) = match name.split_once(':') {
            Some((kind, seed)) => (kind, Some(seed.parse().ok()?)),
            None => (name, None),
        };
        let kind = match kind {
            "builtin" => DataKind::BuiltinBlender,
            "builtin-forward" => DataKind::BuiltinForward,
            _ => return None,
        };
        Some(BuiltinScene { kind, seed })
    }

    /// Returns `data.dir` and `data.kind` of it.
    pub fn settings(self) -> (String, &'static str) {
        (self.seed.map_or_else(String::new, |_| self.to_string()), self.kind.name())
    }

    /// Returns the name in results: `builtin` for the still life, and `builtin-17` or `builtin-forward-17` by number.
    pub fn label(self) -> String {
        self.seed.map_or_else(|| "builtin".into(), |_| self.to_string().replace(':', "-"))
    }
}

impl std::fmt::Display for BuiltinScene {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let name = if self.kind == DataKind::BuiltinForward { "builtin-forward" } else { "builtin" };
        match self.seed {
            None => f.write_str(name),
            Some(seed) => write!(f, "{name}:{seed}"),
        }
    }
}

/// Which training views are kept.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(
    untagged,
    expecting = "expected a number of views, a number and a rule such as \"3 even\", or a list of names such as [\"r_2\", \
                 \"r_26\"]"
)]
pub enum TrainViews {
    /// This many, drawn with `data.views_seed`.
    Number(usize),
    /// This many by a rule.
    Ruled(RuledViews),
    /// The views with these names.
    Named(Vec<String>),
}

/// A number of training views and the rule that chooses them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct RuledViews {
    /// Number of views.
    pub count: usize,
    /// How they are chosen.
    pub rule: ViewsRule,
}

/// How training views are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ViewsRule {
    /// Evenly, from the first to the last (RegNeRF): the places round(i (n - 1) / (count - 1)), halves to even.
    Even,
    /// Part number `data.views_seed` of a fixed order of all, so that two seeds share no view.
    Disjoint,
}

impl TryFrom<String> for RuledViews {
    type Error = String;

    fn try_from(text: String) -> Result<RuledViews, String> {
        let read = text.split_once(' ').and_then(|(count, rule)| {
            let rule = [ViewsRule::Even, ViewsRule::Disjoint].into_iter().find(|known| known.name() == rule.trim())?;
            Some(RuledViews { count: count.parse().ok()?, rule })
        });
        read.ok_or_else(|| {
            format!("\"{text}\" is no number of views with a rule, such as \"3 even\" or \"8 disjoint\"")
        })
    }
}

impl From<RuledViews> for String {
    fn from(RuledViews { count, rule }: RuledViews) -> String {
        format!("{count} {}", rule.name())
    }
}

impl ViewsRule {
    fn name(self) -> &'static str {
        name_of::<ViewsRule>(self as usize)
    }
}

/// Returns whether training views that a file names are some views, each once.
fn are_possible(views: &toml::Value) -> bool {
    match views.clone().try_into() {
        Ok(TrainViews::Number(count) | TrainViews::Ruled(RuledViews { count, .. })) => count > 0,
        Ok(TrainViews::Named(names)) => !names.is_empty() && (1..names.len()).all(|i| !names[..i].contains(&names[i])),
        Err(_) => false,
    }
}

/// Columns that depend on which views are held out.
const SPLIT: &[&str] = &["split", "views_trained", "views_evaluated", "views_seen"];
/// Columns that depend on which of the other views are trained on.
const TRAINED: &[&str] = &["training_views", "views_trained", "views_seen"];

fn is_plain_name(name: &str) -> bool {
    !name.contains(['/', '\\']) && name != "." && name != ".."
}

impl DataConfig {
    /// Returns whether the splits are given, as far as is known before loading. Otherwise every N-th view is held out.
    pub fn has_splits(&self) -> bool {
        self.kind.has_splits() || self.split == Some(Split::Own)
    }
}

/// Returns the last component of a scene's folder, or the built-in scene's name if there is none.
pub fn scene_name(data: &DataConfig) -> String {
    if let Some(scene) = data.numbered_scene() {
        return scene.label();
    }
    let name = std::path::Path::new(&data.dir).file_name().map(|n| n.to_string_lossy().into_owned());
    name.unwrap_or_else(|| "builtin".into())
}

section! {
    /// The scene and how it is read.
    pub struct DataConfig {
        /// Scene folder, or a built-in scene by number such as `builtin:17`. Empty = the built-in still life.
        pub dir: String = String::new(), path();
        /// The scene's name in results. Empty = the folder's name, or `builtin` for the built-in scene, or `builtin-17`.
        pub name: String = String::new(),
            numbers().text(is_plain_name, "a name without path separators").columns(&["scene"]);
        /// Which reader loads the folder. `auto` decides by the files found.
        pub kind: DataKind = DataKind::Auto, numbers().columns(&["dataset"]);
        /// Integer factor by which images are reduced. LLFF: reads `images_{factor}`, or averages `images` down.
        /// Blender and transforms: area averaging. 1 = as stored. Empty = the paper's factor: 8 for LLFF, 2 for
        /// Blender, 1 otherwise.
        pub downscale: Option<u32> = None, numbers().whole(1, 64, "1 to 64").columns(&["width", "height"]);
        /// Exact width in pixels instead of `downscale` (0 = use `downscale`). Height follows the aspect ratio.
        pub width: u32 = 0,
            numbers().whole(0, 16_384, "0 (use data.downscale) to 16384 pixels").columns(&["width", "height"]);
        /// Every N-th view is held out, starting with the first or with the one of `holdout_offset` (LLFF, transforms,
        /// COLMAP, built-in forward scene).
        pub holdout: usize = 8,
            numbers().whole(2, u64::MAX, "at least 2, so that views are left to train on").columns(SPLIT);
        /// Evaluate every N-th evaluation view (1 = all).
        pub test_skip: usize = 1, numbers().whole(1, u64::MAX, "at least 1").columns(SPLIT);
        /// Which views are evaluated: `test` (the held-out views) or `val` (the validation views: a Blender scene's
        /// `transforms_val.json`, or those that `validation` keeps).
        pub eval_split: EvalSplit = EvalSplit::Test, numbers().columns(SPLIT);
        /// Number of views before the first held-out view, below `holdout` (LLFF, transforms, COLMAP, built-in forward
        /// scene).
        pub holdout_offset: usize = 0, numbers().columns(SPLIT).same_time();
        /// Of the views that are not held out, the middle one of every N becomes a validation view (0 = none).
        /// Validation views are never trained on, and are evaluated only with `eval_split = "val"`. Blender scenes come
        /// with a validation split and ignore this.
        pub validation: usize = 0, numbers().columns(&["validation", "views_trained", "views_seen"]).same_time();
        /// Split of a capture with `transforms.json`: `own` (the split that its files name) or `every` (every N-th view
        /// is held out). Empty = its own split if it has one.
        pub split: Option<Split> = None, numbers().columns(SPLIT).same_time();
        /// For few-view studies: the number of training views to keep, drawn with `views_seed` (a smaller number keeps a
        /// subset of a larger one); a number and a rule, `3 even` (evenly from the first to the last, as RegNeRF) or
        /// `8 disjoint` (part number `views_seed` of a fixed order, so that two seeds share no view); or a list of
        /// names. Empty = all.
        pub train_views: Option<TrainViews> = None,
            numbers().values(are_possible, "at least 1, such a number with even or disjoint, or a list of names, each once").columns(TRAINED).same_time();
        /// Seed of the choices among views: those of `train_views`, and those that `eval.train_views` measures. It is
        /// not the run's seed, so that runs of all seeds use the same views.
        pub views_seed: u64 = 0,
            numbers().whole(0, i64::MAX as u64, "at most 2^63 - 1").column("views_seed").same_time();
        /// Background behind transparent pixels of RGBA images.
        pub background: Background = Background::White, numbers().columns(&["background"]);
        /// transforms.json and Blender: the axes of the cameras' matrices, `opengl` (y up, z back) or `opencv` (y down, z
        /// ahead).
        pub axes: Axes = Axes::Opengl, numbers();
        /// COLMAP: the model below the scene's folder that is read: `sparse/1`. Empty = the one with the most photos.
        pub colmap_model: String = String::new(), numbers();
        /// Masks of photos: a folder below the scene's (`masks`) with an image of the photo's name, where black does not
        /// count; `beside` for instant-ngp's `dynamic_mask_NAME.png`, where white does not count; `none`. Empty = those that
        /// the capture's file names.
        pub masks: String = String::new(), numbers();
        /// LLFF: use rays in normalized device coordinates (NDC). For captures that go around an object see
        /// `recognise_orbits`.
        pub ndc: bool = true, numbers().columns(&["ndc"]);
        /// LLFF: recentre poses onto their mean pose. transforms.json and COLMAP: move the cameras' mean to the origin,
        /// and scale all cameras to within 1 of it along each axis.
        pub recentre: bool = true, numbers();
        /// Captures: move and scale the scene so that the box that most cameras look at is around the origin and 3 wide, as in
        /// a Blender scene. Weights and sets with units of length then carry over from scene to scene. NDC and Blender's scenes
        /// have such units already, and stay.
        pub rescale: bool = false, numbers();
        /// LLFF: scale poses and bounds by 1 / (bound_factor * nearest bound). 0 = do not scale.
        pub bound_factor: f64 = 0.75, numbers().real(|factor| factor >= 0.0, "0 (not scaled) or positive");
        /// LLFF: map poses to a sphere around the point they look at (for inward-facing captures).
        pub spherify: bool = false, numbers();
        /// LLFF: recognize captures that go around an object. If cameras are beyond the near plane, or turn by more
        /// than 40 degrees from their mean, `ndc` is switched off and `spherify` on, and a note says so. With `false`
        /// both stay as they are set.
        pub recognise_orbits: bool = true, numbers().columns(&["ndc"]).same_time();
        /// Start of a ray's interval in scene units (0 to 1 in NDC). Empty = the scene's own: from the format (LLFF's
        /// depth bounds, 2 for Blender if that fits), or from COLMAP's points or the point that the cameras look at (`augnerf
        /// data check` prints which).
        pub near: Option<f64> = None, numbers().real(|near| near >= 0.0, "a finite distance of at least 0");
        /// End of a ray's interval. Empty = the scene's own, as for `near` (6 for Blender if that fits).
        pub far: Option<f64> = None, numbers().real(|far| far >= 0.0, "a finite distance of at least 0");
        /// Point of a pixel through which its ray passes. Empty = `centre` for COLMAP and transforms.json, whose poses
        /// assume it, `corner` otherwise.
        pub pixel_origin: Option<PixelOrigin> = None, numbers().column("pixel_origin");
    }
    sections {
        /// Corruption of the training views.
        pub corruption: CorruptionConfig;
    }
}

impl DataConfig {
    /// Returns whether rays are in normalized device coordinates, as far as is known before the scene is loaded.
    pub fn in_ndc(&self) -> bool {
        self.kind.forward_facing() && self.ndc && !self.spherify
    }

    /// Returns the built-in scene that `dir` names by number.
    pub fn numbered_scene(&self) -> Option<BuiltinScene> {
        BuiltinScene::named(&self.dir)
    }

    /// Returns whether the scene is built in.
    pub fn is_builtin(&self) -> bool {
        self.dir.is_empty() || self.numbered_scene().is_some()
    }

    /// Returns the number of a built-in scene. `None` is the still life.
    pub fn scene_number(&self) -> Option<u64> {
        self.numbered_scene().and_then(|scene| scene.seed)
    }

    /// Returns `pixel_origin`, or the default of the kind.
    pub fn origin_of_pixels(&self) -> PixelOrigin {
        self.pixel_origin.unwrap_or(self.kind.format().map_or(PixelOrigin::Corner, |format| format.pixel_origin))
    }

    /// Checks the settings against one another.
    pub fn validate(&self) -> base::Result<()> {
        let (format, kind, has_splits) = (self.kind.format(), self.kind.name(), self.has_splits());
        let is_read = |name: &str| format.is_none_or(|format| format.reads.contains(&name));
        refuse(
            self.spherify && !is_read("spherify"),
            format!("data.spherify = true is for LLFF scenes; this one is {kind}"),
        )?;
        let may_have_val = is_read("split") && self.split != Some(Split::Every) || has_splits || self.validation > 0;
        refuse(
            self.eval_split == EvalSplit::Val && !may_have_val,
            format!(
                "data.eval_split = \"val\" is for scenes with a validation split, and this one is {kind}: keep every N-th view for \
                 that with data.validation"
            ),
        )?;
        let allowed = "0 (none) or at least 2, so that views are left to train on";
        require(self.validation != 1, "data.validation", 1, allowed)?;
        let (offset, holdout) = (self.holdout_offset, self.holdout);
        let allowed = format!("0 to {} (below data.holdout)", holdout - 1);
        require(offset < holdout, "data.holdout_offset", offset, &allowed)?;
        refuse(
            self.split == Some(Split::Own) && !is_read("split") && self.kind != DataKind::Blender,
            format!("data.split = \"own\" is for captures whose files name a split; this one is {kind}"),
        )?;
        refuse(
            self.split == Some(Split::Every) && self.kind.has_splits(),
            format!(
                "data.split = \"every\" is for captures of which views are held out; this one is {kind}, whose splits are given"
            ),
        )?;
        refuse(
            offset > 0 && has_splits,
            format!(
                "data.holdout_offset = {offset} is for scenes of which every N-th view is held out; this one is {kind}, whose \
                 splits are given"
            ),
        )?;
        refuse(
            self.spherify && self.ndc && self.kind == DataKind::Llff,
            "data.spherify and data.ndc exclude each other: NDC is for cameras that face forward; set data.ndc=false",
        )?;
        let Some((near, far)) = self.near.zip(self.far) else { return Ok(()) };
        require(near < far, "data.far", far, &format!("beyond data.near = {near}"))
    }

    /// Adds the settings without effect. A scene whose kind is not known may read all.
    pub fn idle(&self, idle: &mut IdleSettings) {
        let corruption = self.corruption.kind;
        let is_noise = matches!(corruption, CorruptionKind::GaussianNoise | CorruptionKind::ShotNoise);
        for (names, holds, who) in [
            (&["severity"][..], !is_noise, "gaussian-noise and shot-noise have a severity"),
            (&["share"], corruption != CorruptionKind::Pepper, "pepper has a share"),
            (&["degrees", "offset"], corruption != CorruptionKind::Poses, "poses moves cameras"),
        ] {
            let why = format!("data.corruption.kind is \"{}\"; {who}", corruption.name());
            idle.add(Dropped, "data.corruption.", names, holds, why);
        }
        idle.add(Noted, "data.", &["downscale"], self.width > 0, format!("data.width is {}", self.width));
        let why = "the scene has splits of its own";
        idle.add(Noted, "data.", &["validation", "holdout_offset"], self.has_splits(), why);
        // A Blender scene whose split has no photos reads it.
        idle.add(Noted, "data.", &["holdout"], self.has_splits() && self.kind != DataKind::Blender, why);
        let Some(format) = Format::of(self.kind) else { return };
        for name in FORMATS.iter().flat_map(|format| format.reads) {
            let readers: Vec<&str> =
                FORMATS.iter().filter(|format| format.reads.contains(name)).map(|format| format.kind.name()).collect();
            let why = format!("data.kind is \"{}\"; scenes of {} read it", self.kind.name(), readers.join(", "));
            idle.add(Noted, "data.", &[name], !format.reads.contains(name), why);
        }
        let why = "only captures outside normalized device coordinates are rescaled";
        idle.add(Noted, "data.", &["rescale"], !may_have_box(self), why);
    }
}
