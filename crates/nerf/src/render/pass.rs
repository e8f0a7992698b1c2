//! One pass of rays through one field, clean or perturbed (paper, algorithm 1, lines 9 to 20): where each site's delta is
//! added, and what a search need not compute again.

use candle_core::{D, Tensor};

use crate::base::Result;
use crate::data::Rays;
use crate::field::{FeatureDelta, Field, Queried, QueryPoints, RawOutput};
use crate::perturb::settings::OutputPlace;
use crate::perturb::{Deltas, PaperSite, Sets, UsedDeltas, output_range, tilt, worst_case};

use super::cast::{positions_at, sample_count};
use super::photometric_loss;
use super::volume::{self, Composite};

/// The samples of a pass along its rays.
#[derive(Clone)]
pub struct PlacedSamples {
    /// Distances of samples along the ray, `[rays, samples]`. With an integrated encoding or a hash grid, edges of
    /// intervals, `[rays, samples + 1]`.
    pub t_vals: Tensor,
    /// The samples at which the field is queried, ray after ray. The others are empty. `None`: all.
    pub queried: Option<Queried>,
}

impl PlacedSamples {
    /// Returns samples that are all queried.
    pub fn all(t_vals: Tensor) -> PlacedSamples {
        PlacedSamples { t_vals, queried: None }
    }
}

/// The inputs of a pass, except its field and its deltas.
#[derive(Clone, Copy)]
pub struct Pass<'a> {
    /// Origins and directions, `[rays, 3]`, with the other parts that the method needs.
    pub rays: &'a Rays,
    /// Where its samples are.
    pub samples: &'a PlacedSamples,
    /// Added to raw density, `[rays, samples]`.
    pub density_noise: Option<&'a Tensor>,
    /// The colour behind missing accumulation.
    pub background: Option<[f32; 3]>,
    /// Gradients of samples near the camera are multiplied by min(1, distance^2) (Floaters No More: Philip and Deschaintre
    /// 2023, equation 5).
    pub scales_gradients: bool,
}

impl<'a> Pass<'a> {
    /// Returns a pass as evaluations have it.
    pub fn noiseless(rays: &'a Rays, samples: &'a PlacedSamples, background: Option<[f32; 3]>) -> Pass<'a> {
        Pass { rays, samples, density_noise: None, background, scales_gradients: false }
    }
}

/// Deltas of a perturbed pass, and how they are added.
#[derive(Clone, Copy)]
pub struct Perturbation<'a> {
    /// The deltas.
    pub deltas: &'a Deltas,
    /// Their sites and constraint sets. A delta without one is not added.
    pub sets: &'a Sets,
    /// Trunk layer (1-based) to which the feature delta is added.
    pub injection_layer: usize,
    /// Where the output deltas are added.
    pub output: OutputPlace,
}

impl Perturbation<'_> {
    /// Returns all that is added at a site of the paper.
    fn at(&self, site: PaperSite) -> Result<Option<Tensor>> {
        self.deltas.at(self.sets, site)
    }
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
    /// The deltas as they were used. A clean pass has none.
    pub used: UsedDeltas,
}

/// Renders one pass without deltas.
///
/// # Errors
/// Those of candle, if shapes do not fit.
pub fn clean_pass(field: &Field, pass: Pass) -> Result<PassOutput> {
    let (deltas, sets) = (Deltas::default(), Sets::default());
    let perturbation = Perturbation { deltas: &deltas, sets: &sets, injection_layer: 1, output: OutputPlace::After };
    perturbed_pass(field, pass, perturbation)
}

/// Renders one pass with deltas.
///
/// # Errors
/// Those of candle, if shapes do not fit.
pub fn perturbed_pass(field: &Field, pass: Pass, perturbation: Perturbation) -> Result<PassOutput> {
    let (t_vals, positions) = moved_samples(field, pass, perturbation)?;
    render_samples(pass, perturbation, &t_vals, &field.query_points(&positions, pass.samples.queried.as_ref())?)
}

/// Runs PGD ([`worst_case`]) from the deltas of `start`, on `sign` times the photometric loss against `target` `[rays, 3]`.
/// `field` must be frozen.
///
/// # Errors
/// Those of candle, if shapes do not fit.
pub fn search(field: &Field, pass: Pass, start: Perturbation, target: &Tensor, sign: f64) -> Result<Deltas> {
    // Once samples stay where they are, what depends on them alone is computed once for all further steps.
    let mut fixed_samples = None;
    worst_case(start.sets, start.deltas.clone(), |deltas, samples_stay| {
        let perturbation = Perturbation { deltas, ..start };
        if samples_stay && fixed_samples.is_none() {
            let (t_vals, positions) = moved_samples(field, pass, perturbation)?;
            fixed_samples =
                Some((t_vals, field.query_points(&positions.detach(), pass.samples.queried.as_ref())?.kept()));
        }
        let out = match &fixed_samples {
            Some((t_vals, points)) => render_samples(pass, perturbation, t_vals, points)?,
            None => perturbed_pass(field, pass, perturbation)?,
        };
        let loss = photometric_loss(&out.composite.rgb, target)?;
        Ok((if sign == 1.0 { loss } else { (loss * sign)? }, out.used.deltas))
    })
}

/// Returns the `t_vals` of a pass with the delta of `t`, and the positions there with that of `xyz`: points
/// `[rays * samples, 3]`, or Gaussians `[rays * samples, 6]` whose means move.
fn moved_samples(field: &Field, pass: Pass, perturbation: Perturbation) -> Result<(Tensor, Tensor)> {
    let t_vals = match perturbation.at(PaperSite::T)? {
        Some(delta) => (&pass.samples.t_vals + delta)?,
        None => pass.samples.t_vals.clone(),
    };
    let positions = positions_at(field, pass.rays, &t_vals)?;
    let positions = match perturbation.at(PaperSite::Xyz)? {
        Some(delta) if positions.dim(2)? > 3 => (positions + Tensor::cat(&[&delta, &delta.zeros_like()?], 2)?)?,
        Some(delta) => (positions + delta)?,
        None => positions,
    };
    Ok((t_vals, positions.flatten(0, 1)?))
}

/// Renders a pass with samples at `t_vals`, whose positions are `points`: adds the other sites' deltas to the direction, the
/// feature, and the colours and densities, which are then composited.
fn render_samples(pass: Pass, perturbation: Perturbation, t_vals: &Tensor, points: &QueryPoints) -> Result<PassOutput> {
    let (field, rays) = (points.field(), pass.rays);
    let viewdirs = match perturbation.at(PaperSite::View)? {
        Some(angles) => tilt(&rays.viewdirs, tangents(rays)?, &angles)?,
        None => rays.viewdirs.clone(),
    };
    let feature = perturbation.at(PaperSite::Feature)?.map(|delta| delta.flatten(0, 1)).transpose()?;
    let feature = feature.as_ref().map(|delta| FeatureDelta { layer: perturbation.injection_layer, delta });
    let RawOutput { rgb, density } = points.forward(&viewdirs, feature)?;
    let (n, samples) = (rays.len(), sample_count(field, t_vals)?);
    let mut raw = RawOutput { rgb: rgb.reshape((n, samples, 3))?, density: density.reshape((n, samples))? };
    if pass.scales_gradients {
        raw = near_scaled(raw, t_vals, &rays.direction_norm)?;
    }
    let mut used = UsedDeltas { deltas: perturbation.deltas.clone(), sets: perturbation.sets.clone() };
    let (rgb, density) = match perturbation.output {
        OutputPlace::After => {
            let (rgb, density) = activate(field, &raw, pass.density_noise)?;
            let range = |site| Some(output_range(site, field.config().rgb_padding));
            let rgb = used.add_to(rgb, PaperSite::Rgb, range(PaperSite::Rgb))?;
            let density = used.add_to(density, PaperSite::Density, range(PaperSite::Density))?;
            (rgb, only_queried(density, pass.samples.queried.as_ref())?)
        }
        OutputPlace::Before => {
            let rgb = used.add_to(raw.rgb.clone(), PaperSite::Rgb, None)?;
            let density = used.add_to(raw.density.clone(), PaperSite::Density, None)?;
            activate(field, &RawOutput { rgb, density }, pass.density_noise)?
        }
    };
    let composite = volume::composite(&rgb, &density, t_vals, &rays.direction_norm, pass.background)?;
    let (t_vals, raw_density) = (t_vals.detach(), raw.density.detach());
    Ok(PassOutput { composite, rgb, density, t_vals, raw_density, used })
}

/// Leaves what is empty without density, whatever its delta.
fn only_queried(density: Tensor, queried: Option<&Queried>) -> Result<Tensor> {
    let Some(queried) = queried else { return Ok(density) };
    let mask = queried.mask(&density)?.reshape(density.shape())?;
    Ok((density * mask)?)
}

fn tangents(rays: &Rays) -> Result<&[Tensor; 2]> {
    let missing = || candle_core::Error::Msg("these rays have no tangents to tilt them along".into());
    Ok(rays.tangents.as_ref().ok_or_else(missing)?)
}

/// Returns a pass's raw output with the gradients that [`Pass::scales_gradients`] asks for.
fn near_scaled(raw: RawOutput, t_vals: &Tensor, direction_norm: &Tensor) -> Result<RawOutput> {
    let (_, samples) = raw.density.dims2()?;
    let t_of_samples = volume::middles(t_vals, samples)?.detach();
    let scale = t_of_samples.broadcast_mul(direction_norm)?.sqr()?.minimum(1.0)?;
    // The value stays, to the bit.
    let scaled = |values: &Tensor, scale: &Tensor| -> Result<Tensor> {
        let product = values.broadcast_mul(scale)?;
        Ok((values.detach() + (&product - product.detach())?)?)
    };
    Ok(RawOutput { rgb: scaled(&raw.rgb, &scale.unsqueeze(2)?)?, density: scaled(&raw.density, &scale)? })
}

/// Returns colour and density of each sample: the field's activations of raw colour and of raw density with noise.
fn activate(field: &Field, raw: &RawOutput, density_noise: Option<&Tensor>) -> Result<(Tensor, Tensor)> {
    let rgb = field.activate_rgb(&raw.rgb)?;
    let density = match density_noise {
        Some(noise) => field.activate_density(&(&raw.density + noise)?)?,
        None => field.activate_density(&raw.density)?,
    };
    Ok((rgb, density))
}

/// Returns the accumulation of rays without density noise, `[rays]`, as in an evaluation: 1 - exp(-sum of density *
/// interval).
pub fn noiseless_acc(field: &Field, out: &PassOutput, pass: Pass) -> Result<Tensor> {
    if pass.density_noise.is_none() {
        return Ok(out.composite.acc.detach());
    }
    let intervals = volume::intervals(&pass.samples.t_vals, &pass.rays.direction_norm, out.raw_density.dim(1)?)?;
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
        let one_ray = |values: &[f64]| Tensor::new(values, &device).unwrap().reshape((1, ())).unwrap();
        let directions = Tensor::new(&[[0.0f64, 0.0, -2.0]], &device).unwrap();
        let rays = Rays::new(directions.zeros_like().unwrap(), directions.clone(), directions).unwrap();
        let t_vals = one_ray(&[0.25, 0.5, 2.0]);
        let density = Var::from_tensor(&one_ray(&[0.1, 0.7, 0.3])).unwrap();
        let rgb = Var::from_tensor(&Tensor::ones((1, 3, 3), DType::F64, &device).unwrap()).unwrap();
        let raw = RawOutput { rgb: rgb.as_tensor().clone(), density: density.as_tensor().clone() };
        let scaled = near_scaled(raw, &t_vals, &rays.direction_norm).unwrap();
        assert_eq!(scaled.density.to_vec2::<f64>().unwrap(), density.to_vec2::<f64>().unwrap());
        let sum = (scaled.density.sum_all().unwrap() + scaled.rgb.sum_all().unwrap()).unwrap();
        let gradients = sum.backward().unwrap();
        assert_eq!(gradients.get(&density).unwrap().to_vec2::<f64>().unwrap(), [[0.25, 1.0, 1.0]]);
        let rgb_gradient = gradients.get(&rgb).unwrap().to_vec3::<f64>().unwrap();
        assert_eq!(rgb_gradient[0], [[0.25; 3], [1.0; 3], [1.0; 3]]);
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
            let rendered = |raw: &Tensor| {
                let density = field.activate_density(raw).unwrap();
                volume::composite(&rgb, &density, &t_vals, &rays.direction_norm, None).unwrap()
            };
            let expected: Vec<f32> = rendered(&raw_density).acc.to_vec1().unwrap();
            let composite = rendered(&(&raw_density + &noise).unwrap());
            let (rgb, density) = (rgb.clone(), noise.clone());
            let out = PassOutput {
                composite,
                rgb,
                density,
                t_vals: t_vals.clone(),
                raw_density: raw_density.clone(),
                used: UsedDeltas::default(),
            };
            let samples = PlacedSamples::all(t_vals.clone());
            let pass = Pass { density_noise: Some(&noise), ..Pass::noiseless(&rays, &samples, None) };
            let noiseless: Vec<f32> = noiseless_acc(&field, &out, pass).unwrap().to_vec1().unwrap();
            let is_same = |(acc, expected): (&f32, &f32)| (acc - expected).abs() < 1e-6 && *acc > 0.0;
            assert!(noiseless.iter().zip(&expected).all(is_same), "{density_activation:?}: {noiseless:?} {expected:?}");
        }
    }
}
