//! A method's view of a step: loss and gradients.

use candle_core::Tensor;

use std::sync::Arc;

use crate::base::{Error, Result};
use crate::losses::LossTerm;
use crate::perturb::Site;

use super::gradients::Gradients;
use super::stepper::StepReport;

/// A term of a step's loss.
#[derive(Clone, Debug, PartialEq)]
pub struct Term {
    /// Its column in the logs: `loss_coarse`, `regularizer.tv`.
    pub name: String,
    /// Its description in a sentence: "loss of the clean coarse pass".
    pub described: String,
    /// Its measured value, before the weight.
    pub value: f64,
    /// Its weight in the loss.
    pub weight: f64,
}

/// The result of a step, before its update.
pub struct StepResult {
    /// Gradients of the loss, in the order of the model's variables.
    pub gradients: Gradients,
    /// Measurements of the step.
    pub report: StepReport,
}

/// The columns that a learner fills in the logs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LogColumns {
    /// Losses of rendered colours. They come before `psnr`.
    pub photometric: Vec<String>,
    /// Other terms and diagnostics. They come last.
    pub further: Vec<String>,
}

/// Returns the error of a method or device without sites of your own.
pub(super) fn no_sites(site: &dyn Site) -> Error {
    Error::Config(format!(
        "the site '{}' cannot be added: only radiance fields on the processor take sites of your own",
        site.name()
    ))
}

/// Returns an error if the current work is to stop before it is done.
pub type StopCheck<'a> = dyn Fn() -> Result<()> + Sync + 'a;

/// Computes what trains a model's parameters on a scene's training views. A [`Stepper`](super::Stepper) updates them.
pub trait Learner: Send {
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
    /// If there is a site of that name, no pass is perturbed, or the method has no sites.
    fn add_site(&mut self, site: Arc<dyn Site>) -> Result<()> {
        Err(no_sites(&*site))
    }

    /// Returns whether the method tells the colours of a step's rays ([`Learner::colours`]).
    fn has_colours(&self) -> bool {
        false
    }

    /// Returns the colours that the rays of the step after `step` finished ones have in an evaluation, `[rays, 3]`. `None`
    /// if the method does not tell.
    fn colours(&mut self, _step: u64) -> Result<Option<Tensor>> {
        Ok(None)
    }

    /// Computes loss and gradients of the step after `step` finished ones. It changes no parameter. Its random numbers
    /// depend on seed and step only. `log` requests diagnostics, which cost additional passes. A long step calls
    /// `stop_check` regularly, and ends with its error.
    fn step(&mut self, step: u64, log: bool, stop_check: &StopCheck) -> Result<StepResult>;
}
