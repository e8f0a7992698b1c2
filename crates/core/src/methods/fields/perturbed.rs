//! The second pass of a step: perturbed passes with their sets, search and gradients, or another clean pass.

use candle_core::{DType, Tensor};

use crate::base::Result;
use crate::base::rng::{Random, Stream};
use crate::field::Field;
use crate::methods::gradients::Gradients;
use crate::perturb::{Deltas, Draw, PaperSite, Sets, SiteSet, UsedDeltas, worst_case};
use crate::render::{
    FixedSamples, Pass, PassLoss, Perturbation, PerturbedOutput, perturbed_pass, perturbed_pass_loss, photometric_loss,
    resample, samples_of,
};
use crate::settings::{DeltaSource, Resample, SecondPass};

use super::chunk::Chunk;
use super::learner::FieldLearner;
use super::networks::Fields;
use super::report::coarse_weight;
use super::results::ChunkResult;
use super::terms::StepLoss;
use crate::methods::diagnostics::{SiteEffect, Sums, colour_shift};

/// One perturbed pass of a chunk: its field, samples and sets.
struct PerturbedPass<'a> {
    field: &'a Field,
    pass: Pass<'a>,
    target: &'a Tensor,
    sets: Sets,
    /// Fraction of the step's rays.
    share: f64,
    /// Weight of the pass's loss relative to the other pass's.
    loss_weight: f64,
    /// Steps finished before this one.
    step: u64,
    /// Number of the pass within the step. Each pass has its own random numbers.
    number: u64,
}

impl FieldLearner {
    /// Runs the second pass of a chunk whose clean fine pass had its samples at `t_fine`, and adds its gradients.
    /// Returns its loss, coarse + fine, weighted with the chunk's fraction.
    pub(super) fn second_pass(
        &self,
        fields: &Fields,
        chunk: &Chunk,
        t_fine: Option<&Tensor>,
        weight: f64,
        result: &mut ChunkResult,
    ) -> Result<Tensor> {
        match self.config.perturb.second {
            SecondPass::Clean => self.second_clean(fields, chunk, weight, &mut result.gradients),
            SecondPass::Perturbed(source) => self.perturbed(source, fields, chunk, t_fine, weight, result),
        }
    }

    /// Runs the control: another clean pass with its own jitter, noise and samples.
    fn second_clean(&self, fields: &Fields, chunk: &Chunk, weight: f64, gradients: &mut Gradients) -> Result<Tensor> {
        let mut random = Random::part(self.config.seed, Stream::Search, chunk.step, chunk.index);
        let drawn = self.draw_clean(chunk.rays.clone(), chunk.target.clone(), chunk.step, &mut random)?;
        let fresh = Chunk { share: chunk.share, ..drawn };
        let mut second = ChunkResult::new(gradients.0.len());
        // Terms on rays count in the first clean pass only.
        let alone = StepLoss { clean: weight, ..self.step_loss(&[], chunk.step) };
        self.clean(fields, &fresh, alone, &mut second)?;
        gradients.merge(second.gradients)?;
        Ok(second.losses.clean(coarse_weight(&self.config))?.expect("every chunk has a clean pass"))
    }

    /// Runs the perturbed passes of a chunk on the clean pass's samples.
    fn perturbed(
        &self,
        source: DeltaSource,
        fields: &Fields,
        chunk: &Chunk,
        t_fine: Option<&Tensor>,
        weight: f64,
        result: &mut ChunkResult,
    ) -> Result<Tensor> {
        let adversarial = fields.adversarial.as_ref();
        let own = adversarial.unwrap_or(&fields.coarse);
        let coarse = if self.has_coarse_loss() {
            let coarse = self.perturbed_pass(chunk, own, self.coarse_pass(chunk), true)?;
            let coarse = PerturbedPass { loss_weight: coarse_weight(&self.config), ..coarse };
            Some(self.descend_perturbed(source, &coarse, weight, result)?)
        } else {
            None
        };
        let fine = fields.fine().zip(t_fine).zip(chunk.u.as_ref());
        let Some(((field, t_fine), u)) = fine else { return Ok(coarse.expect("one of the passes is evaluated").0) };
        let resampled;
        let t_vals = match (self.config.perturb.resample, &coarse) {
            (Resample::Perturbed, Some((_, out))) => {
                resampled = resample(own, &self.config.sampling, &out.t_vals, &out.composite.weights, u)?;
                &resampled
            }
            _ => t_fine,
        };
        let fine = self.perturbed_pass(chunk, adversarial.unwrap_or(field), self.fine_pass(chunk, t_vals), false)?;
        let (loss, _) = self.descend_perturbed(source, &fine, weight, result)?;
        Ok(match coarse {
            Some((coarse, _)) => (coarse + loss)?,
            None => loss,
        })
    }

    fn perturbed_pass<'a>(
        &self,
        chunk: &'a Chunk,
        field: &'a Field,
        pass: Pass<'a>,
        is_coarse: bool,
    ) -> Result<PerturbedPass<'a>> {
        let samples = samples_of(field, pass.t_vals)?;
        let geometry = self.geometry.pass(pass.t_vals, samples, &pass.rays.direction_norm, is_coarse)?;
        let sites = self.config.perturb.sites_of_pass(is_coarse).into_iter().chain(self.own_sites.iter().cloned());
        let sets = Sets::new(sites, &geometry)?;
        Ok(PerturbedPass {
            field,
            pass,
            target: chunk.photographed(),
            sets,
            share: chunk.share,
            loss_weight: 1.0,
            step: chunk.step,
            number: 2 * chunk.index + u64::from(is_coarse),
        })
    }

    /// Finds the deltas of a pass, and adds the gradients of its loss. Returns the loss weighted with its fraction.
    fn descend_perturbed(
        &self,
        source: DeltaSource,
        pass: &PerturbedPass,
        weight: f64,
        result: &mut ChunkResult,
    ) -> Result<(Tensor, PassLoss)> {
        let deltas = self.find_deltas(source, pass)?;
        let perturbation = self.perturbation(pass, &deltas);
        let out = match &mut result.diagnostics {
            Some(sums) => {
                let PerturbedOutput { pass: out, used } = perturbed_pass(pass.field, pass.pass, perturbation)?;
                self.diagnose(pass, &used, sums)?;
                PassLoss::of(out, pass.target)?
            }
            None => perturbed_pass_loss(pass.field, pass.pass, perturbation, pass.target)?.0,
        };
        let share = pass.share * pass.loss_weight;
        let loss = self.descend(&out.loss, weight * share, &mut result.gradients)?;
        Ok(((loss * share)?, out))
    }

    fn perturbation<'a>(&self, pass: &'a PerturbedPass, deltas: &'a Deltas) -> Perturbation<'a> {
        let perturb = &self.config.perturb;
        Perturbation { deltas, sets: &pass.sets, injection_layer: perturb.injection_layer, output: perturb.output }
    }

    /// Returns a random point of every set of a pass. Each site has its own numbers of `stream`.
    fn draw_deltas(&self, pass: &PerturbedPass, draw: Draw, stream: Stream) -> Result<Deltas> {
        let random = |part| Random::part(self.config.seed, stream, pass.step, part);
        pass.sets.draw(draw, pass.number, random)
    }

    /// Returns random or worst-case deltas, detached.
    fn find_deltas(&self, source: DeltaSource, pass: &PerturbedPass) -> Result<Deltas> {
        match source {
            DeltaSource::Gaussian => self.draw_deltas(pass, Draw::Gaussian, Stream::Search),
            DeltaSource::Uniform => self.draw_deltas(pass, Draw::Uniform, Stream::Search),
            DeltaSource::WorstCase => self.search(pass, 1.0),
            DeltaSource::BestCase => self.search(pass, -1.0),
            DeltaSource::Permuted => self.permute(pass, self.search(pass, 1.0)?),
        }
    }

    /// Gives each ray of a pass the deltas of another one, as far as its own sets allow.
    fn permute(&self, pass: &PerturbedPass, deltas: Deltas) -> Result<Deltas> {
        let rays = pass.pass.rays.len();
        let mut random = Random::part(self.config.seed, Stream::Permutation, pass.step, pass.number);
        // A random circle, on which each ray takes the deltas of the next one.
        let circle = random.distinct(rays, rays as u32);
        let mut order = vec![0u32; rays];
        (0..rays).for_each(|i| order[circle[i] as usize] = circle[(i + 1) % rays]);
        let order = Tensor::from_vec(order, rays, &self.device)?;
        let mut permuted = Deltas::default();
        for SiteSet { site, set } in pass.sets.iter() {
            if let Some(delta) = deltas.get(site.name()) {
                permuted.set(site.name(), set.project(&delta.detach().contiguous()?.index_select(&order, 0)?)?);
            }
        }
        Ok(permuted)
    }

    /// Runs PGD from a random start, on the loss times `sign`.
    fn search(&self, pass: &PerturbedPass, sign: f64) -> Result<Deltas> {
        let start = self.draw_deltas(pass, Draw::Uniform, Stream::Search)?;
        let field = pass.field.frozen()?;
        // Scaled gradients are for parameters, not for deltas.
        let clean = Pass { scales_gradients: false, ..pass.pass };
        let mut fixed = None;
        worst_case(&pass.sets, start, |at| {
            let perturbation = self.perturbation(pass, at.deltas);
            if fixed.is_none() && at.fixes_samples() {
                fixed = Some(FixedSamples::new(&field, clean, perturbation)?);
            }
            let (out, used) = match &fixed {
                Some(fixed) => fixed.perturbed_pass_loss(perturbation, pass.target)?,
                None => perturbed_pass_loss(&field, clean, perturbation, pass.target)?,
            };
            let loss = if sign == 1.0 { out.loss } else { (out.loss * sign)? };
            Ok((loss, used))
        })
    }

    /// Measures each site of a perturbed pass separately: with the deltas that it used, and with random ones.
    fn diagnose(&self, pass: &PerturbedPass, used: &UsedDeltas, sums: &mut Sums) -> Result<()> {
        let drawn = self.draw_deltas(pass, Draw::Uniform, Stream::Diagnostics)?;
        let share = pass.share;
        let frozen = pass.field.frozen()?;
        // The loss, with its weight in the pass, and the rays' colours.
        let render = |deltas: &Deltas| -> Result<(f64, Tensor)> {
            let rgb = perturbed_pass(&frozen, pass.pass, self.perturbation(pass, deltas))?.pass.composite.rgb;
            Ok((pass.loss_weight * scalar(&photometric_loss(&rgb, pass.target)?)?, rgb))
        };
        let (without, unmoved) = render(&Deltas::default())?;
        let on = self.config.perturb.numbers.iter().filter(|(_, numbers)| numbers.on()).map(|(site, _)| site.name());
        for name in on.chain(self.own_sites.iter().map(|site| site.name())) {
            let (Some(set), Some(delta)) = (used.sets.get(name), used.deltas.get(name)) else {
                // Switched on with a set of size 0: there is no perturbation, and no gain.
                if PaperSite::of_name(name).is_some_and(|site| !self.config.perturb.numbers[site].perturbs()) {
                    sums.add(name, SiteEffect { share, ..SiteEffect::default() });
                }
                continue;
            };
            let at_bound = set.share_at_bound(delta)?;
            let ((with, moved), (with_random, _)) = (render(&used.deltas.only(name))?, render(&drawn.only(name))?);
            let shift = colour_shift(&moved, &unmoved)?;
            let (gain, gain_over_random) = (with - without, with - with_random);
            sums.add(name, SiteEffect { share, gain, gain_over_random, shift, at_bound });
        }
        Ok(())
    }
}

fn scalar(tensor: &Tensor) -> Result<f64> {
    Ok(tensor.to_dtype(DType::F64)?.to_scalar()?)
}
