//! Passes with their photometric loss. After the field they use the fused operation if it supports the pass.

use candle_core::{D, DType, Tensor};

use crate::base::Result;
use crate::base::tensors::with_values;
use crate::field::{Field, density_of};
use crate::perturb::settings::OutputPlace;
use crate::perturb::{Deltas, PaperSite};

use super::fused_loss::{Samples, ShadedLoss};
use super::pass::{Pass, PassOutput, activate, clean_raw, finish};
use super::perturbed::{FixedSamples, Perturbation, PerturbedOutput, Queried, query};
use super::photometric_loss;
use super::volume::{self, Composite, LAST_INTERVAL};
use augnerf_fast::scan::Scan;

/// A pass with its photometric loss. Only the loss must have a graph.
pub struct PassLoss {
    /// [`photometric_loss`] of the pass's colours, a scalar with its graph.
    pub loss: Tensor,
    /// Colour, depth, accumulation, weights.
    pub composite: Composite,
    /// Positions, as in [`PassOutput`].
    pub t_vals: Tensor,
    /// Raw density, as in [`PassOutput`].
    pub raw_density: Tensor,
}

impl PassLoss {
    /// Returns the loss of a pass with a full graph, whose colours should be `target` `[rays, 3]`.
    pub fn of(out: PassOutput, target: &Tensor) -> Result<PassLoss> {
        let loss = photometric_loss(&out.composite.rgb, target)?;
        Ok(PassLoss { loss, composite: out.composite, t_vals: out.t_vals, raw_density: out.raw_density })
    }
}

/// Runs [`super::clean_pass`] and returns its loss against `target` `[rays, 3]`.
pub fn clean_pass_loss(field: &Field, pass: Pass, target: &Tensor) -> Result<PassLoss> {
    let raw = clean_raw(field, pass)?;
    let samples = Samples { field, pass, t_vals: pass.t_vals, raw: &raw, added: None };
    if let Some(shaded) = samples.fused_loss(target)? {
        return Ok(pass_of(shaded, samples).0);
    }
    PassLoss::of(finish(pass, pass.t_vals, &raw, activate(field, &raw, pass.density_noise)?)?, target)
}

/// Runs [`super::perturbed_pass`] and returns its loss against `target` `[rays, 3]`, and the deltas as they were used.
///
/// # Errors
/// Those of candle, if shapes do not fit.
pub fn perturbed_pass_loss(
    field: &Field,
    pass: Pass,
    perturbation: Perturbation,
    target: &Tensor,
) -> Result<(PassLoss, Deltas)> {
    loss_of(query(field, pass, perturbation)?, target)
}

impl FixedSamples<'_> {
    /// Runs [`perturbed_pass_loss`] on these samples.
    ///
    /// # Errors
    /// Those of candle, if shapes do not fit.
    pub fn perturbed_pass_loss(&self, perturbation: Perturbation, target: &Tensor) -> Result<(PassLoss, Deltas)> {
        loss_of(self.query(perturbation)?, target)
    }
}

fn loss_of(queried: Queried, target: &Tensor) -> Result<(PassLoss, Deltas)> {
    let Queried { field, pass, t_vals, perturbation: Perturbation { deltas, sets, output, .. }, raw } = &queried;
    if *output == OutputPlace::After {
        let samples = Samples { field, pass: *pass, t_vals, raw, added: Some((deltas, sets)) };
        if let Some(shaded) = samples.fused_loss(target)? {
            let (pass, used) = pass_of(shaded, samples);
            let mut deltas = (*deltas).clone();
            used.into_iter().for_each(|(site, delta)| deltas.set(site, delta));
            return Ok((pass, deltas));
        }
    }
    let PerturbedOutput { pass, used } = queried.finish()?;
    Ok((PassLoss::of(pass, target)?, used.deltas))
}

fn pass_of(ShadedLoss { loss, composite, used }: ShadedLoss, samples: Samples) -> (PassLoss, Vec<(PaperSite, Tensor)>) {
    let (t_vals, raw_density) = (samples.t_vals.detach(), samples.raw.density.detach());
    (PassLoss { loss, composite, t_vals, raw_density }, used)
}

/// Returns the accumulation of rays without density noise, `[rays]`, as in an evaluation.
pub fn noiseless_acc(field: &Field, out: &PassLoss, pass: Pass) -> Result<Tensor> {
    if pass.density_noise.is_none() {
        return Ok(out.composite.acc.detach());
    }
    let direction_norm: Vec<f64> = pass.rays.direction_norm.to_dtype(DType::F64)?.flatten_all()?.to_vec1()?;
    let activation = field.config().density_activation;
    let accumulate = |raw: &[f32], t_vals: &[f32]| {
        let density: Vec<f32> = raw.iter().map(|&raw| density_of(activation, raw)).collect();
        Scan { direction_norm, last_interval: LAST_INTERVAL, background: None }.accumulations(&density, t_vals)
    };
    let acc = with_values(&out.raw_density, |raw| with_values(pass.t_vals, |t_vals| accumulate(raw, t_vals))).flatten();
    match acc {
        Some(acc) => Ok(Tensor::from_vec(acc, pass.rays.len(), out.raw_density.device())?),
        None => noiseless_acc_reference(field, out, pass),
    }
}

/// The same in tensor operations.
fn noiseless_acc_reference(field: &Field, out: &PassLoss, pass: Pass) -> Result<Tensor> {
    let intervals = volume::intervals(pass.t_vals, &pass.rays.direction_norm, out.raw_density.dim(1)?)?;
    Ok(volume::weights_from_density(&field.activate_density(&out.raw_density)?, &intervals)?.sum(D::Minus1)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::rng::{Random, Stream};
    use crate::data::Rays;
    use crate::field::settings::{DensityActivation, FieldConfig};
    use candle_core::Device;

    #[test]
    fn noise_is_left_out_of_accumulations() {
        let draw = |index: u64, shape: &[usize]| {
            Random::new(index, Stream::Init, 0).uniform_tensor(shape, DType::F32, &Device::Cpu).unwrap()
        };
        let rays = Rays::new(draw(1, &[4, 3]), draw(2, &[4, 3]), draw(3, &[4, 3])).unwrap();
        let (raw_density, noise) = ((draw(4, &[4, 6]) - 0.4).unwrap(), draw(5, &[4, 6]));
        use DensityActivation::{Exp, Relu, Softplus};
        for (activation, columns) in [(Relu, 6), (Softplus, 7), (Exp, 6)] {
            let config = FieldConfig { width: 8, density_activation: activation, ..FieldConfig::default() };
            let field = Field::init(&config, 0, 0, DType::F32, &Device::Cpu).unwrap();
            let t_vals = draw(6, &[4, columns]).cumsum(1).unwrap().contiguous().unwrap();
            let none = draw(7, &[4]);
            let composite =
                Composite { rgb: none.clone(), depth: none.clone(), acc: none.clone(), weights: none.clone() };
            let out = PassLoss { loss: none, composite, t_vals: t_vals.clone(), raw_density: raw_density.clone() };
            let pass = Pass {
                rays: &rays,
                t_vals: &t_vals,
                density_noise: Some(&noise),
                background: None,
                scales_gradients: false,
            };
            let found = noiseless_acc(&field, &out, pass).unwrap().to_vec1::<f32>().unwrap();
            let expected = noiseless_acc_reference(&field, &out, pass).unwrap().to_vec1::<f32>().unwrap();
            for (found, expected) in found.iter().zip(&expected) {
                assert!((found - expected).abs() < 1e-6 && *found > 0.0, "{activation:?}: {found} {expected}");
            }
        }
    }
}
