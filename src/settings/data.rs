//! Section `data`: the scene and how it is read.

use serde::{Deserialize, Serialize};

use super::CorruptionConfig;
use super::registry::{choice, numbers, place, section};

/// Which reader a scene folder is given to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DataKind {
    /// Decided by the files found: `poses_bounds.npy`, `transforms_train.json`, `transforms.json`.
    #[default]
    Auto,
    /// `poses_bounds.npy` with `images_{factor}` or `images`.
    Llff,
    /// `transforms_{train,val,test}.json` with RGBA PNGs.
    Blender,
    /// One `transforms.json` as instant-ngp and nerfstudio write it.
    Transforms,
    /// The embedded scene seen from all around, like a Blender scene.
    BuiltinBlender,
    /// The embedded scene seen from the front, like an LLFF scene.
    BuiltinForward,
}

impl DataKind {
    /// All kinds.
    pub const ALL: [DataKind; 6] = [
        DataKind::Auto,
        DataKind::Llff,
        DataKind::Blender,
        DataKind::Transforms,
        DataKind::BuiltinBlender,
        DataKind::BuiltinForward,
    ];

    /// Seen from the front only, which is where LLFF's defaults (noise, batches, decay) belong.
    pub fn forward_facing(self) -> bool {
        match self {
            DataKind::Llff | DataKind::BuiltinForward => true,
            DataKind::Auto | DataKind::Blender | DataKind::Transforms | DataKind::BuiltinBlender => false,
        }
    }

    /// Comes split into training, validation and test views; of the others every N-th view is held out.
    pub fn has_splits(self) -> bool {
        match self {
            DataKind::Blender | DataKind::BuiltinBlender => true,
            DataKind::Auto | DataKind::Llff | DataKind::Transforms | DataKind::BuiltinForward => false,
        }
    }

    /// The paper's `data.downscale`.
    pub(super) fn downscale(self) -> u32 {
        match self {
            DataKind::Llff => 8,
            DataKind::Blender => 2,
            DataKind::Auto | DataKind::Transforms | DataKind::BuiltinBlender | DataKind::BuiltinForward => 1,
        }
    }

    /// The name in files and tables.
    pub fn name(self) -> &'static str {
        match self {
            DataKind::Auto => "auto",
            DataKind::Llff => "llff",
            DataKind::Blender => "blender",
            DataKind::Transforms => "transforms",
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

choice!(DataKind, Background, EvalSplit, PixelOrigin);

const SPLIT: &[&str] = &["split", "views_trained", "views_evaluated"];

fn is_plain_name(name: &str) -> bool {
    !name.contains(['/', '\\']) && name != "." && name != ".."
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
        /// Every N-th view is held out (LLFF, transforms, embedded forward scene), starting with the first.
        pub holdout: usize = 8,
            numbers().whole(2, u64::MAX, "at least 2, so that views are left to train on").columns(SPLIT);
        /// Keep every N-th evaluation view (1 = all).
        pub test_skip: usize = 1, numbers().whole(1, u64::MAX, "at least 1").columns(SPLIT);
        /// Which split a Blender scene is evaluated on.
        pub eval_split: EvalSplit = EvalSplit::Test, numbers().columns(SPLIT);
        /// Background of RGBA images.
        pub background: Background = Background::White, numbers().columns(&["background"]);
        /// LLFF: rays in normalised device coordinates.
        pub ndc: bool = true, numbers().columns(&["ndc"]);
        /// LLFF: poses recentred onto their mean pose.
        pub recentre: bool = true, numbers();
        /// LLFF: poses and bounds scaled by 1 / (bound_factor * nearest bound); 0 = not scaled.
        pub bound_factor: f64 = 0.75, numbers().real(|factor| factor >= 0.0, "0 (not scaled) or positive");
        /// LLFF: poses mapped to a sphere around the point they look at (for inward-facing captures).
        pub spherify: bool = false, numbers();
        /// Overrides the scene's near bound; empty = the scene's own.
        pub near: Option<f64> = None, numbers().real(|near| near >= 0.0, "a finite distance of at least 0");
        /// Overrides the scene's far bound; empty = the scene's own.
        pub far: Option<f64> = None, numbers().real(|far| far >= 0.0, "a finite distance of at least 0");
        /// Where in a pixel its ray goes through.
        pub pixel_origin: PixelOrigin = PixelOrigin::Corner, numbers().columns(&["pixel_origin"]);
    }
    sections {
        /// What is done to the training views.
        pub corruption: CorruptionConfig, true;
    }
}
