//! How a method learns, as the trainer sees it.

use crate::base::Result;
use crate::losses::LossTerm;

use super::diagnostics::SiteDiagnostics;
use super::gradients::Gradients;

/// A term of a step's loss.
#[derive(Clone, Debug, PartialEq)]
pub struct Term {
    /// Its column in the logs: `loss_coarse`, `regularizer.tv`.
    pub name: String,
    /// The same in a sentence: "loss of the clean coarse pass".
    pub described: String,
    /// What was measured, before its weight.
    pub value: f64,
    /// What it counts in the loss.
    pub weight: f64,
}

/// What a step learned.
pub struct StepResult {
    /// Of the loss, in the order of the model's variables.
    pub gradients: Gradients,
    /// What the loss is made of.
    pub terms: Vec<Term>,
    /// The weighted sum of the terms, in the learner's own order of additions.
    pub loss: f64,
    /// Mean squared error of the colours that an evaluation would show, over rays and channels: what a batch's PSNR is of.
    pub mse: f64,
    /// Largest accumulation of a ray, as an evaluation would see it.
    pub largest_acc: f64,
    /// Per perturbed level, at log steps.
    pub sites: Vec<SiteDiagnostics>,
}

/// The columns that a learner fills in the logs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LogColumns {
    /// Losses of rendered colours; they stand before `psnr`.
    pub photometric: Vec<String>,
    /// Other terms and diagnostics; they stand last.
    pub further: Vec<String>,
}

/// An error where the work at hand is to end before it is done.
pub type StopCheck<'a> = dyn Fn() -> Result<()> + Sync + 'a;

/// Learns a model's parameters from a scene's training views.
pub trait Learner: Send {
    /// What its steps log, in the order of columns.
    fn columns(&self) -> LogColumns;

    /// Adds a term of one's own to the loss, with `weight`. It is logged as `regularizer.NAME` after those of the
    /// configuration, and is no part of the configuration's hash.
    ///
    /// # Errors
    /// A term of that name is there already, or the method cannot compute it.
    fn add_term(&mut self, term: LossTerm, weight: f64) -> Result<()>;

    /// Draws the work of the step that follows `step` finished ones, by random numbers that depend on seed and step
    /// alone, and learns from it. Changes no parameter. `log` asks for diagnostics, which cost further passes. A long step asks
    /// `stop_check` again and again, and ends with its error.
    fn step(&mut self, step: u64, log: bool, stop_check: &StopCheck) -> Result<StepResult>;
}
