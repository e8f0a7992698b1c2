//! The trainer's view of the steps of a training, wherever its parameters are kept.

use std::sync::Arc;

use crate::base::{Error, Result};
use crate::losses::LossTerm;
use crate::optimizer::Moments;
use crate::perturb::Site;

use super::diagnostics::SiteDiagnostics;
use super::extremes::Extremes;
use super::learner::{LogColumns, StopCheck, Term, no_sites};

/// Measurements of a step.
#[derive(Clone, Debug)]
pub struct StepReport {
    /// The terms of the loss.
    pub terms: Vec<Term>,
    /// The weighted sum of the terms, in the learner's own order of additions.
    pub loss: f64,
    /// Mean squared error of the colours that an evaluation would show, over rays and channels. A batch's PSNR is made
    /// of it.
    pub mse: f64,
    /// Extremes of accumulation and colours over the rays, as an evaluation would show them.
    pub extremes: Extremes,
    /// Diagnostics of each site, at log steps.
    pub sites: Vec<SiteDiagnostics>,
    /// What a stepper measured of the weights, by columns.
    pub of_weights: Vec<(String, f64)>,
}

/// The place of a step in a training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepAt {
    /// Number of finished steps.
    pub step: u64,
    /// Number of Adam's updates, this step's included.
    pub updates: u64,
    /// The learning rate of the update.
    pub learning_rate: f64,
    /// Requests diagnostics, which may cost additional passes.
    pub log: bool,
}

/// Takes the steps of a training. Parameters and Adam's moments may be kept anywhere: in the model's variables
/// ([`HostStepper`](super::HostStepper)), or on an accelerator.
pub trait Stepper: Send {
    /// Returns the columns that its steps log, in order.
    fn columns(&self) -> LogColumns;

    /// Adds a term of your own to the loss, with `weight`. It is logged as `regularizer.NAME` after those of the
    /// configuration. It does not count in the configuration's hash.
    ///
    /// # Errors
    /// If there is a term of that name, or the method cannot compute it.
    fn add_term(&mut self, term: LossTerm, weight: f64) -> Result<()>;

    /// Adds a site of your own to the perturbed pass. Its diagnostics are logged after those of the configuration. It does not
    /// count in the configuration's hash.
    ///
    /// # Errors
    /// If there is a site of that name, no pass is perturbed, or the method or device takes none.
    fn add_site(&mut self, site: Arc<dyn Site>) -> Result<()> {
        Err(no_sites(&*site))
    }

    /// Takes a step: loss, gradients and update. Its random numbers depend on seed and step only. A long step calls
    /// `stop_check` regularly, and ends with its error. It then has changed no parameter and no moment. A device may
    /// return before it is done.
    ///
    /// # Errors
    /// [`not_finite`], for a term, a gradient or a parameter that is not finite; those of the check.
    fn step(&mut self, at: StepAt, stop_check: &StopCheck) -> Result<()>;

    /// Returns the reports of the steps since the last call, in their order. It waits for them.
    ///
    /// # Errors
    /// [`not_finite`], for the first of these steps with something that is not finite.
    fn reports(&mut self) -> Result<Vec<StepReport>>;

    /// Returns the most steps whose reports it keeps. [`Stepper::reports`] is called after at most so many.
    fn most_reports(&self) -> usize {
        1
    }

    /// Computes loss and gradients of the step after `step` finished ones, to the end, and drops them. It changes no
    /// parameter and no moment.
    ///
    /// # Errors
    /// Those of the check.
    fn try_step(&mut self, step: u64, stop_check: &StopCheck) -> Result<()>;

    /// Brings parameters into the model's variables, and moments into [`Stepper::moments`], if they are kept elsewhere.
    ///
    /// # Errors
    /// The parameters cannot be read from their device.
    fn fetch(&mut self) -> Result<()>;

    /// Returns Adam's moments at the last [`Stepper::fetch`], or those it was created with, in the order of the model's
    /// variables.
    fn moments(&self) -> &[Moments];
}

/// Returns the error for a number that is not finite. `step` counts the diverged step, `what` names the tensor, and
/// `learning_rate` is the configured one.
pub fn not_finite(step: u64, what: &str, learning_rate: f64) -> Error {
    Error::Diverged(format!(
        "training diverged at step {step}: the {what} is not a number; lower train.learning_rate \
         ({learning_rate}), or step sizes and weights in sections perturb, regularizer, srn or nv, and start a new run"
    ))
}
