//! The whole experiment as data: nested sections whose defaults are the paper's, presets,
//! `--set a.b=v`, and checks across fields.
//!
//! Layers, later over earlier: defaults, preset, the method's own (MipNeRF), configuration file, `--data`/`--method`/`--seed`,
//! `--set`. The result is what stands in every run's `config.toml`.

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

mod corruption;
mod layers;
mod method;
mod perturb;
mod regularizer;
mod resolved;
mod validate;

pub use corruption::{CorruptionConfig, CorruptionKind};
pub use layers::{Preset, build, data_section, parse_assignment};
pub use method::{Method, Representation};
pub use perturb::{
    DeltaSource, Objective, OutputPlace, PerturbConfig, PerturbField, Resample, ResolvedPerturb, SecondPass,
    SiteConfig, Sizes,
};
pub use regularizer::{LatticePoints, REGULARIZERS, RegularizedFields, Regularizer, RegularizerConfig};
pub use resolved::{Located, Resolved};
pub use validate::{MESH_SIDES, validate_mesh, validate_regularizer};

use crate::base::{Error, Result};

/// One experiment. Everything that can change a number is in here; what cannot (device, threads,
/// output folder) is not.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Seed of every random stream.
    pub seed: u64,
    /// What is trained: `nerf` or `mip-nerf` (clean pass only), `aug-nerf` or `aug-mip-nerf` (clean + perturbed pass,
    /// section `perturb`).
    pub method: Method,
    /// The scene.
    pub data: DataConfig,
    /// The network.
    pub field: FieldConfig,
    /// Samples along a ray.
    pub sampling: SamplingConfig,
    /// Optimisation.
    pub train: TrainConfig,
    /// The perturbed pass; read only where the method has one.
    pub perturb: PerturbConfig,
    /// Explicit smoothness terms, with either method.
    pub regularizer: RegularizerConfig,
    /// Evaluation and its pictures.
    pub eval: EvalConfig,
}

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

/// The scene and how it is read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DataConfig {
    /// Scene folder; empty for the embedded scene.
    pub dir: String,
    /// The scene's name in results. Empty = the folder's name, `builtin` for the embedded scene.
    pub name: String,
    /// Reader.
    pub kind: DataKind,
    /// Integer factor by which images are smaller than the originals. LLFF: `images_{factor}`,
    /// or `images` averaged down. Blender and transforms: area averaging. 1 = as stored.
    /// Empty = the paper's: 8 for LLFF, 2 for Blender, 1 otherwise.
    pub downscale: Option<u32>,
    /// Exact width in pixels instead of `downscale` (0 = use `downscale`); height follows the aspect.
    pub width: u32,
    /// Every N-th view is held out (LLFF, transforms, embedded forward scene), starting with the first.
    pub holdout: usize,
    /// Keep every N-th evaluation view (1 = all).
    pub test_skip: usize,
    /// Which split a Blender scene is evaluated on.
    pub eval_split: EvalSplit,
    /// Background of RGBA images.
    pub background: Background,
    /// LLFF: rays in normalised device coordinates.
    pub ndc: bool,
    /// LLFF: poses recentred onto their mean pose.
    pub recentre: bool,
    /// LLFF: poses and bounds scaled by 1 / (bound_factor * nearest bound); 0 = not scaled.
    pub bound_factor: f64,
    /// LLFF: poses mapped to a sphere around the point they look at (for inward-facing captures).
    pub spherify: bool,
    /// Overrides the scene's near bound; empty = the scene's own.
    pub near: Option<f64>,
    /// Overrides the scene's far bound; empty = the scene's own.
    pub far: Option<f64>,
    /// Where in a pixel its ray goes through.
    pub pixel_origin: PixelOrigin,
    /// What is done to the training views.
    pub corruption: CorruptionConfig,
}

impl Default for DataConfig {
    fn default() -> Self {
        DataConfig {
            dir: String::new(),
            name: String::new(),
            kind: DataKind::Auto,
            downscale: None,
            width: 0,
            holdout: 8,
            test_skip: 1,
            eval_split: EvalSplit::Test,
            background: Background::White,
            ndc: true,
            recentre: true,
            bound_factor: 0.75,
            spherify: false,
            near: None,
            far: None,
            pixel_origin: PixelOrigin::Corner,
            corruption: CorruptionConfig::default(),
        }
    }
}

/// Which implementation of the networks computes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Core {
    /// Fused where there is one for the device, plain elsewhere.
    #[default]
    Fused,
    /// candle's operations: the reference.
    Plain,
}

/// How weights are drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Init {
    /// Glorot uniform weights, zero biases (original NeRF).
    #[default]
    Glorot,
    /// Uniform in +-1/sqrt(inputs) for weights and biases (PyTorch's linear layer, nerf-pytorch).
    Torch,
}

/// What turns a network's raw density into density.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DensityActivation {
    /// max(raw, 0) (NeRF).
    #[default]
    Relu,
    /// ln(1 + exp(raw - 1)) (MipNeRF).
    Softplus,
}

/// How positions are encoded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Encoding {
    /// Of a point, with the identity (NeRF).
    #[default]
    Positional,
    /// The expectation over a Gaussian, without the identity (MipNeRF).
    Integrated,
}

/// How the learning rate falls.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Schedule {
    /// By `decay_rate` every `decay_steps`.
    #[default]
    Exponential,
    /// From `learning_rate` to `final_learning_rate` over the run, evenly in its logarithm, after a warm-up.
    LogLinear,
}

/// The coarse and the fine network; both have this shape.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FieldConfig {
    /// Neurons of a trunk layer (D).
    pub width: usize,
    /// Trunk layers.
    pub depth: usize,
    /// The encoding is concatenated to the output of these layers (1-based).
    pub skips: Vec<usize>,
    /// How positions are encoded: `positional` for NeRF, `integrated` for MipNeRF.
    pub encoding: Encoding,
    /// Octaves of the position's encoding (10: 63 channels; integrated, 16: 96).
    pub position_octaves: usize,
    /// Octaves of the view direction's encoding (4: 27 channels).
    pub view_octaves: usize,
    /// How weights are drawn.
    pub init: Init,
    /// What turns raw density into density.
    pub density_activation: DensityActivation,
    /// Colours reach from minus this to 1 plus this, so that 0 and 1 need no infinite raw colour (MipNeRF: 0.001).
    pub rgb_padding: f64,
    /// What computes the networks: `fused` (where there is one for the device) or `plain`, the reference. They differ by
    /// roundings.
    pub core: Core,
}

impl Default for FieldConfig {
    fn default() -> Self {
        FieldConfig {
            width: 256,
            depth: 8,
            skips: vec![5],
            encoding: Encoding::Positional,
            position_octaves: 10,
            view_octaves: 4,
            init: Init::Glorot,
            density_activation: DensityActivation::Relu,
            rgb_padding: 0.0,
            core: Core::Fused,
        }
    }
}

/// Samples along a ray.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SamplingConfig {
    /// Stratified samples of the coarse pass (MipNeRF: intervals).
    pub coarse: usize,
    /// Further inverse-CDF samples of the fine pass, which has `coarse + fine` (MipNeRF: its intervals, `fine` in all;
    /// 0 = coarse pass only).
    pub fine: usize,
    /// MipNeRF: added to the blurred weights that the fine pass's intervals are drawn from.
    pub resample_padding: f64,
    /// Jitter in training.
    pub jitter: bool,
    /// Standard deviation of the noise on raw density in training. Empty = 1 for forward-facing
    /// scenes, 0 otherwise.
    pub density_noise: Option<f64>,
}

impl Default for SamplingConfig {
    fn default() -> Self {
        SamplingConfig { coarse: 64, fine: 64, resample_padding: 0.01, jitter: true, density_noise: None }
    }
}

/// Where a step's rays come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Batching {
    /// Shuffled over all training images, epoch by epoch.
    #[default]
    AllImages,
    /// Distinct pixels of one random image.
    OneImage,
}

/// Optimisation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Weight updates.
    pub steps: u64,
    /// Rays of one step.
    pub rays: usize,
    /// Rays that one thread works on at once; bounds memory (a GPU wants thousands). Changes results by rounding,
    /// and the attack's random draws.
    pub chunk: usize,
    /// Where a step's rays come from. Empty = `one-image` for scenes seen from all around,
    /// `all-images` for forward-facing ones.
    pub batching: Option<Batching>,
    /// Adam's initial learning rate.
    pub learning_rate: f64,
    /// Weight of the coarse pass's loss beside the fine one's (1 for NeRF, 0.1 for MipNeRF).
    pub coarse_weight: f64,
    /// How the learning rate falls: `exponential` or `log-linear`.
    pub schedule: Schedule,
    /// `log-linear`: the learning rate at the last step.
    pub final_learning_rate: f64,
    /// `log-linear`: share of the steps in which the rate rises to its course.
    pub warmup_share: f64,
    /// `log-linear`: what the rate is multiplied by at the first step.
    pub warmup_from: f64,
    /// `exponential`: the learning rate is multiplied by this every `decay_steps`, continuously.
    pub decay_rate: f64,
    /// See `decay_rate`. Empty = 250,000 for forward-facing scenes, 500,000 otherwise.
    pub decay_steps: Option<u64>,
    /// For so many steps, one-image batches come from the central part only. Empty = 500 where
    /// batches are of one image, 0 otherwise.
    pub precrop_steps: Option<u64>,
    /// The central part's share of each side.
    pub precrop_fraction: f64,
    /// Steps between two rows of `scalars.csv`.
    pub log_every: u64,
    /// Steps between two evaluations during training (0 = only at the end).
    pub eval_every: u64,
    /// Steps between two checkpoints (0 = by time only).
    pub checkpoint_every: u64,
    /// Minutes between two checkpoints (0 = by steps only).
    pub checkpoint_minutes: f64,
    /// Checkpoints kept.
    pub keep_checkpoints: usize,
    /// A start with a smaller share of positive densities on the first batch is drawn again.
    pub dead_start_share: f64,
    /// A run whose rays all accumulate under 1e-3 for so many steps has collapsed (0 = never).
    pub collapse_steps: u64,
}

impl Default for TrainConfig {
    fn default() -> Self {
        TrainConfig {
            steps: 500_000,
            rays: 1024,
            chunk: 32,
            batching: None,
            learning_rate: 5e-4,
            coarse_weight: 1.0,
            schedule: Schedule::Exponential,
            final_learning_rate: 5e-6,
            warmup_share: 0.0025,
            warmup_from: 0.01,
            decay_rate: 0.1,
            decay_steps: None,
            precrop_steps: None,
            precrop_fraction: 0.5,
            log_every: 100,
            eval_every: 0,
            checkpoint_every: 10_000,
            checkpoint_minutes: 10.0,
            keep_checkpoints: 2,
            dead_start_share: 0.05,
            collapse_steps: 200,
        }
    }
}

/// Evaluation and its pictures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EvalConfig {
    /// Rays rendered at once; bounds memory. Changes results by rounding only.
    pub chunk: usize,
    /// Folder with LPIPS weights; empty = LPIPS is not measured.
    pub lpips_weights: String,
    /// How many held-out views `train` writes pictures of (0 = none; metrics cover all views).
    pub pictures: usize,
    /// The surface that is compared with a reference mesh.
    pub mesh: MeshConfig,
}

/// The level set of density that is measured as the scene's surface: columns `chamfer` and `f_score`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MeshConfig {
    /// Cells along each side of the box (0 = no surface is measured).
    pub resolution: usize,
    /// Density of the surface, 1 / length. Empty = that which stops half of the light within a ray's mean sample
    /// interval: what the run itself can tell from a surface.
    pub threshold: Option<f64>,
    /// Corners of the box in the units that the field is asked in. Empty = the scene kind's own.
    #[serde(rename = "box")]
    pub domain: Option<[[f64; 3]; 2]>,
    /// PLY or OBJ file in scene units that the surface is compared with; empty = the embedded scene's own, which
    /// other scenes have not.
    pub reference: String,
    /// Points that are drawn on each surface.
    pub points: usize,
    /// Distance of the F-score, scene units.
    pub at: f64,
}

impl Default for MeshConfig {
    fn default() -> Self {
        MeshConfig { resolution: 0, threshold: None, domain: None, reference: String::new(), points: 200_000, at: 0.02 }
    }
}

impl Default for EvalConfig {
    fn default() -> Self {
        EvalConfig { chunk: 256, lpips_weights: String::new(), pictures: 4, mesh: MeshConfig::default() }
    }
}

/// Fields that are younger than runs whose hash is to stay: at their default they do not count.
const YOUNG: [(&str, &str); 10] = [
    ("data", "corruption"),
    ("field", "encoding"),
    ("field", "rgb_padding"),
    ("sampling", "resample_padding"),
    ("train", "coarse_weight"),
    ("train", "schedule"),
    ("train", "final_learning_rate"),
    ("train", "warmup_share"),
    ("train", "warmup_from"),
    ("eval", "mesh"),
];

impl Config {
    /// Parses TOML text over the defaults. `origin` names the file in messages.
    pub fn from_toml(text: &str, origin: &str) -> Result<Config> {
        let config: Config = toml::from_str(text).map_err(|e| Error::Config(format!("{origin}: {e}")))?;
        config.validate()?;
        Ok(config)
    }

    /// The configuration as TOML, every field written out.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a configuration is plain data")
    }

    /// A 12-digit content hash of [`Config::portable`].
    pub fn hash(&self) -> String {
        self.portable().text_hash()
    }

    /// Everything that can change a weight or a metric, the rest at its defaults. The scene counts
    /// by its name, not by where its folder lies; how often a run logs, evaluates or saves does
    /// not count, and neither do section `perturb` without a perturbed pass and regularizers of weight 0.
    pub fn portable(&self) -> Config {
        let mut portable = self.clone();
        if portable.data.name.is_empty() {
            portable.data.name = scene_name(&self.data.dir);
        }
        portable.data.dir = String::new();
        // A chunk's size can move a metric by a rounding.
        portable.eval = EvalConfig { chunk: portable.eval.chunk, ..EvalConfig::default() };
        let defaults = TrainConfig::default();
        portable.train = TrainConfig {
            log_every: defaults.log_every,
            eval_every: defaults.eval_every,
            checkpoint_every: defaults.checkpoint_every,
            checkpoint_minutes: defaults.checkpoint_minutes,
            keep_checkpoints: defaults.keep_checkpoints,
            ..portable.train
        };
        if !self.method.is_augmented() {
            portable.perturb = PerturbConfig::default();
        }
        portable.regularizer.resolve();
        portable.data.corruption.resolve();
        portable
    }

    /// A 12-digit hash of all fields, but for those in `YOUNG` that are at their defaults.
    pub fn text_hash(&self) -> String {
        let as_table = |config: &Config| toml::Table::try_from(config).expect("a configuration is plain data");
        let (mut table, defaults) = (as_table(self), as_table(&Config::default()));
        for (section, field) in YOUNG {
            let Some(fields) = table[section].as_table_mut() else { continue };
            if fields.get(field) == defaults[section].get(field) {
                fields.remove(field);
            }
        }
        short_hash(Sha256::new_with_prefix(table.to_string()))
    }

    /// Samples of the coarse and of the fine pass; the latter 0 where there is none.
    pub fn samples(&self) -> (usize, usize) {
        let SamplingConfig { coarse, fine, .. } = self.sampling;
        (coarse, if fine == 0 || self.field.encoding.at_intervals() { fine } else { coarse + fine })
    }
}

/// The first 12 hexadecimal digits of a hash: enough to tell experiments apart, short enough to read.
pub fn short_hash(hash: Sha256) -> String {
    hash.finalize().iter().take(6).map(|byte| format!("{byte:02x}")).collect()
}

/// The last component of a scene's folder, or `builtin` where there is none.
pub fn scene_name(dir: &str) -> String {
    let name = std::path::Path::new(dir).file_name().map(|n| n.to_string_lossy().into_owned());
    name.unwrap_or_else(|| "builtin".into())
}
