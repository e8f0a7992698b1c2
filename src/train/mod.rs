//! Training: steps of a learner, updates by Adam, checks that a run is alive.

use candle_core::{DType, Device, Tensor};

use crate::base::{Error, Result};
use crate::data::Scene;
use crate::methods::{Balance, FieldLearner, Gradients, Learned, LevelDiagnostics, Model};
use crate::settings::{Regularizer, RegularizerConfig, Resolved};

pub mod checkpoint;
mod optimizer;

pub use optimizer::{Adam, Moments, learning_rate};

/// Accumulation under which a ray counts as empty.
const EMPTY_ACC: f64 = 1e-3;

/// What one step measured.
#[derive(Clone, Debug)]
pub struct StepStats {
    /// Steps finished, this one included.
    pub step: u64,
    /// Learning rate of this step's update.
    pub learning_rate: f64,
    /// Photometric loss of the clean coarse pass.
    pub loss_coarse: f64,
    /// That of the clean fine pass, where there is one.
    pub loss_fine: Option<f64>,
    /// Loss of the perturbed passes (coarse + fine, unweighted), where there are any.
    pub loss_perturbed: Option<f64>,
    /// Each regularizer's term, unweighted, summed over the fields that it holds for.
    pub regularizers: Vec<(Regularizer, f64)>,
    /// What was minimised: clean and perturbed loss as the objective mixes them, plus weighted
    /// regularizers.
    pub loss: f64,
    /// Largest accumulation of a ray in the pass that is evaluated, without density noise.
    pub largest_acc: f64,
    /// Per level that is on, at log steps.
    pub levels: Vec<LevelDiagnostics>,
}

impl StepStats {
    /// PSNR of the batch in the pass that is evaluated, dB, unrounded.
    /// None where the error is 0.
    pub fn psnr(&self) -> Option<f64> {
        let mse = self.loss_fine.unwrap_or(self.loss_coarse);
        (mse > 0.0).then(|| -10.0 * mse.log10())
    }
}

/// State of a run in memory.
pub struct Trainer {
    config: Resolved,
    device: Device,
    learner: FieldLearner,
    adam: Adam,
    step: u64,
    /// Steps in a row on which every ray was empty.
    empty_steps: u64,
    /// Redraws of each field before it was alive.
    redraws: Vec<u64>,
    /// Revisions of the code and kinds of devices that took earlier steps.
    revisions: Vec<String>,
    devices: Vec<String>,
}

/// The first parameter whose tensor is not finite.
fn find_non_finite(tensors: &[Option<Tensor>], adam: &Adam) -> Result<Option<String>> {
    let named = adam.variables().iter().zip(tensors).filter_map(|((name, _), g)| g.as_ref().map(|g| (name, g)));
    let (names, sums): (Vec<&String>, Vec<_>) = named.map(|(name, g)| (name, g.sum_all())).unzip();
    let sums: Vec<Tensor> = sums.into_iter().collect::<candle_core::Result<_>>()?;
    let sums: Vec<f64> = Tensor::stack(&sums, 0)?.to_dtype(DType::F64)?.to_vec1()?;
    Ok(names.into_iter().zip(sums).find(|(_, sum)| !sum.is_finite()).map(|(name, _)| name.clone()))
}

impl Trainer {
    /// A run at step 0.. Dead starts are drawn again.
    pub fn new(config: &Resolved, scene: &Scene, dtype: DType, device: &Device) -> Result<Trainer> {
        let (learner, redraws) = FieldLearner::start(config, scene, dtype, device)?;
        Ok(Trainer { redraws, ..Trainer::with_learner(config, learner, device)? })
    }

    fn with_learner(config: &Resolved, learner: FieldLearner, device: &Device) -> Result<Trainer> {
        Ok(Trainer {
            device: device.clone(),
            adam: Adam::new(learner.model().variables())?,
            redraws: vec![0; learner.model().fields().len()],
            learner,
            step: 0,
            empty_steps: 0,
            revisions: Vec::new(),
            devices: Vec::new(),
            config: config.clone(),
        })
    }

    /// The resolved configuration.
    pub fn config(&self) -> &Resolved {
        &self.config
    }

    /// The networks.
    pub fn model(&self) -> &Model {
        self.learner.model()
    }

    /// Steps finished.
    pub fn step_count(&self) -> u64 {
        self.step
    }

    /// How often each field (see [`Model::roles`]) was drawn again because it started dead.
    pub fn redraws(&self) -> &[u64] {
        &self.redraws
    }

    /// See [`FieldLearner::balance`].
    pub fn balance(&mut self, config: &RegularizerConfig) -> Result<Vec<Balance>> {
        self.learner.balance(config, self.step)
    }

    /// See [`FieldLearner::check_duration`].
    pub fn check_duration(&self, config: &RegularizerConfig, steps: u64) -> Result<()> {
        self.learner.check_duration(config, steps)
    }

    /// Takes one step. `log` asks for the diagnostics of the perturbed levels.
    pub fn step(&mut self, log: bool) -> Result<StepStats> {
        let learned = self.learner.learn(self.step, log)?;
        let Learned { gradients, loss_coarse, loss_fine, loss_perturbed, regularizers, loss, largest_acc, levels } =
            learned;
        let stats = StepStats {
            step: self.step + 1,
            learning_rate: learning_rate(&self.config, self.step),
            loss_coarse,
            loss_fine,
            loss_perturbed,
            regularizers,
            loss,
            largest_acc,
            levels,
        };
        self.check_finite(&stats, &gradients)?;
        self.check_alive(&stats)?;
        self.adam.update(&gradients.0, stats.learning_rate, stats.step)?;
        let parameters: Vec<Option<Tensor>> =
            self.adam.variables().iter().map(|(_, var)| Some(var.as_detached_tensor())).collect();
        if let Some(name) = find_non_finite(&parameters, &self.adam)? {
            return Err(self.non_finite(stats.step, &format!("parameter {name}")));
        }
        self.step += 1;
        Ok(stats)
    }

    fn check_finite(&self, stats: &StepStats, gradients: &Gradients) -> Result<()> {
        let losses = [
            ("loss of the clean coarse pass", Some(stats.loss_coarse)),
            ("loss of the clean fine pass", stats.loss_fine),
            ("loss of the perturbed pass", stats.loss_perturbed),
        ];
        let passes = losses.into_iter().filter_map(|(name, loss)| loss.map(|loss| (name.to_string(), loss)));
        let terms = stats.regularizers.iter().map(|(term, value)| (format!("regularizer {}", term.name()), *value));
        let loss = passes.chain(terms).find(|(_, loss)| !loss.is_finite());
        let tensor = match loss {
            Some((name, _)) => Some(name),
            None => find_non_finite(&gradients.0, &self.adam)?.map(|name| format!("gradient of {name}")),
        };
        tensor.map_or(Ok(()), |tensor| Err(self.non_finite(stats.step, &tensor)))
    }

    fn non_finite(&self, step: u64, tensor: &str) -> Error {
        Error::Diverged(format!(
            "training went non-finite at step {step}: the {tensor} is not a number; lower train.learning_rate ({}), \
             the step sizes of section perturb or regularizer.weight, and start a new run",
            self.config.train.learning_rate
        ))
    }

    fn check_alive(&mut self, stats: &StepStats) -> Result<()> {
        self.empty_steps = if stats.largest_acc < EMPTY_ACC { self.empty_steps + 1 } else { 0 };
        let limit = self.config.train.collapse_steps;
        if limit == 0 || self.empty_steps < limit {
            return Ok(());
        }
        Err(Error::Diverged(format!(
            "training collapsed at step {}: acc (accumulated weight) stayed under {EMPTY_ACC} on every ray for {} steps; \
             try another seed, a lower train.learning_rate, or precropping (train.precrop_steps); \
             train.collapse_steps = 0 switches this check off",
            stats.step, self.empty_steps
        )))
    }
}
