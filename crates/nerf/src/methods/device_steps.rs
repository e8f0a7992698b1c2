//! Steps on an accelerator, as a training sees them.

use crate::base::Result;
use crate::optimizer::Moments;

use super::learner::{LogColumns, StepReport};

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

/// Takes the steps of a training on a device that keeps parameters and Adam's moments.
pub trait DeviceSteps: Send {
    /// Returns the columns that its steps log, in order.
    fn columns(&self) -> LogColumns;

    /// Takes a step: loss, gradients and update. Its random numbers depend on seed and step only. It may return before the
    /// device is done.
    ///
    /// # Errors
    /// [`not_finite`](super::not_finite), for something in an earlier step that is not finite.
    fn step(&mut self, at: StepAt) -> Result<()>;

    /// Returns the reports of the steps since the last call, in their order. It waits for them.
    ///
    /// # Errors
    /// [`not_finite`](super::not_finite), for the first of these steps with something that is not finite. No later step
    /// changed a parameter.
    fn reports(&mut self) -> Result<Vec<StepReport>>;

    /// Returns the most steps whose reports it keeps. [`DeviceSteps::reports`] is called after at most so many.
    fn most_reports(&self) -> usize;

    /// Copies parameters into the model's variables, and returns the moments in their order.
    ///
    /// # Errors
    /// The device was lost.
    fn fetch(&mut self) -> Result<Vec<Moments>>;
}
