//! The trainer's view of a method.

use crate::base::Result;
use crate::losses::LossTerm;

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

/// The result of a step.
pub struct StepResult {
    /// Gradients of the loss, in the order of the model's variables.
    pub gradients: Gradients,
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
}

/// The columns that a learner fills in the logs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LogColumns {
    /// Losses of rendered colours. They come before `psnr`.
    pub photometric: Vec<String>,
    /// Other terms and diagnostics. They come last.
    pub further: Vec<String>,
}

/// Returns an error if the current work is to stop before it is done.
pub type StopCheck<'a> = dyn Fn() -> Result<()> + Sync + 'a;

/// Trains a model's parameters on a scene's training views.
pub trait Learner: Send {
    /// Returns the columns that its steps log, in order.
    fn columns(&self) -> LogColumns;

    /// Adds a term of your own to the loss, with `weight`. It is logged as `regularizer.NAME` after those of the
    /// configuration. It does not count in the configuration's hash.
    ///
    /// # Errors
    /// If there is a term of that name, or the method cannot compute it.
    fn add_term(&mut self, term: LossTerm, weight: f64) -> Result<()>;

    /// Computes loss and gradients of the step after `step` finished ones. It changes no parameter. Its random numbers
    /// depend on seed and step only. `log` requests diagnostics, which cost additional passes. A long step calls
    /// `stop_check` regularly, and ends with its error.
    fn step(&mut self, step: u64, log: bool, stop_check: &StopCheck) -> Result<StepResult>;
}
