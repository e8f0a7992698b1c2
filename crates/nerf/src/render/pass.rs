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
    /// Gradients of samples near the camera are multiplied by min(1, distance^2) (Floaters No More: Philip and Deschaintre
    /// 2023, equation 5).
    pub scales_gradients: bool,
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
    near_scaled(by_ray(raw, pass.rays.len(), samples_of(field, pass.t_vals)?)?, pass, pass.t_vals)
}

/// Returns a pass's raw output with the gradients that [`Pass::scales_gradients`] asks for.
pub(super) fn near_scaled(raw: RawOutput, pass: Pass, t_vals: &Tensor) -> Result<RawOutput> {
    if !pass.scales_gradients {
        return Ok(raw);
    }
    let (_, samples) = raw.density.dims2()?;
    let places = volume::middles(t_vals, samples)?.detach();
    let scale = places.broadcast_mul(&pass.rays.direction_norm)?.sqr()?.minimum(1.0)?;
    // The value stays, to the bit.
    let scaled = |values: &Tensor, scale: &Tensor| -> Result<Tensor> {
        let moved = values.broadcast_mul(scale)?;
        Ok((values.detach() + (&moved - moved.detach())?)?)
    };
    Ok(RawOutput { rgb: scaled(&raw.rgb, &scale.unsqueeze(2)?)?, density: scaled(&raw.density, &scale)?, joined: None })
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

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{DType, Device, Var};

    /// A quarter at half a unit from the camera, and all from one unit on. Values stay.
    #[test]
    fn gradients_near_the_camera_fall_with_the_distance_squared() {
        let device = Device::Cpu;
        let of = |values: &[f64]| Tensor::new(values, &device).unwrap().reshape((1, ())).unwrap();
        let directions = Tensor::new(&[[0.0f64, 0.0, -2.0]], &device).unwrap();
        let rays = Rays::new(directions.zeros_like().unwrap(), directions.clone(), directions).unwrap();
        let t_vals = of(&[0.25, 0.5, 2.0]);
        let pass = Pass { rays: &rays, t_vals: &t_vals, density_noise: None, background: None, scales_gradients: true };
        let density = Var::from_tensor(&of(&[0.1, 0.7, 0.3])).unwrap();
        let rgb = Var::from_tensor(&Tensor::ones((1, 3, 3), DType::F64, &device).unwrap()).unwrap();
        let raw = RawOutput { rgb: rgb.as_tensor().clone(), density: density.as_tensor().clone(), joined: None };
        let scaled = near_scaled(raw, pass, &t_vals).unwrap();
        assert_eq!(scaled.density.to_vec2::<f64>().unwrap(), density.to_vec2::<f64>().unwrap());
        let sum = (scaled.density.sum_all().unwrap() + scaled.rgb.sum_all().unwrap()).unwrap();
        let slopes = sum.backward().unwrap();
        assert_eq!(slopes.get(&density).unwrap().to_vec2::<f64>().unwrap(), [[0.25, 1.0, 1.0]]);
        let of_rgb = slopes.get(&rgb).unwrap().to_vec3::<f64>().unwrap();
        assert_eq!(of_rgb[0], [[0.25; 3], [1.0; 3], [1.0; 3]]);
    }
}
