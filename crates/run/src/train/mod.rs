//! Training: steps of a learner, updates by Adam, checks whether a run is alive, and checkpoints.

use std::time::Instant;

use candle_core::DType;

use crate::base::{Error, Result};
use crate::data::Scene;
use crate::losses::LossTerm;
use crate::methods::{Learner, LogColumns, StopCheck};
use crate::model::{Model, Start};
use crate::runtime::Runtime;
use crate::settings::Resolved;

pub mod checkpoint;
mod health;
mod memory;
mod origin;
mod stats;
mod sums;

pub use crate::optimizer::{Adam, AdamSettings, Moments, learning_rate};
pub use memory::graphs_mib;
pub use origin::Origin;
pub use stats::StepStats;

/// Seconds from which on a step is timed once.
const LONG_STEP: f64 = 2.0;

/// Returns an error if a run on a CPU needs more memory than is free.
fn check_memory(config: &Resolved, scene: &Scene, runtime: &Runtime) -> Result<()> {
    match runtime.device().is_cpu() {
        true => memory::check_memory(config, scene, runtime.threads()),
        false => Ok(()),
    }
}

/// State of a run in memory.
///
/// ```
/// # mod augnerf { pub use augnerf_core::*; pub use augnerf_run::*; pub use candle_core; }
/// use augnerf::candle_core::DType;
/// use augnerf::run::load_scene;
/// use augnerf::runtime::Runtime;
/// use augnerf::settings::{Preset, build, parse_assignment};
/// use augnerf::train::Trainer;
///
/// let small = ["data.width=24", "field.width=16", "train.rays=64"].map(|text| parse_assignment(text).unwrap());
/// let (config, scene) = load_scene(build(Some(Preset::Smoke), None, &small)?, &())?;
/// let mut trainer = Trainer::new(&config, &scene, DType::F32, &Runtime::new("cpu", None)?)?;
/// let first = trainer.step(false)?.loss;
/// for _ in 0..30 {
///     trainer.step(false)?;
/// }
/// assert!(trainer.step(false)?.loss < first);
/// # Ok::<(), augnerf::base::Error>(())
/// ```
pub struct Trainer {
    config: Resolved,
    runtime: Runtime,
    model: Model,
    learner: Box<dyn Learner>,
    adam: Adam,
    step: u64,
    /// The step at which its moments were 0.
    adam_since: u64,
    /// Successive steps on which every ray was empty or all had one colour.
    empty_steps: u64,
    /// How often each part of the model was initialized again before it was alive.
    redraws: Vec<u64>,
    /// Revisions of the code and kinds of devices of earlier steps.
    revisions: Vec<String>,
    /// Instruction sets of its CPUs.
    instructions: Vec<String>,
    devices: Vec<String>,
}

impl Trainer {
    /// Creates a run at step 0 that takes its steps on the runtime's device and threads. A network that starts dead is
    /// initialized again.
    ///
    /// # Errors
    /// [`Error::Config`]: the run needs more memory than is free, or a regularizer's box misses the scene's rays or
    /// takes too long. [`Error::Diverged`]: every initialization of a field is dead.
    pub fn new(config: &Resolved, scene: &Scene, dtype: DType, runtime: &Runtime) -> Result<Trainer> {
        if let Some(parent) = &config.train.parent {
            return Err(Error::Config(format!(
                "train.parent = {parent:?} says that the run starts from other weights, which are missing; start it with \
                 `augnerf train --from RUN` or `augnerf import FILE` (with --overwrite, if it was stopped there)"
            )));
        }
        check_memory(config, scene, runtime)?;
        runtime.install(|| {
            let start = Model::start(config, scene, dtype, runtime.device())?;
            Trainer::with(config, start, runtime)
        })
    }

    /// Checks that a run can start, as [`Trainer::new`] does, but for the memory that is free and a dead start.
    ///
    /// # Errors
    /// Those of [`Trainer::new`].
    pub fn check(config: &Resolved, scene: &Scene, dtype: DType, runtime: &Runtime) -> Result<()> {
        runtime.install(|| Model::start(config, scene, dtype, runtime.device()).map(drop))
    }

    /// Measures the seconds of the next step, without taking it: of a second try, after a first that fills caches, unless
    /// that took long. No number of the run changes. An error of the check ends it.
    ///
    /// # Errors
    /// Those of the learner and of the check.
    pub fn time_step(&mut self, stop_check: &StopCheck) -> Result<f64> {
        let runtime = self.runtime.clone();
        let mut timed = || -> Result<f64> {
            let started = Instant::now();
            runtime.install(|| self.learner.step(self.step, false, stop_check))?;
            Ok(started.elapsed().as_secs_f64())
        };
        let first = timed()?;
        if first > LONG_STEP { Ok(first) } else { timed() }
    }

    fn with(config: &Resolved, Start { model, learner, redraws }: Start, runtime: &Runtime) -> Result<Trainer> {
        Ok(Trainer {
            config: config.clone(),
            runtime: runtime.clone(),
            adam: Adam::new(AdamSettings::of(&config.train), model.variables())?,
            model,
            learner,
            step: 0,
            adam_since: 0,
            empty_steps: 0,
            redraws,
            revisions: Vec::new(),
            instructions: Vec::new(),
            devices: Vec::new(),
        })
    }

    /// Returns the configuration at the start.
    pub fn config(&self) -> &Resolved {
        &self.config
    }

    /// Returns the trained model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Returns the number of completed steps.
    pub fn step_count(&self) -> u64 {
        self.step
    }

    /// Returns how often each part of the model (see [`Model::parts`]) was initialized again because it started dead.
    pub fn redraws(&self) -> &[u64] {
        &self.redraws
    }

    /// Returns the log columns of the learner's terms and diagnostics.
    pub fn columns(&self) -> LogColumns {
        self.learner.columns()
    }

    /// Adds a custom term to the loss; see [`Learner::add_term`].
    ///
    /// # Errors
    /// A term of that name exists, or the method cannot compute it.
    pub fn add_term(&mut self, term: LossTerm, weight: f64) -> Result<()> {
        self.learner.add_term(term, weight)
    }

    /// Takes one step. With `log`, the learner computes its diagnostics.
    ///
    /// # Errors
    /// [`Error::Diverged`]: a loss, gradient or parameter is not a number, or all rays stay empty too long.
    pub fn step(&mut self, log: bool) -> Result<StepStats> {
        self.step_unless(log, &|| Ok(()))
    }

    /// Takes one step and calls the check repeatedly. An error of the check ends the step, which then does not count.
    ///
    /// # Errors
    /// Those of [`Trainer::step`] and of the check.
    pub fn step_unless(&mut self, log: bool, stop_check: &StopCheck) -> Result<StepStats> {
        self.runtime.clone().install(|| self.step_here(log, stop_check))
    }

    fn step_here(&mut self, log: bool, stop_check: &StopCheck) -> Result<StepStats> {
        let result = self.learner.step(self.step, log, stop_check)?;
        let gradients = result.gradients;
        let stats = StepStats {
            step: self.step + 1,
            learning_rate: learning_rate(&self.config, self.step),
            terms: result.terms,
            loss: result.loss,
            mse: result.mse,
            extremes: result.extremes,
            sites: result.sites,
        };
        let train = &self.config.train;
        health::check_step(&stats, &gradients, &self.adam, train.learning_rate)?;
        self.empty_steps = health::count_dead(self.empty_steps, &stats, train.collapse_steps)?;
        self.adam.update(&gradients.0, stats.learning_rate, stats.step - self.adam_since)?;
        health::check_parameters(stats.step, &self.adam, train.learning_rate)?;
        self.step += 1;
        Ok(stats)
    }
}
