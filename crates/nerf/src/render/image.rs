//! Rendering for evaluation: a coarse pass places samples, and a fine pass renders them.

use candle_core::Tensor;

use crate::base::Result;
use crate::data::Rays;
use crate::field::Field;
use crate::render::settings::SamplingConfig;

use super::cast::positions_at;
use super::pass::{Pass, clean_pass};
use super::sampling;
use super::volume::{self, Composite};

/// Returns the number of `t_vals` of a field's coarse pass, and of `u` of its fine pass, in a configuration.
pub fn t_vals_per_ray(field: &Field, sampling: &SamplingConfig) -> (usize, usize) {
    let encoding = field.config().encoding;
    (encoding.t_vals(sampling.coarse), encoding.t_vals(sampling.fine))
}

/// Returns the fine pass's `t_vals` from the coarse pass's, its weights and `u`.
pub fn resample(
    field: &Field,
    sampling: &SamplingConfig,
    t_vals: &Tensor,
    weights: &Tensor,
    u: &Tensor,
) -> Result<Tensor> {
    if field.config().encoding.at_intervals() {
        return sampling::resample_intervals(t_vals, weights, u, sampling.resample_padding);
    }
    sampling::importance(t_vals, weights, u)
}

/// Renders rays for evaluation, deterministically: no jitter, no noise, evenly spaced u. Without a fine field the
/// coarse pass is the result.
pub fn render_rays(
    coarse: &Field,
    fine: Option<&Field>,
    rays: &Rays,
    bounds: (f64, f64),
    sampling: &SamplingConfig,
    background: Option<[f32; 3]>,
) -> Result<Composite> {
    let (columns, _) = t_vals_per_ray(coarse, sampling);
    let t_vals = sampling::stratified(bounds, sampling.spacing, rays.len(), columns, None, &rays.origins)?;
    let pass = Pass { rays, t_vals: &t_vals, density_noise: None, background, scales_gradients: false };
    let Some(fine) = fine else { return Ok(clean_pass(coarse, pass)?.composite) };
    let t_vals = fine_t_vals(coarse, rays, &t_vals, sampling)?;
    Ok(clean_pass(fine, Pass { t_vals: &t_vals, ..pass })?.composite)
}

/// Returns the `t_vals` of an evaluation's fine pass, from the coarse field at `t_vals`.
pub fn fine_t_vals(coarse: &Field, rays: &Rays, t_vals: &Tensor, sampling: &SamplingConfig) -> Result<Tensor> {
    let u = sampling::even_u(rays.len(), t_vals_per_ray(coarse, sampling).1, t_vals)?;
    t_vals_by_density(coarse, rays, t_vals, sampling, &u)
}

/// Returns the fine pass's `t_vals` at `u` from the density of the coarse field at `t_vals` only. It needs no colours,
/// gradients or noise.
pub fn t_vals_by_density(
    coarse: &Field,
    rays: &Rays,
    t_vals: &Tensor,
    sampling: &SamplingConfig,
    u: &Tensor,
) -> Result<Tensor> {
    let positions = positions_at(coarse, rays, t_vals)?.flatten(0, 1)?;
    let raw = coarse.raw_density(&positions)?.reshape((rays.len(), sampling.coarse))?;
    let intervals = volume::intervals(t_vals, &rays.direction_norm, sampling.coarse)?;
    let weights = volume::weights_from_density(&coarse.activate_density(&raw)?, &intervals)?;
    resample(coarse, sampling, t_vals, &weights, u)
}
