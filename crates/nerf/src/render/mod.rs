//! Rendering of rays: clean and perturbed passes through one field, and coarse plus fine for evaluation.

use candle_core::Tensor;

use crate::base::Result;

mod cast;
mod image;
mod occupancy;
mod pass;
pub mod sampling;
pub mod settings;
pub mod volume;

pub use cast::{gaussians_at, points_at, positions_at, ray_parts, sample_count};
pub use image::{Evaluation, resample, t_vals_by_density, t_vals_per_ray};
pub use occupancy::{Intervals, Occupancy, OccupiedDensity};
pub use pass::{Pass, PassOutput, Perturbation, PlacedSamples, clean_pass, noiseless_acc, perturbed_pass, search};
pub use volume::Composite;

/// Returns the mean squared error over rays and channels between colours `[rays, 3]`.
pub fn photometric_loss(rgb: &Tensor, target: &Tensor) -> Result<Tensor> {
    Ok((rgb - target)?.sqr()?.mean_all()?)
}
