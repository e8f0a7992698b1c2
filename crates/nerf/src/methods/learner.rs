//! A method's view of a step: loss and gradients.

use candle_core::Tensor;

use std::sync::Arc;

use crate::base::{Error, Result};
use crate::losses::LossTerm;
use crate::perturb::Site;

use super::diagnostics::SiteDiagnostics;
use super::extremes::Extremes;
use super::gradients::Gradients;

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
    /// What was measured of the weights, by columns.
    pub weight_columns: Vec<(String, f64)>,
}

impl StepReport {
    /// Returns the report of a step without sites and moved weights.
    pub fn new(terms: Vec<Term>, loss: f64, mse: f64, extremes: Extremes) -> StepReport {
        StepReport { terms, loss, mse, extremes, sites: Vec::new(), weight_columns: Vec::new() }
    }
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
pub fn no_sites(site: &dyn Site) -> Error {
    Error::Config(format!(
        "the site '{}' cannot be added: only radiance fields on the processor take sites of your own",
        site.name()
    ))
}

/// Returns an error if the current work is to stop before it is done.
pub type StopCheck<'a> = dyn Fn() -> Result<()> + Sync + 'a;

/// Computes what trains a model's parameters on a scene's training views. Adam then updates them.
pub trait Learner: Send {
    /// Returns the columns that its steps log, in order.
    fn columns(&self) -> LogColumns;

    /// Adds a term of your own to the loss, with `weight`. It is logged as `regularizer.NAME` after those of the
    /// configuration. It does not count in the configuration's hash.
    ///
    /// # Errors
    /// If there is a term of that name, or the method cannot compute it.
    fn add_term(&mut self, term: LossTerm, _weight: f64) -> Result<()> {
        Err(Error::Config(format!(
            "the term '{}' needs a radiance field's samples, density or tables, which this method lacks; use nerf or aug-nerf",
            term.name()
        )))
    }

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

    /// Brings what follows the parameters up to date, once after the update with which `finished` steps are done.
    ///
    /// # Errors
    /// Those of candle.
    fn updated(&mut self, _finished: u64) -> Result<()> {
        Ok(())
    }

    /// Computes loss and gradients of the step after `step` finished ones. It changes no parameter. Its random numbers
    /// depend on seed and step only. `log` requests diagnostics, which cost additional passes. A long step calls
    /// `stop_check` regularly, and ends with its error.
    fn step(&mut self, step: u64, log: bool, stop_check: &StopCheck) -> Result<StepResult>;
}

/// Returns the error for a number that is not finite. `step` counts the diverged step, `what` names the tensor, and
/// `learning_rate` is the configured one.
pub fn not_finite(step: u64, what: &str, learning_rate: f64) -> Error {
    Error::Diverged(format!(
        "training diverged at step {step}: the {what} is not a number; lower train.learning_rate \
         ({learning_rate}), or step sizes and weights in sections perturb, regularizer, srn or nv, and start a new run"
    ))
}
