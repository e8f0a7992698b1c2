//! Section `train`: optimisation.

use serde::{Deserialize, Serialize};

use super::registry::{choice, numbers, section, work};

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

choice!(Schedule, Batching);

const RATE: &[&str] = &["learning_rate"];

fn is_positive(value: f64) -> bool {
    value > 0.0
}

fn is_memory(beta: f64) -> bool {
    (0.0..1.0).contains(&beta)
}

fn is_share_above_0(share: f64) -> bool {
    share > 0.0 && share <= 1.0
}

section! {
    /// Optimisation.
    pub struct TrainConfig {
        /// Weight updates.
        pub steps: u64 = 500_000,
            numbers().whole(1, 1_000_000_000, "at least 1, at most 10^9").columns(&["steps"]).same_time();
        /// Rays of one step.
        pub rays: usize = 1024, numbers().whole(1, 1 << 20, "1 to 1048576").column("rays");
        /// Rays that one thread works on at once; bounds memory (a GPU wants thousands). Changes results by rounding,
        /// and the attack's random draws.
        pub chunk: usize = 32, numbers().whole(1, 1 << 20, "1 to 1048576 rays").column("chunk");
        /// Where a step's rays come from. Empty = `one-image` for scenes seen from all around,
        /// `all-images` for forward-facing ones.
        pub batching: Option<Batching> = None, numbers().column("batching");
        /// Adam's initial learning rate.
        pub learning_rate: f64 = 5e-4, numbers().real(is_positive, "positive").columns(RATE).same_time();
        /// Adam's memory of squared gradients (beta 2; 0.99 for hash grids).
        pub adam_beta2: f64 = 0.999, numbers().real(is_memory, "at least 0, below 1").columns(&["adam"]).later().same_time();
        /// Added to Adam's divisor (1e-15 for hash grids, whose gradients are small).
        pub adam_epsilon: f64 = 1e-8, numbers().real(is_positive, "positive").columns(&["adam"]).later().same_time();
        /// Weight of the coarse pass's loss beside the fine one's (1 for NeRF, 0.1 for MipNeRF; hash
        /// grids have no loss there).
        pub coarse_weight: f64 = 1.0,
            numbers().real(is_positive, "positive").column("coarse_weight").later().same_time();
        /// How the learning rate falls: `exponential` or `log-linear`.
        pub schedule: Schedule = Schedule::Exponential, numbers().columns(RATE).later().same_time();
        /// `log-linear`: the learning rate at the last step.
        pub final_learning_rate: f64 = 5e-6,
            numbers().real(is_positive, "positive").columns(RATE).later().same_time();
        /// `log-linear`: share of the steps in which the rate rises to its course.
        pub warmup_share: f64 = 0.0025,
            numbers()
                .real(|share| (0.0..=1.0).contains(&share), "0 (no warm-up) to 1")
                .column("warmup_share")
                .later()
                .same_time();
        /// `log-linear`: what the rate is multiplied by at the first step.
        pub warmup_from: f64 = 0.01,
            numbers().real(is_share_above_0, "above 0, at most 1").column("warmup_from").later().same_time();
        /// `exponential`: the learning rate is multiplied by this every `decay_steps`, continuously.
        pub decay_rate: f64 = 0.1, numbers().real(is_positive, "positive").columns(RATE).same_time();
        /// See `decay_rate`. Empty = 250,000 for forward-facing scenes, 500,000 otherwise.
        pub decay_steps: Option<u64> = None, numbers().whole(1, u64::MAX, "at least 1").columns(RATE).same_time();
        /// For so many steps, one-image batches come from the central part only. Empty = 500 where
        /// batches are of one image, 0 otherwise.
        pub precrop_steps: Option<u64> = None, numbers().column("precrop_steps");
        /// The central part's share of each side.
        pub precrop_fraction: f64 = 0.5,
            numbers().real(is_share_above_0, "above 0, at most 1").column("precrop_fraction");
        /// Steps between two rows of `scalars.csv`.
        pub log_every: u64 = 100, work().whole(1, u64::MAX, "at least 1");
        /// Steps between two evaluations during training (0 = only at the end).
        pub eval_every: u64 = 0, work();
        /// Those evaluations take every so manyth pixel of a view, across and down: 1 = all of them.
        pub eval_stride: usize = 1, work().whole(1, 1000, "1 to 1000").later().same_time();
        /// Steps between two checkpoints (0 = by time only).
        pub checkpoint_every: u64 = 10_000, work();
        /// Minutes between two checkpoints (0 = by steps only).
        pub checkpoint_minutes: f64 = 10.0, work().real(|minutes| minutes >= 0.0, "0 (off) or positive");
        /// Checkpoints kept.
        pub keep_checkpoints: usize = 2, work().whole(1, 10_000, "1 to 10000");
        /// A start with a smaller share of positive densities on the first batch is drawn again.
        pub dead_start_share: f64 = 0.05,
            numbers().real(|share| (0.0..1.0).contains(&share), "0 (off) to below 1").column("dead_start_share");
        /// What the run began with instead of fresh weights: another run's hash and step, or the hash of a file. `train --from`
        /// and `import` write it; a run cannot begin with it otherwise.
        pub parent: Option<String> = None, numbers().column("parent").later().same_time();
        /// A run whose rays all accumulate under 1e-3 for so many steps has collapsed (0 = never).
        pub collapse_steps: u64 = 200, numbers();
    }
    sections {}
}
