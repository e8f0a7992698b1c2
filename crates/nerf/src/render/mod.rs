//! Rendering of rays: clean and perturbed passes through one field, and coarse plus fine for evaluation.

use candle_core::Tensor;

use crate::base::Result;

mod cast;
mod fused_loss;
mod image;
mod loss;
mod pass;
mod perturbed;
pub mod sampling;
pub mod settings;
pub mod volume;

pub use cast::{gaussians_at, points_at, positions_at, ray_parts, samples_of};
pub use image::{columns, fine_t_vals, place, render_rays, resample};
pub use loss::{PassLoss, clean_pass_loss, noiseless_acc, perturbed_pass_loss};
pub use pass::{Pass, PassOutput, clean_pass};
pub use perturbed::{FixedSamples, Perturbation, PerturbedOutput, perturbed_pass};
pub use volume::Composite;

/// Returns the mean squared error over rays and channels between colours `[rays, 3]`.
pub fn photometric_loss(rgb: &Tensor, target: &Tensor) -> Result<Tensor> {
    Ok((rgb - target)?.sqr()?.mean_all()?)
}
