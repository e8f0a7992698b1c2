//! The rays of a step with the random numbers of its clean passes, complete and in chunks.

use std::cmp::Reverse;
use std::sync::Arc;

use candle_core::Tensor;

use crate::base::Result;
use crate::base::rng::{Random, Stream};
use crate::data::{RayBuffer, RayGroup, Rays};
use crate::render::{Intervals, Pass, PlacedSamples, sampling, t_vals_per_ray};

use super::learner::FieldLearner;
use super::plan::PassPlan;

/// Streams of random numbers of a step's unseen rays: one for each kind of groups.
const GROUPS: u64 = 3;

/// The rays of a step, or a chunk of them, with their targets and the random numbers of their clean passes.
pub(super) struct StepRays {
    pub(super) rays: Rays,
    /// True colours, `[rays, 3]`. Unseen rays have none.
    pub(super) target: Option<Tensor>,
    /// The t of the known point on each ray, `[rays]`, of rays to points.
    pub(super) point_t: Option<Tensor>,
    /// The samples of a coarse pass.
    t_coarse: Option<Tensor>,
    /// Each ray's intervals in occupied cells, if these place samples.
    intervals: Option<Vec<Arc<Intervals>>>,
    noise_coarse: Option<Tensor>,
    noise_fine: Option<Tensor>,
    /// Positions in the inverse CDF, `[rays, fine]`.
    u: Option<Tensor>,
    /// Fraction of the step's rays.
    pub(super) fraction: f64,
    /// Steps finished before this one.
    pub(super) step: u64,
    /// Number of the chunk within the step.
    pub(super) index: u64,
}

impl StepRays {
    /// Returns the batch of the step after `step` finished ones.
    pub(super) fn batch(learner: &mut FieldLearner, step: u64) -> Result<StepRays> {
        let batch = learner.batches.batch(step);
        let target = Tensor::from_vec(batch.target, (batch.rays.len(), 3), &learner.device)?.to_dtype(learner.dtype)?;
        let mut random = Random::new(learner.config.seed, Stream::Jitter, step);
        StepRays { target: Some(target), ..StepRays::from_buffer(learner, &batch.rays, step, &mut random)? }.sorted()
    }

    /// Puts rays with many intervals in occupied cells before those with few: a chunk has as many columns as the ray with the most.
    fn sorted(self) -> Result<StepRays> {
        let Some(intervals) = self.intervals else { return Ok(self) };
        let mut order: Vec<u32> = (0..intervals.len() as u32).collect();
        order.sort_by_cached_key(|ray| Reverse(intervals[*ray as usize].count()));
        let intervals = Some(order.iter().map(|ray| intervals[*ray as usize].clone()).collect());
        let order = Tensor::new(order, self.rays.origins.device())?;
        let target = self.target.map(|target| target.index_select(&order, 0)).transpose()?;
        Ok(StepRays { rays: self.rays.select(&order)?, target, intervals, ..self })
    }

    /// Returns a step's rays without photographs' colours in groups.
    pub(super) fn unseen(learner: &FieldLearner, group: RayGroup, step: u64) -> Result<StepRays> {
        let (seed, count) = (learner.config.seed, learner.config.unseen_rays);
        let kind = match group {
            RayGroup::One => 0,
            RayGroup::Pair => 1,
            RayGroup::Patch => 2,
            RayGroup::Point => {
                let mut random = Random::new(seed, Stream::Points, step);
                let (pixels, t) = learner.points.draw(count, &mut random);
                let point_t = Tensor::from_vec(t, pixels.len(), &learner.device)?.to_dtype(learner.dtype)?;
                let rays = StepRays::from_buffer(learner, &learner.batches.rays_of(&pixels), step, &mut random)?;
                return Ok(StepRays { point_t: Some(point_t), ..rays });
            }
        };
        let mut random = Random::new(seed, Stream::Unseen, step * GROUPS + kind);
        let cameras = learner.unseen.as_ref().expect("cameras are placed with the term");
        let pixels = cameras.rays(group, count / group.rays(), &mut random);
        StepRays::from_buffer(learner, &learner.batches.rays_of(&pixels), step, &mut random)
    }

    fn from_buffer(learner: &FieldLearner, rays: &RayBuffer, step: u64, random: &mut Random) -> Result<StepRays> {
        StepRays::draw(learner, rays.to_tensors(learner.dtype, &learner.device)?, step, random)
    }

    /// Returns the same chunk with random numbers of its own.
    pub(super) fn redrawn(&self, learner: &FieldLearner) -> Result<StepRays> {
        let StepRays { fraction, step, index, .. } = *self;
        let mut random = Random::part(learner.config.seed, Stream::Search, step, index);
        let drawn = StepRays::draw(learner, self.rays.clone(), step, &mut random)?;
        Ok(StepRays { target: self.target.clone(), fraction, index, ..drawn })
    }

    /// Draws jitter, density noise and inverse-CDF positions of a clean pass, in a fixed order.
    fn draw(learner: &FieldLearner, rays: Rays, step: u64, random: &mut Random) -> Result<StepRays> {
        let FieldLearner { config, dtype, device, .. } = learner;
        let sampling = &config.sampling;
        let (n, coarse, fine) = (rays.len(), sampling.coarse, sampling.fine);
        let (columns, fine_columns) = t_vals_per_ray(learner.fields.coarse(), sampling);
        let (at_intervals, (_, fine_samples)) = (config.field.encoding.at_intervals(), config.samples());
        let bounds = sampling.annealed(learner.geometry.bounds, step);
        let mut uniform = |columns| random.uniform_tensor(&[n, columns], *dtype, device);
        if let Some(occupancy) = learner.fields.occupancy() {
            let shift = sampling.jitter.then(|| uniform(1)).transpose()?;
            let intervals = Some(occupancy.march(&rays, bounds, shift.as_ref())?);
            return Ok(StepRays { intervals, ..StepRays::without_numbers(rays, step) });
        }
        let jitter = sampling.jitter.then(|| uniform(columns)).transpose()?;
        let t_coarse = sampling::stratified(bounds, sampling.spacing, n, columns, jitter.as_ref(), &rays.origins)?;
        let std = config.density_noise;
        let mut noise = |samples: usize| -> Result<Option<Tensor>> {
            if std == 0.0 || samples == 0 {
                return Ok(None);
            }
            Ok(Some((random.normal_tensor(&[n, samples], *dtype, device)? * std)?))
        };
        let (noise_coarse, noise_fine) = (noise(coarse)?, noise(fine_samples)?);
        let u = match (fine, sampling.jitter) {
            (0, _) => None,
            (_, true) => {
                let uniform = random.uniform_tensor(&[n, fine_columns], *dtype, device)?;
                Some(if at_intervals { sampling::stratified_u(&uniform)? } else { uniform })
            }
            (_, false) => Some(sampling::even_u(n, fine_columns, &t_coarse)?),
        };
        let t_coarse = Some(t_coarse);
        Ok(StepRays { t_coarse, noise_coarse, noise_fine, u, ..StepRays::without_numbers(rays, step) })
    }

    fn without_numbers(rays: Rays, step: u64) -> StepRays {
        let (target, point_t, t_coarse, intervals) = (None, None, None, None);
        let (noise_coarse, noise_fine, u, fraction, index) = (None, None, None, 1.0, 0);
        StepRays { rays, target, point_t, t_coarse, intervals, noise_coarse, noise_fine, u, fraction, step, index }
    }

    /// Returns chunk number `index` of a step's rays.
    pub(super) fn narrow(&self, index: usize, start: usize, count: usize) -> Result<StepRays> {
        // Shared, not copied, if the complete tensor is contiguous.
        let part = |tensor: &Tensor| tensor.narrow(0, start, count)?.contiguous();
        let maybe = |tensor: &Option<Tensor>| tensor.as_ref().map(part).transpose();
        Ok(StepRays {
            rays: self.rays.narrow(start, count)?,
            target: maybe(&self.target)?,
            point_t: maybe(&self.point_t)?,
            t_coarse: maybe(&self.t_coarse)?,
            intervals: self.intervals.as_ref().map(|all| all[start..start + count].to_vec()),
            noise_coarse: maybe(&self.noise_coarse)?,
            noise_fine: maybe(&self.noise_fine)?,
            u: maybe(&self.u)?,
            fraction: count as f64 / self.rays.len() as f64,
            step: self.step,
            index: index as u64,
        })
    }

    /// Returns the samples of a coarse pass.
    ///
    /// # Panics
    /// Occupied cells place the samples.
    pub(super) fn t_coarse(&self) -> &Tensor {
        self.t_coarse.as_ref().expect("a coarse pass has samples")
    }

    /// Returns each ray's intervals in occupied cells.
    ///
    /// # Panics
    /// They do not place the samples.
    pub(super) fn intervals(&self) -> &[Arc<Intervals>] {
        self.intervals.as_ref().expect("occupied cells place the samples")
    }

    /// Returns the positions in the inverse CDF of the samples of a fine pass.
    ///
    /// # Panics
    /// There is no fine pass.
    pub(super) fn u(&self) -> &Tensor {
        self.u.as_ref().expect("a fine pass has numbers to place its samples")
    }

    /// Returns a pass with its samples.
    pub(super) fn pass<'a>(&'a self, learner: &FieldLearner, plan: &PassPlan, samples: &'a PlacedSamples) -> Pass<'a> {
        let noise = if plan.is_coarse { &self.noise_coarse } else { &self.noise_fine };
        Pass {
            rays: &self.rays,
            samples,
            density_noise: noise.as_ref(),
            background: learner.background,
            scales_gradients: learner.config.train.gradient_scaling,
        }
    }
}
