//! What an evaluation sees of rays: a coarse pass that places samples, and a fine one that is shown.

use candle_core::Tensor;

use crate::base::Result;
use crate::data::Rays;
use crate::field::Field;
use crate::settings::{Encoding, SamplingConfig};

use super::cast::positions_at;
use super::pass::{Pass, clean_pass};
use super::sampling;
use super::volume::{self, Composite};

/// Numbers of `t_vals` that a field's passes have, from those of a configuration: for the coarse pass, and for `u` of the
/// fine one.
pub fn columns(field: &Field, sampling: &SamplingConfig) -> (usize, usize) {
    let encoding = field.config().encoding;
    (encoding.t_vals(sampling.coarse), encoding.t_vals(sampling.fine))
}

/// The fine pass's `t_vals` from the coarse pass's, its weights and `u`.
pub fn resample(
    field: &Field,
    sampling: &SamplingConfig,
    t_vals: &Tensor,
    weights: &Tensor,
    u: &Tensor,
) -> Result<Tensor> {
    match field.config().encoding {
        Encoding::Positional => sampling::importance(t_vals, weights, u),
        Encoding::Integrated | Encoding::Hash => {
            sampling::resample_intervals(t_vals, weights, u, sampling.resample_padding)
        }
    }
}

/// The deterministic image of rays for evaluation: no jitter, no noise, evenly spaced u. Without a
/// fine field the coarse pass is the result.
pub fn render_rays(
    coarse: &Field,
    fine: Option<&Field>,
    rays: &Rays,
    bounds: (f64, f64),
    sampling: &SamplingConfig,
    background: Option<[f32; 3]>,
) -> Result<Composite> {
    let columns = columns(coarse, sampling).0;
    let t_vals = sampling::stratified(bounds, sampling.spacing, rays.len(), columns, None, &rays.origins)?;
    let pass = Pass { rays, t_vals: &t_vals, density_noise: None, background };
    let Some(fine) = fine else { return Ok(clean_pass(coarse, pass)?.composite) };
    let t_vals = fine_t_vals(coarse, rays, &t_vals, sampling)?;
    Ok(clean_pass(fine, Pass { t_vals: &t_vals, ..pass })?.composite)
}

/// The `t_vals` of an evaluation's fine pass, after the coarse field at `t_vals`.
pub fn fine_t_vals(coarse: &Field, rays: &Rays, t_vals: &Tensor, sampling: &SamplingConfig) -> Result<Tensor> {
    let u = sampling::even_u(rays.len(), columns(coarse, sampling).1, t_vals)?;
    place(coarse, rays, t_vals, sampling, &u)
}

/// The fine pass's `t_vals` at `u`, by the density of the coarse field at `t_vals` alone: no colours, no gradients, no noise.
pub fn place(coarse: &Field, rays: &Rays, t_vals: &Tensor, sampling: &SamplingConfig, u: &Tensor) -> Result<Tensor> {
    let positions = positions_at(coarse, rays, t_vals)?.flatten(0, 1)?;
    let raw = coarse.raw_density(&positions)?.reshape((rays.len(), sampling.coarse))?;
    let intervals = volume::intervals(t_vals, &rays.direction_norm, sampling.coarse)?;
    let weights = volume::weights_from_density(&coarse.activate_density(&raw)?, &intervals)?;
    resample(coarse, sampling, t_vals, &weights, u)
}
