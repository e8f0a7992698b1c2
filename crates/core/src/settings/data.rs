//! Section `data`: the scene and how it is read.

use serde::{Deserialize, Serialize};

use super::CorruptionConfig;
use super::registry::{Range, Settable, choice, numbers, place, section};

/// Which reader a scene folder is given to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DataKind {
    /// Decided by the files found: `poses_bounds.npy`, `transforms_train.json`, `transforms.json`, `sparse/0`.
    #[default]
    Auto,
    /// `poses_bounds.npy` with `images_{factor}` or `images`.
    Llff,
    /// `transforms_{train,val,test}.json` with RGBA PNGs.
    Blender,
    /// One `transforms.json` as instant-ngp and nerfstudio write it.
    Transforms,
    /// A COLMAP model in `sparse/0` with `images` or `images_{factor}`.
    Colmap,
    /// The embedded scene seen from all around, like a Blender scene.
    BuiltinBlender,
    /// The embedded scene seen from the front, like an LLFF scene.
    BuiltinForward,
}

impl DataKind {
    /// All kinds.
    pub const ALL: [DataKind; 7] = [
        DataKind::Auto,
        DataKind::Llff,
        DataKind::Blender,
        DataKind::Transforms,
        DataKind::Colmap,
        DataKind::BuiltinBlender,
        DataKind::BuiltinForward,
    ];

    /// Seen from the front only, which is where LLFF's defaults (noise, batches, decay) belong.
    pub fn forward_facing(self) -> bool {
        match self {
            DataKind::Llff | DataKind::BuiltinForward => true,
            DataKind::Auto | DataKind::Blender | DataKind::Transforms | DataKind::Colmap | DataKind::BuiltinBlender => {
                false
            }
        }
    }

    /// Where in a pixel its ray goes through, unless it is set: COLMAP's poses are for the centre, published numbers of the
    /// others for the corner.
    fn pixel_origin(self) -> PixelOrigin {
        match self {
            DataKind::Transforms | DataKind::Colmap => PixelOrigin::Centre,
            DataKind::Auto
            | DataKind::Llff
            | DataKind::Blender
            | DataKind::BuiltinBlender
            | DataKind::BuiltinForward => PixelOrigin::Corner,
        }
    }

    /// Everything lies within 1.5 of the origin, as in NeRF-Synthetic.
    pub fn has_known_extent(self) -> bool {
        self.object_half().is_some()
    }

    /// Half the side of the cube around the origin that holds the objects, scene units; none where only the training rays
    /// tell.
    pub fn object_half(self) -> Option<f64> {
        match self {
            DataKind::Blender => Some(1.5),
            DataKind::BuiltinBlender => Some(1.2),
            DataKind::Auto | DataKind::Llff | DataKind::Transforms | DataKind::Colmap | DataKind::BuiltinForward => {
                None
            }
        }
    }

    /// Comes split into training, validation and test views; of the others every N-th view is held out.
    pub fn has_splits(self) -> bool {
        match self {
            DataKind::Blender | DataKind::BuiltinBlender => true,
            DataKind::Auto | DataKind::Llff | DataKind::Transforms | DataKind::Colmap | DataKind::BuiltinForward => {
                false
            }
        }
    }

    /// The paper's `data.downscale`.
    pub(super) fn downscale(self) -> u32 {
        match self {
            DataKind::Llff => 8,
            DataKind::Blender => 2,
            DataKind::Auto
            | DataKind::Transforms
            | DataKind::Colmap
            | DataKind::BuiltinBlender
            | DataKind::BuiltinForward => 1,
        }
    }

    /// The name in files and tables.
    pub fn name(self) -> &'static str {
        match self {
            DataKind::Auto => "auto",
            DataKind::Llff => "llff",
            DataKind::Blender => "blender",
            DataKind::Transforms => "transforms",
            DataKind::Colmap => "colmap",
            DataKind::BuiltinBlender => "builtin-blender",
            DataKind::BuiltinForward => "builtin-forward",
        }
    }
}

/// What transparent pixels of RGBA images are composited on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Background {
    /// (1, 1, 1); rendering fills missing accumulation with it.
    #[default]
    White,
    /// (0, 0, 0).
    Black,
}

/// Which views a Blender scene is evaluated on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EvalSplit {
    /// `transforms_test.json`.
    #[default]
    Test,
    /// `transforms_val.json`.
    Val,
}

/// Which views of a capture without fixed splits are held out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Split {
    /// Those that its author names: `train_filenames` and its like, or a `transforms_{train,val,test}.json` each.
    Own,
    /// Every N-th.
    Every,
}

/// Where in a pixel its ray goes through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PixelOrigin {
    /// Integer pixel coordinates, as nerf-pytorch.
    #[default]
    Corner,
    /// Integer coordinates + 0.5.
    Centre,
}

impl PixelOrigin {
    /// What is added to integer coordinates.
    pub fn shift(self) -> f64 {
        match self {
            PixelOrigin::Corner => 0.0,
            PixelOrigin::Centre => 0.5,
        }
    }
}

choice!(DataKind, Background, EvalSplit, Split, PixelOrigin);

/// Which of a scene's training views are kept.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected a number of views, or a list of their names such as [\"r_2\", \"r_26\"]")]
pub enum TrainViews {
    /// So many, drawn with `data.views_seed`.
    Number(usize),
    /// Those of these names.
    Named(Vec<String>),
}

impl Settable for TrainViews {
    fn kind() -> String {
        "whole number, or list of: text".into()
    }

    fn outside(&self, _: &Range) -> Option<String> {
        match self {
            TrainViews::Number(number) => (*number == 0).then(|| "0".into()),
            TrainViews::Named(names) => {
                let twice = (1..names.len()).any(|i| names[..i].contains(&names[i]));
                (names.is_empty() || twice).then(|| format!("{names:?}"))
            }
        }
    }
}

/// Columns that speak of which views are held out.
const SPLIT: &[&str] = &["split", "views_trained", "views_evaluated", "views_seen"];
/// Columns that speak of which of the others are trained on.
const TRAINED: &[&str] = &["training_views", "views_trained", "views_seen"];

fn is_plain_name(name: &str) -> bool {
    !name.contains(['/', '\\']) && name != "." && name != ".."
}

impl DataConfig {
    /// Splits are given, as far as is known; otherwise every N-th view is held out.
    pub fn has_splits(&self) -> bool {
        self.kind.has_splits() || self.split == Some(Split::Own)
    }
}

section! {
    /// The scene and how it is read.
    pub struct DataConfig {
        /// Scene folder; empty for the embedded scene.
        pub dir: String = String::new(), place();
        /// The scene's name in results. Empty = the folder's name, `builtin` for the embedded scene.
        pub name: String = String::new(),
            numbers().text(is_plain_name, "a name without path separators").columns(&["scene"]);
        /// Reader.
        pub kind: DataKind = DataKind::Auto, numbers().columns(&["dataset"]);
        /// Integer factor by which images are smaller than the originals. LLFF: `images_{factor}`,
        /// or `images` averaged down. Blender and transforms: area averaging. 1 = as stored.
        /// Empty = the paper's: 8 for LLFF, 2 for Blender, 1 otherwise.
        pub downscale: Option<u32> = None, numbers().whole(1, 64, "1 to 64").columns(&["width", "height"]);
        /// Exact width in pixels instead of `downscale` (0 = use `downscale`); height follows the aspect.
        pub width: u32 = 0,
            numbers().whole(0, 16_384, "0 (use data.downscale) to 16384 pixels").columns(&["width", "height"]);
        /// Every N-th view is held out (LLFF, transforms, COLMAP, embedded forward scene), starting with the first, or with that of
        /// `holdout_offset`.
        pub holdout: usize = 8,
            numbers().whole(2, u64::MAX, "at least 2, so that views are left to train on").columns(SPLIT);
        /// Keep every N-th evaluation view (1 = all).
        pub test_skip: usize = 1, numbers().whole(1, u64::MAX, "at least 1").columns(SPLIT);
        /// `test`: held-out views are evaluated. `val`: those for choices, a Blender scene's `transforms_val.json` or what
        /// `validation` keeps.
        pub eval_split: EvalSplit = EvalSplit::Test, numbers().columns(SPLIT);
        /// How many views come before the first that is held out (below `holdout`; LLFF, transforms, COLMAP, embedded forward
        /// scene).
        pub holdout_offset: usize = 0, numbers().columns(SPLIT).later().same_time();
        /// Of the views that are not held out, the middle one of every N is kept for choices (0 = none): never trained on,
        /// and evaluated with `eval_split = "val"` alone. Blender scenes have a split for that, and pay this no heed.
        pub validation: usize = 0, numbers().columns(&["validation", "views_trained", "views_seen"]).later().same_time();
        /// Whether a capture with `transforms.json` keeps the split that its files name (`own`), or every N-th view is held out
        /// (`every`). Empty = its own where there is one.
        pub split: Option<Split> = None, numbers().columns(SPLIT).later().same_time();
        /// Few-view studies: how many of the training views are kept, drawn with `views_seed` (a smaller number keeps a part
        /// of what a larger one keeps), or the names of those that are. Empty = all.
        pub train_views: Option<TrainViews> = None,
            numbers().allowing("at least 1, or a list of names, each once").columns(TRAINED).later().same_time();
        /// Seed of choices among views: those of `train_views`, and those that `eval.train_views` measures. Not the run's
        /// seed: runs of all seeds see the same views.
        pub views_seed: u64 = 0,
            numbers().whole(0, i64::MAX as u64, "at most 2^63 - 1").column("views_seed").later().same_time();
        /// Background of RGBA images.
        pub background: Background = Background::White, numbers().columns(&["background"]);
        /// LLFF: rays in normalised device coordinates. Of a capture that goes around something: see `recognise_orbits`.
        pub ndc: bool = true, numbers().columns(&["ndc"]);
        /// LLFF: poses recentred onto their mean pose. transforms.json, COLMAP: the cameras' mean at the origin, and all of them
        /// within 1 of it along each axis.
        pub recentre: bool = true, numbers();
        /// LLFF: poses and bounds scaled by 1 / (bound_factor * nearest bound); 0 = not scaled.
        pub bound_factor: f64 = 0.75, numbers().real(|factor| factor >= 0.0, "0 (not scaled) or positive");
        /// LLFF: poses mapped to a sphere around the point they look at (for inward-facing captures).
        pub spherify: bool = false, numbers();
        /// LLFF: where cameras stand beyond the near plane, or turn by more than 40 degrees from their mean, `ndc` is switched off
        /// and `spherify` on, and that is said. With `false` both are as they are set.
        pub recognise_orbits: bool = true, numbers().columns(&["ndc"]).later().same_time();
        /// Start of a ray's interval, scene units (0 to 1 under NDC). Empty = the scene's own: of the format (LLFF's depth bounds,
        /// 2 for Blender), or found from COLMAP's points or what the cameras look at (`augnerf data check` says which).
        pub near: Option<f64> = None, numbers().real(|near| near >= 0.0, "a finite distance of at least 0");
        /// Its end. Empty = the scene's own, as for `near` (6 for Blender).
        pub far: Option<f64> = None, numbers().real(|far| far >= 0.0, "a finite distance of at least 0");
        /// Where in a pixel its ray goes through. Empty = `centre` for COLMAP and transforms.json, whose poses are for that,
        /// `corner` otherwise.
        pub pixel_origin: Option<PixelOrigin> = None, numbers().column("pixel_origin");
    }
    sections {
        /// What is done to the training views.
        pub corruption: CorruptionConfig, true;
    }
}

impl DataConfig {
    /// Rays are in normalised device coordinates, as far as is known before the scene is loaded.
    pub fn in_ndc(&self) -> bool {
        self.kind.forward_facing() && self.ndc && !self.spherify
    }

    /// `pixel_origin`, or the kind's own.
    pub fn origin_of_pixels(&self) -> PixelOrigin {
        self.pixel_origin.unwrap_or(self.kind.pixel_origin())
    }
}
