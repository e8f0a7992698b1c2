//! The rays of a step with the random numbers of its clean pass, complete and in chunks.

use candle_core::Tensor;

use crate::base::Result;
use crate::base::rng::{Random, Stream};
use crate::data::Rays;
use crate::render::{columns, sampling};

use super::learner::FieldLearner;

/// A chunk of one step: rays, targets and the clean pass's random numbers.
pub(super) struct Chunk {
    pub(super) rays: Rays,
    /// True colours, `[rays, 3]`. Unseen rays have none.
    pub(super) target: Option<Tensor>,
    /// The t of the known point on each ray, `[rays]`, of rays to points.
    pub(super) point_t: Option<Tensor>,
    pub(super) t_coarse: Tensor,
    pub(super) noise_coarse: Option<Tensor>,
    pub(super) noise_fine: Option<Tensor>,
    /// Positions in the inverse CDF, `[rays, fine]`.
    pub(super) u: Option<Tensor>,
    /// Fraction of the step's rays.
    pub(super) share: f64,
    /// Steps finished before this one.
    pub(super) step: u64,
    /// Number of the chunk within the step.
    pub(super) index: u64,
}

impl Chunk {
    /// Returns the true colours of training rays.
    ///
    /// # Panics
    /// The rays are unseen.
    pub(super) fn photographed(&self) -> &Tensor {
        self.target.as_ref().expect("training rays have colours")
    }

    pub(super) fn narrow(&self, index: usize, start: usize, count: usize) -> Result<Chunk> {
        // Shared, not copied, if the complete tensor is contiguous.
        let part = |tensor: &Tensor| tensor.narrow(0, start, count)?.contiguous();
        let maybe = |tensor: &Option<Tensor>| tensor.as_ref().map(part).transpose();
        Ok(Chunk {
            rays: self.rays.narrow(start, count)?,
            target: maybe(&self.target)?,
            point_t: maybe(&self.point_t)?,
            t_coarse: part(&self.t_coarse)?,
            noise_coarse: maybe(&self.noise_coarse)?,
            noise_fine: maybe(&self.noise_fine)?,
            u: maybe(&self.u)?,
            share: count as f64 / self.rays.len() as f64,
            step: self.step,
            index: index as u64,
        })
    }
}

impl FieldLearner {
    /// Returns the complete batch of a step with the clean pass's random numbers.
    pub(super) fn draw(&mut self, step: u64) -> Result<Chunk> {
        let batch = self.batches.batch(step);
        let rays = batch.rays.to_tensors(self.dtype, &self.device)?;
        let target = Tensor::from_vec(batch.target, (rays.len(), 3), &self.device)?.to_dtype(self.dtype)?;
        let mut random = Random::new(self.config.seed, Stream::Jitter, step);
        self.draw_clean(rays, Some(target), step, &mut random)
    }

    /// Draws jitter, density noise and inverse-CDF positions of a clean pass, in a fixed order.
    pub(super) fn draw_clean(
        &self,
        rays: Rays,
        target: Option<Tensor>,
        step: u64,
        random: &mut Random,
    ) -> Result<Chunk> {
        let sampling = &self.config.sampling;
        let (n, coarse, fine) = (rays.len(), sampling.coarse, sampling.fine);
        let (columns, fine_columns) = columns(&self.fields.coarse, sampling);
        let (intervals, (_, fine_samples)) = (self.config.field.encoding.at_intervals(), self.config.samples());
        let jitter = match sampling.jitter {
            true => Some(random.uniform_tensor(&[n, columns], self.dtype, &self.device)?),
            false => None,
        };
        let t_coarse = sampling::stratified(
            self.config.sampling.annealed(self.bounds, step),
            self.config.sampling.spacing,
            n,
            columns,
            jitter.as_ref(),
            &rays.origins,
        )?;
        let std = self.config.density_noise;
        let mut noise = |samples: usize| -> Result<Option<Tensor>> {
            if std == 0.0 {
                return Ok(None);
            }
            Ok(Some((random.normal_tensor(&[n, samples], self.dtype, &self.device)? * std)?))
        };
        let noise_coarse = noise(coarse)?;
        let noise_fine = if fine > 0 { noise(fine_samples)? } else { None };
        let u = match (fine, sampling.jitter) {
            (0, _) => None,
            (_, true) => {
                let uniform = random.uniform_tensor(&[n, fine_columns], self.dtype, &self.device)?;
                Some(if intervals { sampling::stratified_u(&uniform)? } else { uniform })
            }
            (_, false) => Some(sampling::even_u(n, fine_columns, &t_coarse)?),
        };
        Ok(Chunk { rays, target, point_t: None, t_coarse, noise_coarse, noise_fine, u, share: 1.0, step, index: 0 })
    }
}
