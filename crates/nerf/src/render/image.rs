//! Rendering for evaluation: a coarse pass places samples, and a fine pass renders them.

use candle_core::Tensor;

use crate::base::Result;
use crate::data::Rays;
use crate::field::Field;
use crate::render::settings::SamplingConfig;

use super::cast::positions_at;
use super::occupancy::{Occupancy, PlacedSamples};
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
/// coarse pass is the result. With occupied cells these place the samples.
pub fn render_rays(
    coarse: &Field,
    fine: Option<&Field>,
    occupancy: Option<&Occupancy>,
    rays: &Rays,
    bounds: (f64, f64),
    sampling: &SamplingConfig,
    background: Option<[f32; 3]>,
) -> Result<Composite> {
    let PlacedSamples { t_vals, asked } = evaluation_samples(coarse, fine, occupancy, rays, bounds, sampling)?;
    let (t_vals, asked) = (&t_vals, asked.as_ref());
    let pass = Pass { rays, t_vals, asked, density_noise: None, background, scales_gradients: false };
    Ok(clean_pass(fine.unwrap_or(coarse), pass)?.composite)
}

/// Returns the samples of the pass that [`render_rays`] shows.
pub fn evaluation_samples(
    coarse: &Field,
    fine: Option<&Field>,
    occupancy: Option<&Occupancy>,
    rays: &Rays,
    bounds: (f64, f64),
    sampling: &SamplingConfig,
) -> Result<PlacedSamples> {
    if let Some(occupancy) = occupancy {
        let intervals = occupancy.march(rays, bounds, None)?;
        return occupancy.place(fine.unwrap_or(coarse), rays, &intervals);
    }
    let t_vals = even_t_vals(coarse, rays, bounds, sampling)?;
    let t_vals = if fine.is_some() { fine_t_vals(coarse, rays, &t_vals, sampling)? } else { t_vals };
    Ok(PlacedSamples { t_vals, asked: None })
}

/// Returns the `t_vals` of a coarse pass without jitter.
fn even_t_vals(coarse: &Field, rays: &Rays, bounds: (f64, f64), sampling: &SamplingConfig) -> Result<Tensor> {
    let (columns, _) = t_vals_per_ray(coarse, sampling);
    sampling::stratified(bounds, sampling.spacing, rays.len(), columns, None, &rays.origins)
}

/// Returns the `t_vals` of an evaluation's fine pass, from the coarse field at `t_vals`.
fn fine_t_vals(coarse: &Field, rays: &Rays, t_vals: &Tensor, sampling: &SamplingConfig) -> Result<Tensor> {
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
