//! Passes of rays without photographs, which terms of the loss read.

use candle_core::Tensor;

use crate::base::rng::{Random, Stream};
use crate::base::{Error, Result};
use crate::data::{Camera, PointRays, RayGroup, UnseenCameras};
use crate::field::Field;
use crate::losses::{TermSource, WeightedTerm};
use crate::methods::learner::StopCheck;
use crate::render::{Pass, PassOutput, clean_pass, place, resample};
use crate::settings::Resolved;

use super::chunk::Chunk;
use super::learner::FieldLearner;
use super::networks::Fields;
use super::results::ChunkResult;
use super::terms::{self, Counts, Rendered, StepLoss};

/// Streams of random numbers of a step: one for each kind of groups.
const GROUPS: u64 = 3;

/// Returns the cameras of unseen rays if terms read such rays.
///
/// # Errors
/// There are no such cameras, no points, or fewer rays than terms read at once.
pub(super) fn unseen_cameras(
    config: &Resolved,
    cameras: &[Camera],
    points: &PointRays,
    terms: &[WeightedTerm],
) -> Result<Option<UnseenCameras>> {
    let of_cameras = |group: &RayGroup| *group != RayGroup::Point;
    let is_read = terms::unseen_groups(terms).any(|group| of_cameras(&group));
    let unseen = is_read.then(|| UnseenCameras::of(cameras, config.unseen_poses)).transpose()?;
    terms::unseen_groups(terms).try_for_each(|group| {
        if config.unseen_rays < group.rays() {
            return Err(Error::Config(format!(
                "a term of the loss reads {} unseen rays at once, and regularizer.unseen_rays is {}; raise it, or train.rays",
                group.rays(),
                config.unseen_rays
            )));
        }
        if group == RayGroup::Point && points.count() == 0 {
            return Err(Error::Config(
                "a term of the loss, such as regularizer.kind=sparse-depth, reads depth at points of a COLMAP model, and this scene \
                 has none; take a COLMAP scene with its points, or another term"
                    .into(),
            ));
        }
        unseen.as_ref().filter(|_| of_cameras(&group)).map_or(Ok(()), |cameras| cameras.check(group))
    })?;
    Ok(unseen)
}

impl FieldLearner {
    /// Makes the cameras of unseen rays if terms read such rays. See [`unseen_cameras`].
    pub(super) fn place_unseen_cameras(&mut self, terms: &[WeightedTerm]) -> Result<()> {
        let cameras = unseen_cameras(&self.config, self.batches.cameras(), &self.points, terms)?;
        self.unseen = cameras.or(self.unseen.take());
        Ok(())
    }

    /// Returns a step's rays without photographs' colours in groups, with the random numbers of their pass.
    pub(super) fn draw_unseen(&self, group: RayGroup, step: u64) -> Result<Chunk> {
        let kind = match group {
            RayGroup::One => 0,
            RayGroup::Pair => 1,
            RayGroup::Patch => 2,
            RayGroup::Point => return self.draw_points(step),
        };
        let mut random = Random::new(self.config.seed, Stream::Unseen, step * GROUPS + kind);
        let cameras = self.unseen.as_ref().expect("cameras are placed with the term");
        let pixels = cameras.rays(group, self.config.unseen_rays / group.rays(), &mut random);
        let rays = self.batches.rays_of(&pixels).to_tensors(self.dtype, &self.device)?;
        self.draw_clean(rays, None, step, &mut random)
    }

    fn draw_points(&self, step: u64) -> Result<Chunk> {
        let mut random = Random::new(self.config.seed, Stream::Points, step);
        let (pixels, t) = self.points.draw(self.config.unseen_rays, &mut random);
        let rays = self.batches.rays_of(&pixels).to_tensors(self.dtype, &self.device)?;
        let point_t = Tensor::from_vec(t, pixels.len(), &self.device)?.to_dtype(self.dtype)?;
        Ok(Chunk { point_t: Some(point_t), ..self.draw_clean(rays, None, step, &mut random)? })
    }

    /// Returns values and gradients of the terms on a step's unseen rays in such groups.
    pub(super) fn on_unseen(
        &self,
        group: RayGroup,
        terms: &[WeightedTerm],
        step: u64,
        stop_check: &StopCheck,
    ) -> Result<ChunkResult> {
        let step_loss = StepLoss { source: TermSource::UnseenRays(group), ..self.step_loss(terms, step) };
        self.passes(&self.draw_unseen(group, step)?, step_loss, false, stop_check)
    }

    /// Adds values and gradients of the terms on a chunk of unseen rays to a result.
    pub(super) fn unseen(
        &self,
        fields: &Fields,
        chunk: &Chunk,
        step_loss: StepLoss,
        result: &mut ChunkResult,
    ) -> Result<()> {
        let (Some(field), Some(u)) = (fields.fine(), &chunk.u) else {
            return self
                .descend_unseen(&fields.coarse, self.coarse_pass(chunk), chunk, step_loss, true, result)
                .map(drop);
        };
        let sampling = &self.config.sampling;
        let t_vals = if step_loss.counts_in_coarse_pass() && self.has_coarse_loss() {
            let pass = self.coarse_pass(chunk);
            let coarse = self.descend_unseen(&fields.coarse, pass, chunk, step_loss, false, result)?;
            resample(&fields.coarse, sampling, &chunk.t_coarse, &coarse.composite.weights, u)?
        } else {
            place(&fields.coarse.frozen()?, &chunk.rays, &chunk.t_coarse, sampling, u)?
        };
        self.descend_unseen(field, self.fine_pass(chunk, &t_vals), chunk, step_loss, true, result).map(drop)
    }

    fn descend_unseen(
        &self,
        field: &Field,
        pass: Pass,
        chunk: &Chunk,
        step_loss: StepLoss,
        is_evaluated: bool,
        result: &mut ChunkResult,
    ) -> Result<PassOutput> {
        let out = clean_pass(field, pass)?;
        let counts = Counts { weight: 0.0, share: chunk.share, is_evaluated };
        let rendered = Rendered { out: &out, pass, loss: None, point_t: chunk.point_t.as_ref() };
        self.descend_terms(field, rendered, step_loss, counts, result)?;
        Ok(out)
    }
}
