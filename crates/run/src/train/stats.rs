//! What a step measured.

use crate::methods::{SiteDiagnostics, Term};

/// What one step measured.
#[derive(Clone, Debug)]
pub struct StepStats {
    /// Steps finished, this one included.
    pub step: u64,
    /// Learning rate of this step's update.
    pub learning_rate: f64,
    /// What the loss is made of.
    pub terms: Vec<Term>,
    /// What was minimised: the weighted sum of the terms.
    pub loss: f64,
    /// Mean squared error of the batch's colours in the pass that is evaluated.
    pub mse: f64,
    /// Largest accumulation of a ray in the pass that is evaluated, without density noise.
    pub largest_acc: f64,
    /// Per site that is on, at log steps.
    pub sites: Vec<SiteDiagnostics>,
}

impl StepStats {
    /// PSNR of the batch in the pass that is evaluated, dB, unrounded. None where the error is 0.
    pub fn psnr(&self) -> Option<f64> {
        (self.mse > 0.0).then(|| -10.0 * self.mse.log10())
    }

    /// The unweighted value of the term in column `name`, where there is one.
    pub fn term(&self, name: &str) -> Option<f64> {
        self.terms.iter().find(|term| term.name == name).map(|term| term.value)
    }
}
