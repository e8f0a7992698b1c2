//! Training of a neural volume: random rays of the training views through one decoded volume per step.

use candle_core::{DType, Device, Tensor};

use crate::base::Result;
use crate::base::rng::{Random, Stream};
use crate::data::{RayParts, Scene};
use crate::grids::march::{March, Pace};
use crate::grids::variation::log_variation;
use crate::methods::Batches;
use crate::methods::{Extremes, Learner, LogColumns, StepReport, StepResult, StopCheck, Term};
use crate::settings::Resolved;

use super::decoder::Decoded;
use super::parameters::NeuralVolume;

/// White, in the volume's colours.
pub(super) const WHITE: f64 = 255.0;
/// Divisor of colours before the original compares them.
pub(super) const DEVIATION: f64 = 25.0;

/// Trains the volume of one scene.
pub struct VolumeLearner {
    config: Resolved,
    volume: NeuralVolume,
    batches: Batches,
    background: [f32; 3],
    dtype: DType,
    device: Device,
}

/// The terms of a step's loss.
pub(super) struct Losses {
    /// Mean squared error of colours over 25.
    pub(super) image: Tensor,
    /// `log(0.1 + A) + log(1.1 - A) + 2.20727`, as a mean over rays.
    pub(super) alpha_prior: Tensor,
    /// Variation of the opacity's logarithm.
    pub(super) variation: Tensor,
    /// Divergence of the code's distribution from the standard normal one, as a mean over its numbers.
    pub(super) divergence: Option<Tensor>,
    /// Accumulations of the rays, `[rays, 1]`.
    pub(super) acc: Tensor,
    /// Their colours, 0..255, `[rays, 3]`.
    pub(super) rgb: Tensor,
}

impl VolumeLearner {
    /// Creates a learner of `volume` on the training views of `scene`.
    ///
    /// # Errors
    /// If batches are larger than the training views allow.
    pub fn new(
        config: &Resolved,
        scene: &Scene,
        volume: NeuralVolume,
        dtype: DType,
        device: &Device,
    ) -> Result<VolumeLearner> {
        Ok(VolumeLearner {
            batches: Batches::new(config, scene, RayParts::default())?,
            config: config.clone(),
            volume,
            background: scene.background.unwrap_or_default(),
            dtype,
            device: device.clone(),
        })
    }

    /// Returns the code that a step decodes, and its divergence if it has a distribution.
    fn draw_code(&self, step: u64) -> Result<(Tensor, Option<Tensor>)> {
        let (mean, log_deviation) = self.volume.code();
        let Some(log_deviation) = log_deviation else { return Ok((mean, None)) };
        let mut random = Random::new(self.config.seed, Stream::Code, step);
        let noise = random.normal_tensor(mean.dims(), self.dtype, &self.device)?;
        Ok((drawn(&mean, &log_deviation, &noise)?, Some(divergence(&mean, &log_deviation)?)))
    }

    fn losses(&self, decoded: &Decoded, march: &March, target: &Tensor) -> Result<Losses> {
        let background = Tensor::new(&self.background, &self.device)?.to_dtype(self.dtype)?;
        losses(decoded, march, &(background * WHITE)?, &(target * WHITE)?)
    }
}

/// Returns a code of the distribution.
pub(super) fn drawn(mean: &Tensor, log_deviation: &Tensor, noise: &Tensor) -> Result<Tensor> {
    Ok((mean + (log_deviation.exp()? * noise)?)?)
}

/// Returns the mean over the code's numbers of the Kullback-Leibler divergence from the standard normal distribution.
pub(super) fn divergence(mean: &Tensor, log_deviation: &Tensor) -> Result<Tensor> {
    let squares = ((mean.sqr()? + (log_deviation * 2.0)?.exp()?)? * 0.5)?;
    Ok(((squares - log_deviation)? - 0.5)?.mean_all()?)
}

/// Returns the terms of rays with `target` colours over a `background`, one per ray or one for all, both 0..255.
pub(super) fn losses(decoded: &Decoded, march: &March, background: &Tensor, target: &Tensor) -> Result<Losses> {
    let out = march.forward(&decoded.template, decoded.warp.as_ref())?;
    let acc = out.narrow(1, 3, 1)?;
    let behind = (1.0 - &acc)?.broadcast_mul(background)?;
    let rgb = (out.narrow(1, 0, 3)? + behind)?;
    let prior = ((&acc + 0.1)?.log()? + (1.1 - &acc)?.log()?)?;
    Ok(Losses {
        image: ((&rgb - target)? / DEVIATION)?.sqr()?.mean_all()?,
        alpha_prior: (prior.mean_all()? + 2.20727)?,
        variation: log_variation(&decoded.template)?,
        divergence: None,
        acc,
        rgb,
    })
}

fn number(tensor: &Tensor) -> Result<f64> {
    Ok(tensor.to_dtype(DType::F64)?.to_scalar::<f64>()?)
}

impl Learner for VolumeLearner {
    fn columns(&self) -> LogColumns {
        let mut further = vec!["loss_accumulation".to_string(), "loss_variation".into()];
        if self.volume.code().1.is_some() {
            further.push("loss_code".into());
        }
        further.push("mean_acc".into());
        LogColumns { photometric: vec!["loss_image".into()], further }
    }

    fn step(&mut self, step: u64, _log: bool, stop_check: &StopCheck) -> Result<StepResult> {
        let batch = self.batches.batch(step);
        let rays = batch.rays.to_tensors(self.dtype, &self.device)?;
        let target = Tensor::from_vec(batch.target, (rays.len(), 3), &self.device)?.to_dtype(self.dtype)?;
        let nv = &self.config.nv;
        let march = March {
            lines: self.volume.cube.lines(&rays.origins, &rays.viewdirs)?,
            step: nv.step_length(),
            pace: Pace::Drawn { jitter: nv.step_jitter, seed: self.config.seed, step },
        };
        let (code, divergence) = self.draw_code(step)?;
        let decoded = self.volume.decode(&code, false)?;
        stop_check()?;
        let losses = Losses { divergence, ..self.losses(&decoded, &march, &target)? };
        let term = |name: &str, described: &str, value: &Tensor, weight: f64| -> Result<Term> {
            Ok(Term { name: name.into(), described: described.into(), value: number(value)?, weight })
        };
        let mut parts = vec![
            (term("loss_image", "loss of the colours", &losses.image, 1.0)?, &losses.image),
            (
                term("loss_accumulation", "prior of accumulations", &losses.alpha_prior, nv.alpha_prior)?,
                &losses.alpha_prior,
            ),
            (term("loss_variation", "variation of the opacity", &losses.variation, nv.tv)?, &losses.variation),
        ];
        if let Some(divergence) = &losses.divergence {
            parts.push((term("loss_code", "divergence of the code", divergence, nv.kl)?, divergence));
        }
        let mut total = losses.image.clone();
        for (Term { weight, .. }, tensor) in &parts[1..] {
            if *weight > 0.0 {
                total = (total + (*tensor * *weight)?)?;
            }
        }
        stop_check()?;
        let gradients = self.volume.parameters.gradients(&total)?;
        let mut terms: Vec<Term> = parts.into_iter().map(|(term, _)| term).collect();
        let loss = terms.iter().map(|term| term.value * term.weight).sum();
        let mse = terms[0].value * (DEVIATION / WHITE).powi(2);
        // With a plain background, volumes first become empty, and may stay so. This is a diagnostic, not part of the
        // loss.
        terms.push(term("mean_acc", "mean accumulation", &losses.acc.mean_all()?, 0.0)?);
        let extremes = Extremes::of(&losses.acc, &(losses.rgb / WHITE)?, &target)?;
        let report = StepReport::new(terms, loss, mse, extremes);
        Ok(StepResult { gradients, report })
    }
}
