//! The learner of all field methods: its state, its start and its step.

use candle_core::{DType, Device, Tensor, Var};

use crate::augment::PixelScale;
use crate::base::{Error, Result};
use crate::data::Scene;
use crate::methods::batches::Batches;
use crate::methods::gradients::Gradients;
use crate::render::positions_at;
use crate::settings::{DensityActivation, Regularizer, Resolved};

use super::diagnostics::LevelDiagnostics;
use super::networks::Model;
use super::passes::mixing;
use super::regularized;
use super::results::ChunkResult;

/// Times that a dead start is drawn again before the configuration is blamed.
const MOST_REDRAWS: u64 = 100;

/// Trains the fields of one experiment on one scene.
pub struct FieldLearner {
    pub(super) config: Resolved,
    pub(super) volume: Volume,
    pub(super) device: Device,
    pub(super) dtype: DType,
    pub(super) model: Model,
    pub(super) variables: Vec<(String, Var)>,
    pub(super) batches: Batches,
}

/// What a scene contributes to the numerics besides rays.
#[derive(Clone, Copy, Debug)]
pub struct Volume {
    /// Start and end of a ray's interval, in units of `t_vals`.
    pub bounds: (f64, f64),
    /// Fills missing accumulation.
    pub background: Option<[f32; 3]>,
    /// A pixel's size.
    pub pixel: PixelScale,
}

impl Volume {
    /// That of a scene; the first training camera stands for all.
    pub fn of(scene: &Scene) -> Volume {
        let camera = &scene.train[0].camera;
        let pixel = PixelScale {
            width: camera.width as f64,
            height: camera.height as f64,
            focal: camera.focal[0],
            ndc: scene.ndc.is_some(),
        };
        Volume { bounds: (scene.near, scene.far), background: scene.background, pixel }
    }
}

/// What a step learned.
pub struct Learned {
    /// In the order of the model's variables.
    pub gradients: Gradients,
    /// Photometric loss of the clean coarse pass.
    pub loss_coarse: f64,
    /// That of the clean fine pass, where there is one.
    pub loss_fine: Option<f64>,
    /// Loss of the perturbed passes (coarse + fine, unweighted), where there are any.
    pub loss_perturbed: Option<f64>,
    /// Each regularizer's term, unweighted, summed over the fields that it holds for.
    pub regularizers: Vec<(Regularizer, f64)>,
    /// What the gradients are of.
    pub loss: f64,
    /// Largest accumulation of a ray in the pass that is evaluated, without density noise.
    pub largest_acc: f64,
    /// Per level that is on, at log steps.
    pub levels: Vec<LevelDiagnostics>,
}

impl FieldLearner {
    /// Goes on with `model` on the training views of `scene`.
    pub fn new(config: &Resolved, scene: &Scene, model: Model, dtype: DType, device: &Device) -> Result<FieldLearner> {
        Ok(FieldLearner {
            config: config.clone(),
            volume: Volume::of(scene),
            device: device.clone(),
            dtype,
            variables: model.variables(),
            model,
            batches: Batches::new(config, scene)?,
        })
    }

    /// Draws the fields of a run, dead starts again, and returns how often each field of [`Model::roles`] was drawn again.
    pub fn start(config: &Resolved, scene: &Scene, dtype: DType, device: &Device) -> Result<(FieldLearner, Vec<u64>)> {
        if !config.regularizer.kind.is_empty() {
            regularized::lattice(&config.regularizer).check_meets(scene, "regularizer.domain")?;
        }
        let mut redraws = vec![0; Model::roles(config).len()];
        let model = Model::init(config, &redraws, dtype, device)?;
        let mut learner = FieldLearner::new(config, scene, model, dtype, device)?;
        let first = learner.draw(0)?;
        let positions = positions_at(&learner.model.coarse, &first.rays, &first.t_coarse)?.flatten(0, 1)?;
        loop {
            let dead = learner.dead_fields(&positions)?;
            if dead.is_empty() {
                break;
            }
            for field in dead {
                redraws[field] += 1;
                if redraws[field] > MOST_REDRAWS {
                    return Err(Error::Diverged(format!(
                        "{MOST_REDRAWS} draws of the {} field all start with under {} of densities positive; \
                         lower train.dead_start_share or change field.init",
                        Model::roles(config)[field],
                        config.train.dead_start_share
                    )));
                }
            }
            learner.model = Model::init(config, &redraws, dtype, device)?;
            learner.variables = learner.model.variables();
        }
        if !config.regularizer.kind.is_empty() {
            learner.check_duration(&config.regularizer, config.train.steps)?;
        }
        Ok((learner, redraws))
    }

    /// The fields that learn.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Fields whose share of positive densities at `positions` is under the configured one. Softplus has none: it is
    /// positive, and has a slope, everywhere.
    fn dead_fields(&self, positions: &Tensor) -> Result<Vec<usize>> {
        if self.config.field.density_activation == DensityActivation::Softplus {
            return Ok(Vec::new());
        }
        let mut dead = Vec::new();
        for (index, (_, field)) in self.model.fields().into_iter().enumerate() {
            let positive = field.frozen()?.raw_density(positions)?.gt(0f64)?.to_dtype(DType::F64)?;
            if positive.mean_all()?.to_scalar::<f64>()? < self.config.train.dead_start_share {
                dead.push(index);
            }
        }
        Ok(dead)
    }

    /// Draws the rays of the step after `step` finished ones and learns from them. `log` asks for the diagnostics of the
    /// perturbed levels.
    pub fn learn(&mut self, step: u64, log: bool) -> Result<Learned> {
        let whole = self.draw(step)?;
        let ChunkResult { mut gradients, losses, diagnostics } = self.passes(&whole, log)?;
        let terms = match self.regularize(&self.config.regularizer, step)? {
            Some((values, pull)) => {
                gradients.merge(pull)?;
                Some(values)
            }
            None => None,
        };
        let (clean_weight, perturbed_weight) = mixing(&self.config);
        let [loss_coarse, loss_fine, loss_perturbed, largest_acc] = losses.read()?;
        let loss_coarse = loss_coarse.expect("every chunk has a coarse pass");
        let clean = self.coarse_weight(&self.model) * loss_coarse + loss_fine.unwrap_or(0.0);
        let mut loss = clean_weight * clean + loss_perturbed.map_or(0.0, |loss| perturbed_weight * loss);
        let mut regularizers = Vec::new();
        if let Some(values) = terms {
            let values = values.to_vec1::<f64>()?;
            loss +=
                self.config.regularizer.terms().zip(&values).map(|((_, weight), value)| weight * value).sum::<f64>();
            regularizers = self.config.regularizer.kind.iter().copied().zip(values).collect();
        }
        Ok(Learned {
            gradients,
            loss_coarse,
            loss_fine,
            loss_perturbed,
            regularizers,
            loss,
            largest_acc: largest_acc.expect("every chunk has one"),
            levels: diagnostics.finish(clean),
        })
    }
}
