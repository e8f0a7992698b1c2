//! Rendering for evaluation: a coarse pass places samples, and a fine pass renders them.

use candle_core::Tensor;

use crate::base::Result;
use crate::data::Rays;
use crate::field::Field;
use crate::render::settings::SamplingConfig;

use super::cast::positions_at;
use super::occupancy::Occupancy;
use super::pass::{Pass, PlacedSamples, clean_pass};
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

/// How fields are rendered for evaluation: deterministically, without jitter and noise, with evenly spaced u.
#[derive(Clone, Copy)]
pub struct Evaluation<'a> {
    /// Places the samples of the fine pass. It is the complete model if there is none.
    pub coarse: &'a Field,
    /// The field of the fine pass.
    pub fine: Option<&'a Field>,
    /// The cells that place samples, instead of a coarse pass.
    pub occupancy: Option<&'a Occupancy>,
    /// How many samples there are.
    pub sampling: &'a SamplingConfig,
    /// Near and far.
    pub bounds: (f64, f64),
    /// The colour behind missing accumulation.
    pub background: Option<[f32; 3]>,
}

impl Evaluation<'_> {
    /// Renders rays.
    ///
    /// # Errors
    /// Those of candle.
    pub fn render(&self, rays: &Rays) -> Result<Composite> {
        let samples = self.samples(rays)?;
        Ok(clean_pass(self.fine.unwrap_or(self.coarse), Pass::noiseless(rays, &samples, self.background))?.composite)
    }

    /// Returns the samples of the pass that is rendered.
    ///
    /// # Errors
    /// Those of candle.
    pub fn samples(&self, rays: &Rays) -> Result<PlacedSamples> {
        let Evaluation { coarse, fine, sampling, bounds, .. } = *self;
        if let Some(occupancy) = self.occupancy {
            let intervals = occupancy.march(rays, bounds, None)?;
            return occupancy.place(fine.unwrap_or(coarse), rays, &intervals);
        }
        let (columns, fine_columns) = t_vals_per_ray(coarse, sampling);
        let t_vals = sampling::stratified(bounds, sampling.spacing, rays.len(), columns, None, &rays.origins)?;
        if fine.is_none() {
            return Ok(PlacedSamples::all(t_vals));
        }
        let u = sampling::even_u(rays.len(), fine_columns, &t_vals)?;
        Ok(PlacedSamples::all(t_vals_by_density(coarse, rays, &t_vals, sampling, &u)?))
    }
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
