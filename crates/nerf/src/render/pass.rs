//! One clean pass of rays through one field.

use candle_core::{D, Tensor};

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
    /// Sample positions, `[rays, samples]`. With an integrated encoding or a hash grid, edges of
    /// intervals, `[rays, samples + 1]`.
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
    let positions = positions_at(field, pass.rays, pass.t_vals)?.flatten(0, 1)?;
    let raw = field.forward(&positions, &pass.rays.viewdirs, None)?;
    let raw = near_scaled(by_ray(raw, pass.rays.len(), samples_of(field, pass.t_vals)?)?, pass, pass.t_vals)?;
    finish(pass, pass.t_vals, &raw, activate(field, &raw, pass.density_noise)?)
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
    Ok(RawOutput { rgb: scaled(&raw.rgb, &scale.unsqueeze(2)?)?, density: scaled(&raw.density, &scale)? })
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
    Ok(RawOutput { rgb, density })
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

/// Returns the accumulation of rays without density noise, `[rays]`, as in an evaluation: 1 - exp(-sum of density *
/// interval).
pub fn noiseless_acc(field: &Field, out: &PassOutput, pass: Pass) -> Result<Tensor> {
    if pass.density_noise.is_none() {
        return Ok(out.composite.acc.detach());
    }
    let intervals = volume::intervals(pass.t_vals, &pass.rays.direction_norm, out.raw_density.dim(1)?)?;
    let optical = (field.activate_density(&out.raw_density)? * intervals)?;
    Ok((1.0 - optical.sum(D::Minus1)?.neg()?.exp()?)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::rng::{Random, Stream};
    use crate::field::settings::{DensityActivation, FieldConfig};
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
        let raw = RawOutput { rgb: rgb.as_tensor().clone(), density: density.as_tensor().clone() };
        let scaled = near_scaled(raw, pass, &t_vals).unwrap();
        assert_eq!(scaled.density.to_vec2::<f64>().unwrap(), density.to_vec2::<f64>().unwrap());
        let sum = (scaled.density.sum_all().unwrap() + scaled.rgb.sum_all().unwrap()).unwrap();
        let slopes = sum.backward().unwrap();
        assert_eq!(slopes.get(&density).unwrap().to_vec2::<f64>().unwrap(), [[0.25, 1.0, 1.0]]);
        let of_rgb = slopes.get(&rgb).unwrap().to_vec3::<f64>().unwrap();
        assert_eq!(of_rgb[0], [[0.25; 3], [1.0; 3], [1.0; 3]]);
    }

    #[test]
    fn noise_is_left_out_of_accumulations() {
        let draw = |index: u64, shape: &[usize]| {
            Random::new(index, Stream::Init, 0).uniform_tensor(shape, DType::F32, &Device::Cpu).unwrap()
        };
        let rays = Rays::new(draw(1, &[4, 3]), draw(2, &[4, 3]), draw(3, &[4, 3])).unwrap();
        let (raw_density, noise, rgb) = ((draw(4, &[4, 6]) - 0.4).unwrap(), draw(5, &[4, 6]), draw(6, &[4, 6, 3]));
        // Edges, since behind the last of points all are opaque.
        let t_vals = draw(7, &[4, 7]).cumsum(1).unwrap().contiguous().unwrap();
        for density_activation in [DensityActivation::Relu, DensityActivation::Softplus, DensityActivation::Exp] {
            let config = FieldConfig { width: 8, density_activation, ..FieldConfig::default() };
            let field = Field::init(&config, 0, 0, DType::F32, &Device::Cpu).unwrap();
            let of = |raw: &Tensor| {
                let density = field.activate_density(raw).unwrap();
                volume::composite(&rgb, &density, &t_vals, &rays.direction_norm, None).unwrap()
            };
            let expected: Vec<f32> = of(&raw_density).acc.to_vec1().unwrap();
            let composite = of(&(&raw_density + &noise).unwrap());
            let (rgb, density) = (rgb.clone(), noise.clone());
            let out = PassOutput { composite, rgb, density, t_vals: t_vals.clone(), raw_density: raw_density.clone() };
            let (density_noise, background) = (Some(&noise), None);
            let pass = Pass { rays: &rays, t_vals: &t_vals, density_noise, background, scales_gradients: false };
            let found: Vec<f32> = noiseless_acc(&field, &out, pass).unwrap().to_vec1().unwrap();
            let is_same = |(found, expected): (&f32, &f32)| (found - expected).abs() < 1e-6 && *found > 0.0;
            assert!(found.iter().zip(&expected).all(is_same), "{density_activation:?}: {found:?} {expected:?}");
        }
    }
}
