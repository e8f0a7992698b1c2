//! The perturbed pass of a step: sets, search, descent; or its control.

use std::cell::RefCell;

use candle_core::{DType, Tensor, TensorId};

use crate::augment::{Deltas, Draw, PassGeometry, Sets, StepSizes, worst_case};
use crate::base::Result;
use crate::base::rng::{Random, Stream};
use crate::field::Field;
use crate::methods::gradients::Gradients;
use crate::render::{
    Pass, PassOutput, Perturbation, columns, moved_positions, perturbed_pass, photometric_loss, resample, samples_of,
};
use crate::settings::{LEVELS, Level, PerturbConfig, PerturbKind, Resample};

use super::chunk::Chunk;
use super::learner::FieldLearner;
use super::networks::Fields;
use super::results::ChunkResult;
use super::terms::StepLoss;
use crate::methods::diagnostics::Sums;

/// One perturbed pass of a chunk: which field, which samples, which sets.
#[derive(Clone)]
pub(super) struct Perturbed<'a> {
    pub(super) field: &'a Field,
    pub(super) pass: Pass<'a>,
    pub(super) target: &'a Tensor,
    pub(super) sets: Sets,
    /// Share of the step's rays.
    pub(super) share: f64,
    /// Weight of the pass's loss beside the other pass's.
    pub(super) loss_weight: f64,
    /// Steps finished before this one.
    step: u64,
    /// Number of the pass within the step: its random numbers are its own.
    number: u64,
}

impl FieldLearner {
    /// The control: another clean pass with its own jitter, noise and samples. Returns its loss,
    /// weighted with the chunk's share.
    pub(super) fn second_clean(
        &self,
        model: &Fields,
        chunk: &Chunk,
        weight: f64,
        gradients: &mut Gradients,
    ) -> Result<Tensor> {
        let mut random = Random::part(self.config.seed, Stream::Attack, chunk.step, chunk.index);
        let drawn = self.draw_clean(chunk.rays.clone(), chunk.target.clone(), chunk.step, &mut random)?;
        let fresh = Chunk { share: chunk.share, ..drawn };
        let mut second = ChunkResult::new(gradients.0.len());
        // Terms on rays count in the first clean pass alone.
        let alone = StepLoss { clean: weight, terms: &[], ..self.step_loss() };
        self.clean(model, &fresh, alone, &mut second)?;
        gradients.merge(second.gradients)?;
        Ok(second.losses.clean(self.coarse_weight(model))?.expect("every chunk has a coarse pass"))
    }

    /// Searches and descends the perturbed passes of a chunk on the clean pass's samples. Returns
    /// their loss, coarse + fine, weighted with the chunk's share.
    pub(super) fn perturbed(
        &self,
        model: &Fields,
        chunk: &Chunk,
        t_fine: Option<&Tensor>,
        weight: f64,
        (result, log): (&mut ChunkResult, bool),
    ) -> Result<Tensor> {
        let adversarial = model.adversarial.as_ref();
        let own = adversarial.unwrap_or(&model.coarse);
        let coarse = self.perturbed_pass(chunk, own, self.coarse_pass(chunk), true)?;
        let coarse = Perturbed { loss_weight: self.coarse_weight(model), ..coarse };
        let (loss, out) = self.attack(&coarse, weight, result, log)?;
        let (Some(field), Some(t_fine), Some(u)) = (model.fine(), t_fine, &chunk.u) else { return Ok(loss) };
        let resampled;
        let t_vals = match self.config.perturb.resample {
            Resample::Clean => t_fine,
            Resample::Perturbed => {
                resampled = resample(own, &self.config.sampling, &out.t_vals, &out.composite.weights, u)?;
                &resampled
            }
        };
        let fine = self.perturbed_pass(chunk, adversarial.unwrap_or(field), self.fine_pass(chunk, t_vals), false)?;
        Ok((loss + self.attack(&fine, weight, result, log)?.0)?)
    }

    fn perturbed_pass<'a>(
        &'a self,
        chunk: &'a Chunk,
        field: &'a Field,
        pass: Pass<'a>,
        is_coarse: bool,
    ) -> Result<Perturbed<'a>> {
        let geometry = PassGeometry {
            is_coarse,
            t_vals: pass.t_vals,
            samples: samples_of(field, pass.t_vals)?,
            direction_norm: &pass.rays.direction_norm,
            bounds: self.bounds,
            coarse_samples: columns(field, &self.config.sampling).0,
            width: self.config.field.width,
            pixel: self.pixel,
        };
        Ok(Perturbed {
            field,
            pass,
            target: &chunk.target,
            sets: Sets::new(&self.config.perturb, &geometry)?,
            share: chunk.share,
            loss_weight: 1.0,
            step: chunk.step,
            number: 2 * chunk.index + u64::from(is_coarse),
        })
    }

    /// Finds the deltas of a pass and descends its loss, which is returned weighted with its share.
    fn attack(
        &self,
        passing: &Perturbed,
        weight: f64,
        result: &mut ChunkResult,
        log: bool,
    ) -> Result<(Tensor, PassOutput)> {
        let random = |stream: Stream| {
            move |level: Level| Random::part(self.config.seed, stream, passing.step, 8 * passing.number + level as u64)
        };
        let deltas = self.find_deltas(passing, random(Stream::Attack))?;
        let out = self.run(passing, passing.field, &deltas)?;
        let share = passing.share * passing.loss_weight;
        let loss = self.descend(&out, passing.target, weight * share, &mut result.gradients)?;
        if log {
            let drawn = passing.sets.draw(Draw::Uniform, random(Stream::Diagnostics))?;
            self.diagnose(passing, &out, &drawn, &mut result.diagnostics)?;
        }
        Ok(((loss * share)?, out))
    }

    /// The pass with `deltas` through `field` (live or frozen).
    pub(super) fn run(&self, passing: &Perturbed, field: &Field, deltas: &Deltas) -> Result<PassOutput> {
        let PerturbConfig { injection_layer, output, .. } = *self.config.perturb;
        perturbed_pass(field, passing.pass, Perturbation { deltas, sets: &passing.sets, injection_layer, output })
    }

    /// Random or worst-case deltas, detached.
    fn find_deltas(&self, passing: &Perturbed, random: impl Fn(Level) -> Random) -> Result<Deltas> {
        match self.config.perturb.kind {
            PerturbKind::Gaussian => return passing.sets.draw(Draw::Gaussian, random),
            PerturbKind::Uniform => return passing.sets.draw(Draw::Uniform, random),
            PerturbKind::WorstCase | PerturbKind::FreshJitter => {}
        }
        let start = passing.sets.draw(Draw::Uniform, random)?;
        let field = passing.field.searching()?;
        // Points that do not move any more stay the same tensor: the field computes what depends on them alone once.
        let known: RefCell<Option<([Option<TensorId>; 2], Tensor)>> = RefCell::default();
        let positions_of = |deltas: &Deltas| -> Result<Tensor> {
            let moved_by = [Level::T, Level::Xyz].map(|level| deltas.get(level).map(Tensor::id));
            let same = known.borrow().as_ref().filter(|(by, _)| *by == moved_by).map(|(_, known)| known.clone());
            let positions = same.map_or_else(|| moved_positions(&field, passing.pass, deltas), Ok)?;
            known.replace(Some((moved_by, positions.clone())));
            Ok(positions)
        };
        worst_case(&passing.sets, &StepSizes::new(&self.config.perturb), start, |deltas| {
            let positions = positions_of(deltas)?;
            let still = Perturbed { pass: Pass { positions: Some(&positions), ..passing.pass }, ..passing.clone() };
            let out = self.run(&still, &field, deltas)?;
            Ok((photometric_loss(&out.composite.rgb, passing.target)?, out.used))
        })
    }

    /// Measures each level of a perturbed pass by itself: with the deltas that it used, and with
    /// the random ones in `drawn`.
    fn diagnose(&self, passing: &Perturbed, out: &PassOutput, drawn: &Deltas, sums: &mut Sums) -> Result<()> {
        let share = passing.share;
        let frozen = passing.field.frozen()?;
        let loss = |deltas: &Deltas| -> Result<f64> {
            let out = self.run(passing, &frozen, deltas)?;
            Ok(passing.loss_weight * scalar(&photometric_loss(&out.composite.rgb, passing.target)?)?)
        };
        let without = loss(&Deltas::default())?;
        for level in LEVELS {
            let (Some(set), Some(used)) = (out.sets.get(level), out.used.get(level)) else {
                // Switched on with a set of size 0: there is no perturbation, and no gain.
                if self.config.perturb.delta(level).on() && self.config.perturb.delta(level).epsilon == 0.0 {
                    sums.add(level, share, 0.0, 0.0, None);
                }
                continue;
            };
            let with = loss(&out.used.only(level))?;
            let with_random = loss(&drawn.only(level))?;
            sums.add(level, share, with - without, with - with_random, set.share_at_bound(used)?);
        }
        Ok(())
    }
}

fn scalar(tensor: &Tensor) -> Result<f64> {
    Ok(tensor.to_dtype(DType::F64)?.to_scalar()?)
}
