//! Measurements of a training step.

use crate::methods::{Extremes, SiteDiagnostics, StepAt, StepReport, Term};

/// Measurements of one step.
#[derive(Clone, Debug)]
pub struct StepStats {
    /// Completed steps, this one included.
    pub step: u64,
    /// Learning rate of this step's update.
    pub learning_rate: f64,
    /// The terms of the loss.
    pub terms: Vec<Term>,
    /// The training loss: the weighted sum of the terms.
    pub loss: f64,
    /// Mean squared error of the batch's colours in the evaluated pass.
    pub mse: f64,
    /// Extremes of the rays in the evaluated pass; accumulations are without density noise.
    pub extremes: Extremes,
    /// Diagnostics of each active site, at log steps.
    pub sites: Vec<SiteDiagnostics>,
    /// What was measured of the weights, by columns.
    pub of_weights: Vec<(String, f64)>,
}

impl StepStats {
    /// Returns the measurements of the step at a place.
    pub(super) fn new(
        at: StepAt,
        StepReport { terms, loss, mse, extremes, sites, of_weights }: StepReport,
    ) -> StepStats {
        StepStats { step: at.step + 1, learning_rate: at.learning_rate, terms, loss, mse, extremes, sites, of_weights }
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
