//! Training of the network: a training view is left out, and rendered from those around it.

use candle_core::{DType, Tensor};

use crate::base::{Image, Result};
use crate::data::Scene;
use crate::grids::alpha_over::alpha_over;
use crate::grids::blend_views::blend_views;
use crate::grids::planes::plane_sample;
use crate::methods::{Extremes, Learner, LogColumns, StepReport, StepResult, StopCheck, Term};
use crate::settings::{PlanesLoss, Resolved};

use super::blend::{Blended, blend, blend_weight};
use super::geometry::{Viewpoint, inputs_of};
use super::mpi::{SourceView, eyes};
use super::network::{MpiNetwork, Weights};
use super::stage::Stage;
use super::sweep::sweep;
use super::windows::{Reference, Work};

/// The column of the loss.
const LOSS: &str = "loss_view";

/// Trains the network on one scene's training views, leaving one out after another.
pub struct PlanesLearner {
    config: Resolved,
    network: MpiNetwork,
    pub(super) stage: Stage,
}

impl PlanesLearner {
    /// Creates a learner of `network` on the training views of `scene`.
    ///
    /// # Errors
    /// If the method does not support the scene.
    pub fn new(config: &Resolved, scene: &Scene, network: MpiNetwork) -> Result<PlanesLearner> {
        let stage = Stage::new(config, scene)?;
        Ok(PlanesLearner { config: config.clone(), network, stage })
    }

    /// Checks that a new run's steps have inputs.
    ///
    /// # Errors
    /// Those of [`PlanesLearner::new`]; if memory is too small for the planes of images, or windows hold too few of the
    /// planes.
    pub fn check(config: &Resolved, scene: &Scene) -> Result<()> {
        let stage = Stage::new(config, scene)?;
        stage.check_memory(config.llff.inputs)?;
        draw(config, &stage, 0).map(drop)
    }

    /// Blends the references' planes on the crop.
    fn blended(&self, weights: &Weights, work: &Work, stop_check: &StopCheck) -> Result<Blended> {
        let nearest = work.references.iter().map(|reference| reference.distance).fold(f64::INFINITY, f64::min);
        let rendering = |reference: &Reference| -> Result<(Tensor, f64)> {
            stop_check()?;
            let eye = &self.stage.views[reference.view].eye;
            let weight = blend_weight(eye, reference.distance, nearest, &self.stage.depths);
            Ok((self.seen(weights, reference, work.target)?, weight))
        };
        blend(work.references.iter().map(rendering).collect::<Result<_>>()?, self.stage.background)
    }

    /// Returns colour times weight and sum of weights, `[rays, 4]`, of one reference's planes, whose inputs do not
    /// include the target.
    fn seen(&self, weights: &Weights, reference: &Reference, target: usize) -> Result<Tensor> {
        let Stage { views, depths, .. } = &self.stage;
        let inputs = inputs_of(&eyes(views), reference.view, self.config.llff.inputs, Some(target));
        let seen: Vec<(&Viewpoint, &Image)> =
            inputs.iter().map(|&view| (&views[view].eye, &*views[view].image)).collect();
        let (dtype, device) = (self.network.dtype(), self.network.device());
        let volume = sweep(&views[reference.view].eye, &seen, depths, reference.window, dtype, device)?;
        let planes = blend_views(&weights.forward(&volume)?, &volume)?;
        Ok(alpha_over(&plane_sample(&planes, &reference.places)?)?)
    }

    /// Returns the mean of `per_number`, `[rays, 3]`, over counted pixels.
    fn mean(&self, per_number: &Tensor, work: &Work) -> Result<Tensor> {
        let share = 1.0 / (3 * work.counted()) as f64;
        let shares: Vec<f64> = work.counts.iter().map(|counts| if *counts { share } else { 0.0 }).collect();
        let shares = Tensor::from_vec(shares, (work.counts.len(), 1), per_number.device())?;
        Ok(per_number.broadcast_mul(&shares.to_dtype(per_number.dtype())?)?.sum_all()?)
    }

    /// Returns the true colours of the crop, `[rays, 3]`.
    fn target(&self, work: &Work) -> Result<Tensor> {
        let SourceView { image, .. } = &self.stage.views[work.target];
        let pixel = |[column, row]: &[usize; 2]| image.pixels[3 * (row * image.width + column)..][..3].to_vec();
        let values: Vec<f32> = work.pixels.iter().flat_map(pixel).collect();
        Ok(Tensor::from_vec(values, (work.pixels.len(), 3), self.network.device())?.to_dtype(self.network.dtype())?)
    }
}

/// Returns the inputs of the step after `step` finished ones.
fn draw(config: &Resolved, stage: &Stage, step: u64) -> Result<Work> {
    Work::draw(&config.llff, config.seed, step, &eyes(&stage.views), &stage.depths)
}

impl Learner for PlanesLearner {
    fn columns(&self) -> LogColumns {
        LogColumns { photometric: vec![LOSS.into()], further: Vec::new() }
    }

    fn step(&mut self, step: u64, _log: bool, stop_check: &StopCheck) -> Result<StepResult> {
        let work = draw(&self.config, &self.stage, step)?;
        let blended = self.blended(&self.network.weights(true), &work, stop_check)?;
        let target = self.target(&work)?;
        let difference = (&blended.rgb - &target)?;
        let square = self.mean(&difference.sqr()?, &work)?;
        let loss = match self.config.llff.loss {
            PlanesLoss::Mse => square.clone(),
            PlanesLoss::L1 => self.mean(&difference.abs()?, &work)?,
        };
        stop_check()?;
        let gradients = self.network.parameters.gradients(&loss)?;
        let number = |tensor: &Tensor| tensor.to_dtype(DType::F64)?.to_scalar::<f64>();
        let value = number(&loss)?;
        let described = "loss of the view that is left out".to_string();
        let terms = vec![Term { name: LOSS.into(), described, value, weight: 1.0 }];
        let extremes = Extremes::of(&blended.acc, &blended.rgb, &target)?;
        let report = StepReport::new(terms, value, number(&square)?, extremes);
        Ok(StepResult { gradients, report })
    }
}
