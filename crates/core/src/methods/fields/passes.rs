//! The passes of a step over its rays, chunk by chunk.

use candle_core::{DType, Tensor};

use crate::base::Result;
use crate::field::Field;
use crate::methods::Extremes;
use crate::methods::diagnostics::Sums;
use crate::methods::gradients::Gradients;
use crate::methods::learner::StopCheck;
use crate::render::{Pass, noiseless_acc, place, resample};
use crate::runtime::over_parts;

use super::chunk::Chunk;
use super::learner::FieldLearner;
use super::networks::Fields;
use super::report::coarse_weight;
use super::results::ChunkResult;
use super::terms::{Counts, StepLoss};

/// Number of parts of a step, which threads share. Each sums its gradients in place.
const PARTS: usize = 16;

/// Returns the number of parts of a step with this many chunks.
pub fn parts(chunks: usize) -> usize {
    chunks.div_ceil(chunks.div_ceil(PARTS).max(1))
}

impl FieldLearner {
    /// Runs all passes over the rays of a step, chunk by chunk.
    pub(super) fn passes(
        &self,
        whole: &Chunk,
        step_loss: StepLoss,
        log: bool,
        stop_check: &StopCheck,
    ) -> Result<ChunkResult> {
        // Rays that belong together stay together.
        let together = step_loss.group().rays();
        let size = (self.config.train.chunk / together).max(1) * together;
        let starts: Vec<(usize, usize)> = (0..whole.rays.len()).step_by(size).enumerate().collect();
        let prepared = self.fields.prepared()?;
        let work = |part: &[(usize, usize)]| -> Result<ChunkResult> {
            let fields = prepared.recording()?;
            let mut sum: Option<ChunkResult> = None;
            for &(index, start) in part {
                stop_check()?;
                let count = size.min(whole.rays.len() - start);
                let chunk = self.work(&fields, &whole.narrow(index, start, count)?, step_loss, self.empty(log))?;
                match &mut sum {
                    Some(sum) => sum.add(chunk)?,
                    None => sum = Some(chunk),
                }
            }
            let mut sum = sum.expect("a part has chunks");
            sum.gradients.merge(Gradients(fields.recorded()?))?;
            sum.tables = fields.table_records();
            Ok(sum)
        };
        // One thread per part, so that a chunk's tensors stay in its core's cache. Parts do not depend on the number of
        // threads, and the sums below are in their order. The bits are always the same.
        let parts = over_parts(&self.device, &starts, starts.len().div_ceil(PARTS), work)?;
        let mut sum = ChunkResult::sum(parts)?;
        let tables = std::mem::take(&mut sum.tables);
        let (of_tables, only_second) = self.of_tables(&tables, log)?;
        sum.only_second = only_second;
        sum.gradients.merge(of_tables)?;
        Ok(sum)
    }

    /// Returns an empty result for a chunk. `log` requests the diagnostics of the perturbed sites.
    fn empty(&self, log: bool) -> ChunkResult {
        ChunkResult { diagnostics: log.then(Sums::default), ..ChunkResult::new(self.variables.len()) }
    }

    /// Computes everything of a step for a chunk, in an empty result. Losses and gradients are weighted with the
    /// chunk's fraction of the rays, so that chunks add up.
    fn work(
        &self,
        fields: &Fields,
        chunk: &Chunk,
        step_loss: StepLoss,
        mut result: ChunkResult,
    ) -> Result<ChunkResult> {
        if chunk.target.is_none() {
            self.unseen(fields, chunk, step_loss, &mut result)?;
            return Ok(result);
        }
        let t_fine = self.clean(fields, chunk, step_loss, &mut result)?;
        if self.config.method.is_augmented() {
            let of_clean_pass = fields.record_counts();
            let loss = self.second_pass(fields, chunk, t_fine.as_ref(), step_loss.perturbed, &mut result)?;
            fields.mark_second_pass(&of_clean_pass);
            result.losses.perturbed = Some(loss);
        }
        Ok(result)
    }

    /// Runs the clean passes of a chunk, and returns the fine pass's samples.
    pub(super) fn clean(
        &self,
        fields: &Fields,
        chunk: &Chunk,
        step_loss: StepLoss,
        result: &mut ChunkResult,
    ) -> Result<Option<Tensor>> {
        let (target, share) = (chunk.photographed(), &chunk.share);
        let weight = step_loss.clean * share;
        if let (Some(field), Some(u), false) = (fields.fine(), &chunk.u, self.has_coarse_loss()) {
            let placing = fields.coarse.frozen()?;
            let t_vals = place(&placing, &chunk.rays, &chunk.t_coarse, &self.config.sampling, u)?;
            return self.clean_fine(field, chunk, t_vals, step_loss, result).map(Some);
        }
        let weight = weight * coarse_weight(&self.config);
        let counts = Counts { weight, share: *share, is_evaluated: fields.fine().is_none() };
        let (loss, coarse) =
            self.descend_clean(&fields.coarse, self.coarse_pass(chunk), target, step_loss, counts, result)?;
        result.losses.coarse = Some(loss);
        let (Some(field), Some(u)) = (fields.fine(), &chunk.u) else {
            let acc = noiseless_acc(&fields.coarse, &coarse, self.coarse_pass(chunk))?;
            result.losses.extremes = Some(Extremes::tensor(&acc, &coarse.composite.rgb, target)?);
            return Ok(None);
        };
        let weights = &coarse.composite.weights;
        let t_vals = resample(&fields.coarse, &self.config.sampling, &chunk.t_coarse, weights, u)?;
        drop(coarse);
        self.clean_fine(field, chunk, t_vals, step_loss, result).map(Some)
    }

    /// Runs the clean fine pass of a chunk with its samples at `t_vals`, which are returned.
    fn clean_fine(
        &self,
        field: &Field,
        chunk: &Chunk,
        t_vals: Tensor,
        step_loss: StepLoss,
        result: &mut ChunkResult,
    ) -> Result<Tensor> {
        let (target, share) = (chunk.photographed(), &chunk.share);
        let counts = Counts { weight: step_loss.clean * share, share: *share, is_evaluated: true };
        let (loss, fine) =
            self.descend_clean(field, self.fine_pass(chunk, &t_vals), target, step_loss, counts, result)?;
        result.losses.fine = Some(loss);
        let acc = noiseless_acc(field, &fine, self.fine_pass(chunk, &t_vals))?;
        result.losses.extremes = Some(Extremes::tensor(&acc, &fine.composite.rgb, target)?);
        Ok(t_vals)
    }

    /// Returns whether the coarse pass has a loss. Otherwise it only places samples.
    pub(super) fn has_coarse_loss(&self) -> bool {
        self.config.representation().has_coarse_loss()
    }

    pub(super) fn coarse_pass<'a>(&self, chunk: &'a Chunk) -> Pass<'a> {
        Pass {
            rays: &chunk.rays,
            t_vals: &chunk.t_coarse,
            density_noise: chunk.noise_coarse.as_ref(),
            background: self.background,
            scales_gradients: self.config.train.gradient_scaling,
        }
    }

    pub(super) fn fine_pass<'a>(&self, chunk: &'a Chunk, t_vals: &'a Tensor) -> Pass<'a> {
        Pass { t_vals, density_noise: chunk.noise_fine.as_ref(), ..self.coarse_pass(chunk) }
    }

    /// Adds the gradients of `weight` times a loss, and returns the loss in f64.
    pub(super) fn descend(&self, loss: &Tensor, weight: f64, gradients: &mut Gradients) -> Result<Tensor> {
        gradients.add(&self.variables, &(loss * weight)?.backward()?)?;
        Ok(loss.detach().to_dtype(DType::F64)?)
    }
}
