//! Section `train`: optimization.

use serde::{Deserialize, Serialize};

use crate::base::settings::{numbers, section, work};

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

/// The source of a step's rays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Batching {
    /// Shuffled over all training images, epoch by epoch.
    #[default]
    AllImages,
    /// Distinct pixels of one random image.
    OneImage,
}

const RATE: &[&str] = &["learning_rate"];

fn is_memory(beta: f64) -> bool {
    (0.0..1.0).contains(&beta)
}

/// Where parameters move in a sharpness-aware step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SamDirection {
    /// Up the step's gradient.
    #[default]
    Gradient,
    /// As far at random: a control.
    Random,
}

const CLIP: &[&str] = &["clip"];
const SAM: &[&str] = &["sam"];

section! {
    /// Optimization.
    pub struct TrainConfig {
        /// Number of optimizer steps.
        pub steps: u64 = 500_000,
            numbers().whole(1, 1_000_000_000, "at least 1, at most 10^9").columns(&["steps"]).same_time();
        /// Rays per step.
        pub rays: usize = 1024, numbers().whole(1, 1 << 20, "1 to 1048576").column("rays");
        /// Rays that one thread processes at once. It bounds memory (a GPU needs thousands). It changes results by
        /// rounding, and changes the attack's random draws.
        pub chunk: usize = 32, numbers().whole(1, 1 << 20, "1 to 1048576 rays").column("chunk");
        /// Source of a step's rays: `one-image` or `all-images`. Empty = `one-image` for scenes with cameras all
        /// around, `all-images` for forward-facing ones.
        pub batching: Option<Batching> = None, numbers().column("batching");
        /// Initial learning rate of Adam.
        pub learning_rate: f64 = 5e-4, numbers().positive().columns(RATE).same_time();
        /// Adam's beta 2, the decay of squared gradients (0.99 for hash grids).
        pub adam_beta2: f64 = 0.999, numbers().real(is_memory, "at least 0, below 1").columns(&["adam"]).same_time();
        /// Adam's epsilon, added to the divisor (1e-15 for hash grids, whose gradients are small).
        pub adam_epsilon: f64 = 1e-8, numbers().positive().columns(&["adam"]).same_time();
        /// Decay of layers' weights, apart from Adam's step (AdamW): each update multiplies them by 1 minus this times the
        /// learning rate. Tables of hash grids have `regularizer.kind = "hash-decay"`.
        pub weight_decay: f64 = 0.0, numbers().off_or_positive().columns(&["adam"]).same_time();
        /// Largest absolute value of an entry of the gradient (0 = no limit).
        pub clip_value: f64 = 0.0, numbers().off_or_positive().columns(CLIP);
        /// Largest norm of the gradient over all parameters, after `clip_value` (0 = no limit).
        pub clip_norm: f64 = 0.0, numbers().off_or_positive().columns(CLIP);
        /// Sharpness-aware steps: the gradient is taken at parameters that moved this far (0 = off; 0.05 is usual). A step
        /// then takes about twice as long.
        pub sam_radius: f64 = 0.0, numbers().off_or_positive().columns(SAM);
        /// Where the parameters move: up the step's `gradient`, or as far in a `random` direction.
        pub sam_direction: SamDirection = SamDirection::Gradient, numbers().columns(SAM).same_time();
        /// Gradients of samples closer to the camera than one scene unit are multiplied by their distance squared
        /// (Philip and Deschaintre 2023). Not with NDC, where t is no distance.
        pub gradient_scaling: bool = false, numbers().column("gradient_scaling");
        /// Weight of the coarse pass's loss; the fine pass's is 1 (1 for NeRF, 0.1 for MipNeRF; hash grids have no
        /// coarse loss).
        pub coarse_weight: f64 = 1.0,
            numbers().positive().column("coarse_weight").same_time();
        /// How the learning rate falls: `exponential` or `log-linear`.
        pub schedule: Schedule = Schedule::Exponential, numbers().columns(RATE).same_time();
        /// `log-linear`: the learning rate at the last step.
        pub final_learning_rate: f64 = 5e-6,
            numbers().positive().columns(RATE).same_time();
        /// `log-linear`: share of the steps in which the rate warms up.
        pub warmup_share: f64 = 0.0025,
            numbers()
                .real(|share| (0.0..=1.0).contains(&share), "0 (no warm-up) to 1")
                .column("warmup_share")
                .same_time();
        /// `log-linear`: factor on the rate at the first step.
        pub warmup_from: f64 = 0.01,
            numbers().share_above_0().column("warmup_from").same_time();
        /// `exponential`: factor on the learning rate per `decay_steps`, applied continuously.
        pub decay_rate: f64 = 0.1, numbers().positive().columns(RATE).same_time();
        /// Steps per factor of `decay_rate`. Empty = 250,000 for forward-facing scenes, 500,000 otherwise.
        pub decay_steps: Option<u64> = None, numbers().whole(1, u64::MAX, "at least 1").columns(RATE).same_time();
        /// Number of first steps whose one-image batches use the central part only. Empty = 500 if `batching` is
        /// `one-image`, 0 otherwise.
        pub precrop_steps: Option<u64> = None, numbers().column("precrop_steps");
        /// Size of the central part as a fraction of each side.
        pub precrop_fraction: f64 = 0.5,
            numbers().share_above_0().column("precrop_fraction");
        /// Steps between two rows of `scalars.csv`.
        pub log_every: u64 = 100, work().whole(1, u64::MAX, "at least 1");
        /// Steps between two evaluations during training (0 = only at the end).
        pub eval_every: u64 = 0, work();
        /// Evaluations during training render every N-th pixel of a view in each direction (1 = all).
        pub eval_stride: usize = 1, work().whole(1, 1000, "1 to 1000").same_time();
        /// Steps between two checkpoints (0 = by time only).
        pub checkpoint_every: u64 = 10_000, work();
        /// Minutes between two checkpoints (0 = by steps only).
        pub checkpoint_minutes: f64 = 10.0, work().off_or_positive();
        /// Number of checkpoints to keep.
        pub keep_checkpoints: usize = 2, work().whole(1, 10_000, "1 to 10000");
        /// Weights are drawn again if a smaller share of densities is positive on the first batch.
        pub dead_start_share: f64 = 0.05,
            numbers().real(|share| (0.0..1.0).contains(&share), "0 (off) to below 1").column("dead_start_share");
        /// The origin of the initial weights, if they are not random: another run's hash and step, or the hash of a
        /// file. `train --from` and `import` set it; it cannot be set otherwise.
        pub parent: Option<String> = None, numbers().column("parent").same_time();
        /// Number of steps after which a run counts as collapsed if every ray accumulates less than 1e-3, or all rays have
        /// one colour and their photos have not (0 = never; a point of a sweep then counts with the PSNR that it has).
        pub collapse_steps: u64 = 200, numbers();
    }
    sections {}
}
