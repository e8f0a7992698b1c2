//! One clean pass of rays through one field.

use candle_core::Tensor;

use crate::base::Result;
use crate::data::Rays;
use crate::field::{Field, RawOutput};

use super::cast::{positions_at, samples_of};
use super::volume::{self, Composite};

/// The inputs of a pass, except the field.
#[derive(Clone, Copy)]
pub struct Pass<'a> {
    /// Origins and directions, `[rays, 3]`, with the other parts that the method needs.
    pub rays: &'a Rays,
    /// Sample positions, `[rays, samples]`. With an integrated encoding, edges of intervals, `[rays, samples + 1]`.
    pub t_vals: &'a Tensor,
    /// Added to raw density, `[rays, samples]`.
    pub density_noise: Option<&'a Tensor>,
    /// The colour behind missing accumulation.
    pub background: Option<[f32; 3]>,
}

/// The result of a pass.
pub struct PassOutput {
    /// Colour, depth, accumulation, weights.
    pub composite: Composite,
    /// Colour of each sample after activation and delta, `[rays, samples, 3]`.
    pub rgb: Tensor,
    /// Density of each sample after activation and delta, `[rays, samples]`.
    pub density: Tensor,
    /// The pass's `t_vals` with their delta.
    pub t_vals: Tensor,
    /// Raw density of each sample without noise, detached, `[rays, samples]`.
    pub raw_density: Tensor,
}

/// Renders one pass without perturbation.
pub fn clean_pass(field: &Field, pass: Pass) -> Result<PassOutput> {
    let raw = clean_raw(field, pass)?;
    finish(pass, pass.t_vals, &raw, activate(field, &raw, pass.density_noise)?)
}

/// Returns raw colour and density of a pass without perturbation.
pub(super) fn clean_raw(field: &Field, pass: Pass) -> Result<RawOutput> {
    let positions = positions_at(field, pass.rays, pass.t_vals)?.flatten(0, 1)?;
    let raw = field.forward(&positions, &pass.rays.viewdirs, None)?;
    by_ray(raw, pass.rays.len(), samples_of(field, pass.t_vals)?)
}

/// Composites the samples of a pass at `t_vals`.
pub(super) fn finish(pass: Pass, t_vals: &Tensor, raw: &RawOutput, samples: SampleValues) -> Result<PassOutput> {
    let SampleValues { rgb, density } = samples;
    let composite = volume::composite(&rgb, &density, t_vals, &pass.rays.direction_norm, pass.background)?;
    let (t_vals, raw_density) = (t_vals.detach(), raw.density.detach());
    Ok(PassOutput { composite, rgb, density, t_vals, raw_density })
}

/// Returns a field's raw output as rgb `[rays, samples, 3]` and density `[rays, samples]`.
pub(super) fn by_ray(raw: RawOutput, rays: usize, samples: usize) -> Result<RawOutput> {
    let (rgb, density) = (raw.rgb.reshape((rays, samples, 3))?, raw.density.reshape((rays, samples))?);
    Ok(RawOutput { rgb, density, ..raw })
}

/// Colour and density of each sample, as they are composited.
pub(super) struct SampleValues {
    /// `[rays, samples, 3]`.
    pub(super) rgb: Tensor,
    /// `[rays, samples]`.
    pub(super) density: Tensor,
}

/// Applies the field's activations to colour and density, and noise to density.
pub(super) fn activate(field: &Field, raw: &RawOutput, density_noise: Option<&Tensor>) -> Result<SampleValues> {
    let rgb = field.activate_rgb(&raw.rgb)?;
    let density = match density_noise {
        Some(noise) => field.activate_density(&(&raw.density + noise)?)?,
        None => field.activate_density(&raw.density)?,
    };
    Ok(SampleValues { rgb, density })
}
