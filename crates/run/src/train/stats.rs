//! Measurements of a training step.

use std::ops::Deref;

use crate::methods::{StepAt, StepReport};

/// Measurements of one step, and its place in the training.
#[derive(Clone, Debug)]
pub struct StepStats {
    /// Completed steps, this one included.
    pub step: u64,
    /// Learning rate of this step's update.
    pub learning_rate: f64,
    /// What was measured.
    pub report: StepReport,
}

impl Deref for StepStats {
    type Target = StepReport;

    fn deref(&self) -> &StepReport {
        &self.report
    }
}

impl StepStats {
    /// Returns the measurements of the step at a place.
    pub(super) fn new(at: StepAt, report: StepReport) -> StepStats {
        StepStats { step: at.step + 1, learning_rate: at.learning_rate, report }
    }

    /// Returns the PSNR of the batch in the evaluated pass in dB, unrounded, or `None` if the error is 0.
    pub fn psnr(&self) -> Option<f64> {
        (self.mse > 0.0).then(|| -10.0 * self.mse.log10())
    }

    /// Returns the unweighted value of the term in column `name`, if there is one.
    pub fn term(&self, name: &str) -> Option<f64> {
        self.terms.iter().find(|term| term.name == name).map(|term| term.value)
    }
}
