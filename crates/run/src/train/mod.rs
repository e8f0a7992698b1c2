//! Training: steps, checks whether a run is alive, and checkpoints.

use std::cell::{OnceCell, RefCell};
use std::sync::Arc;

use candle_core::DType;

use crate::accelerator;
use crate::base::{Error, Result};
use crate::data::Scene;
use crate::losses::LossTerm;
use crate::methods::{LogColumns, StepAt, StopCheck};
use crate::model::Model;
use crate::perturb::Site;
use crate::runtime::Runtime;
use crate::settings::Resolved;

pub mod checkpoint;
mod descent;
mod health;
mod memory;
mod origin;
mod sharpness;
mod stats;
mod stepper;
mod sums;

use checkpoint::State;
use descent::Descent;
use stepper::{Stepper, Steps};

pub use crate::optimizer::{Adam, AdamSettings, Moments, learning_rate};
pub use memory::graphs_mib;
pub use origin::Origin;
pub use stats::StepStats;
pub use sums::sha256;

/// Returns an error if a run on a CPU needs more memory than is free.
fn check_memory(config: &Resolved, scene: &Scene, runtime: &Runtime) -> Result<()> {
    match runtime.is_cpu() {
        true => memory::check_memory(config, scene, runtime.threads()),
        false => Ok(()),
    }
}

/// State of a run in memory.
///
/// ```
/// # mod augnerf { pub use augnerf_base as base; pub use augnerf_nerf::*; pub use augnerf_run::*; pub use candle_core; }
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
    /// Its variables may lack the newest steps: see [`Trainer::model`].
    model: Model,
    /// The model after the newest step, once it was asked for.
    shown: OnceCell<Model>,
    stepper: RefCell<Stepper>,
    /// Counters, and the provenance of earlier steps.
    state: State,
}

/// What a run is trained with.
#[derive(Clone, Copy)]
struct Inputs<'a> {
    config: &'a Resolved,
    scene: &'a Scene,
    dtype: DType,
    runtime: &'a Runtime,
}

impl Inputs<'_> {
    /// Returns what takes the steps of `model`, with saved moments or 0. This is the one place that chooses between an
    /// accelerator and candle's devices.
    fn steps(self, model: &Model, moments: Option<Vec<Moments>>) -> Result<Steps> {
        let Inputs { config, scene, dtype, runtime } = self;
        if let Some(accelerator) = runtime.accelerator() {
            let fields = model.fields_on_accelerator(config)?;
            let steps = accelerator.steps(config, scene, fields, moments.as_deref())?;
            return Ok(Steps::Device(steps, moments.map_or_else(|| Moments::zero(&model.variables()), Ok)?));
        }
        let learner = model.learner(config, scene, dtype, runtime.device())?;
        Ok(Steps::Learner(Box::new(Descent::new(config, learner, model.variables(), moments)?)))
    }

    /// Returns a trainer that continues from `state` with parameters and moments of that step.
    fn trainer(self, model: Model, steps: Steps, state: State) -> Trainer {
        let Inputs { config, runtime, .. } = self;
        Trainer {
            config: config.clone(),
            runtime: runtime.clone(),
            model,
            shown: OnceCell::new(),
            stepper: RefCell::new(Stepper::new(steps, config, state.empty_steps)),
            state: State { format: checkpoint::FORMAT, config_hash: config.hash(), ..state },
        }
    }
}

impl Trainer {
    /// Creates a run at step 0 that takes its steps on the runtime's device and threads. A network that starts dead is
    /// initialized again.
    ///
    /// # Errors
    /// [`Error::Config`]: the run needs more memory than is free, or a regularizer's box misses the scene's rays, or
    /// the runtime's accelerator does not train the method. [`Error::Diverged`]: every initialization of a field is dead.
    pub fn new(config: &Resolved, scene: &Scene, dtype: DType, runtime: &Runtime) -> Result<Trainer> {
        if let Some(parent) = &config.train.parent {
            return Err(Error::Config(format!(
                "train.parent = {parent:?} says that the run starts from other weights, which are missing; start it with \
                 `augnerf train --from RUN` or `augnerf import FILE` (with --overwrite, if it was stopped there)"
            )));
        }
        check_memory(config, scene, runtime)?;
        accelerator::check(config, runtime)?;
        let inputs = Inputs { config, scene, dtype, runtime };
        runtime.install(|| {
            let (model, redraws) = Model::start(config, scene, dtype, runtime)?;
            let steps = inputs.steps(&model, None)?;
            Ok(inputs.trainer(model, steps, State { redraws, ..State::default() }))
        })
    }

    /// Checks that a run can start, as [`Trainer::new`] does, but for the memory that is free and a dead start. Settings and
    /// scene suffice, so that it takes milliseconds.
    ///
    /// # Errors
    /// Those of [`Trainer::new`].
    pub fn check(config: &Resolved, scene: &Scene, dtype: DType, runtime: &Runtime) -> Result<()> {
        accelerator::check(config, runtime)?;
        runtime.install(|| Model::check(config, scene, dtype, runtime))
    }

    /// Returns the configuration at the start.
    pub fn config(&self) -> &Resolved {
        &self.config
    }

    /// Returns the trained model. Its variables hold the parameters after the newest step, until the next one.
    ///
    /// # Errors
    /// [`Error::Diverged`]: a number of the steps was not finite, or all rays stayed empty too long. The parameters cannot
    /// be read from their device.
    pub fn model(&self) -> Result<&Model> {
        self.stepper.borrow_mut().fetch()?;
        if self.shown.get().is_none() {
            // What is hidden depends on the step, and is computed from the fetched parameters.
            let _ = self.shown.set(self.model.at_step(&self.config, self.state.step)?);
        }
        Ok(self.shown.get().expect("it was set"))
    }

    /// Returns the number of completed steps.
    pub fn step_count(&self) -> u64 {
        self.state.step
    }

    /// Returns how often each part of the model (see [`Model::parts`]) was initialized again because it started dead.
    pub fn redraws(&self) -> &[u64] {
        &self.state.redraws
    }

    /// Returns the log columns of the learner's terms and diagnostics.
    pub fn columns(&self) -> LogColumns {
        self.stepper.borrow().columns()
    }

    /// Adds a custom term to the loss; see [`Learner::add_term`](crate::methods::Learner::add_term).
    ///
    /// # Errors
    /// A term of that name exists, or the method cannot compute it.
    pub fn add_term(&mut self, term: LossTerm, weight: f64) -> Result<()> {
        self.stepper.get_mut().add_term(term, weight)
    }

    /// Adds a site of your own to the perturbed pass; see
    /// [`Learner::add_site`](crate::methods::Learner::add_site).
    ///
    /// # Errors
    /// A site of that name exists, no pass is perturbed, or the method or device takes none.
    pub fn add_site(&mut self, site: impl Site + 'static) -> Result<()> {
        self.stepper.get_mut().add_site(Arc::new(site))
    }

    /// Takes one step and waits for its measurements. With `log`, the learner computes its diagnostics.
    ///
    /// # Errors
    /// [`Error::Diverged`]: a loss, gradient or parameter is not a number, or all rays stay empty too long.
    pub fn step(&mut self, log: bool) -> Result<StepStats> {
        let stats = self.step_unless(log, true, &|| Ok(()))?;
        Ok(stats.expect("a step that was waited for has measurements"))
    }

    /// Takes one step and calls the check repeatedly. An error of the check ends the step, which then does not count.
    /// Unless it should `wait` for the step's measurements, they come with those of a later one: a device then need not
    /// stop after every step. With `log`, the learner computes its diagnostics.
    ///
    /// # Errors
    /// Those of [`Trainer::step`], of this step or an earlier one, and of the check.
    pub fn step_unless(&mut self, log: bool, wait: bool, stop_check: &StopCheck) -> Result<Option<StepStats>> {
        self.runtime.clone().install(|| self.step_here(log, wait, stop_check))
    }

    /// Waits for the measurements of all steps, and returns the last step's, if they were not returned before.
    ///
    /// # Errors
    /// Those of [`Trainer::step`].
    pub fn catch_up(&mut self) -> Result<Option<StepStats>> {
        self.stepper.get_mut().catch_up()
    }

    fn step_here(&mut self, log: bool, wait: bool, stop_check: &StopCheck) -> Result<Option<StepStats>> {
        self.shown.take();
        let State { step, adam_since, .. } = self.state;
        let rate = learning_rate(&self.config, step);
        let at = StepAt { step, updates: step + 1 - adam_since, learning_rate: rate, log };
        let stepper = self.stepper.get_mut();
        stepper.step(at, stop_check)?;
        let stats = if wait || stepper.is_due() { stepper.catch_up()? } else { None };
        self.state.step += 1;
        Ok(stats)
    }
}

#[cfg(test)]
mod tests;
