//! What a step of fields reports, wherever it is computed.

use crate::methods::diagnostics;
use crate::methods::learner::{LogColumns, Term};
use crate::settings::{Config, Objective};

/// Returns the columns that the steps of a configuration with terms of these names log, in order.
pub fn log_columns<'a>(config: &Config, terms: impl Iterator<Item = &'a str>) -> LogColumns {
    let mut photometric = Vec::new();
    if config.representation().has_coarse_loss() {
        photometric.push("loss_coarse".to_string());
    }
    if config.sampling.fine > 0 {
        photometric.push("loss_fine".into());
    }
    let mut further: Vec<String> = terms.map(column_of).collect();
    if config.method.is_augmented() {
        further.push("loss_perturbed".into());
        if config.perturb.source().is_some() {
            further.extend(config.perturb.sites_on().flat_map(|(site, _)| diagnostics::columns(site.name())));
        }
    }
    LogColumns { photometric, further }
}

/// Of the hash grid's entries that a step changes, the share that only its second pass changes.
pub(super) const ONLY_SECOND: &str = "only_second.entries";

/// Returns the weights of clean and perturbed loss in the step after `step` finished ones.
pub fn loss_weights(config: &Config, step: u64) -> (f64, f64) {
    let lambda = config.perturb.lambda_schedule.at(config.perturb.lambda, step);
    match (config.method.is_augmented(), config.perturb.objective) {
        (false, _) => (1.0, 0.0),
        (true, Objective::Paper) => (1.0, lambda),
        (true, Objective::Released) => (1.0 - lambda, lambda),
    }
}

/// Returns the weight of the coarse pass's loss, which is 1 if it is the only pass.
pub fn coarse_weight(config: &Config) -> f64 {
    if config.sampling.fine > 0 { config.train.coarse_weight } else { 1.0 }
}

/// The losses of a step before their weights.
pub struct StepLosses<'a> {
    /// Mean squared error of the clean coarse pass.
    pub coarse: Option<f64>,
    /// That of the clean fine pass.
    pub fine: Option<f64>,
    /// Weighted sum of those of the perturbed passes.
    pub perturbed: Option<f64>,
    /// Name, weight and value of each further term.
    pub further: Vec<(&'a str, f64, f64)>,
}

impl StepLosses<'_> {
    /// Returns the loss of the clean passes.
    pub fn clean(&self, config: &Config) -> f64 {
        coarse_weight(config) * self.coarse.unwrap_or(0.0) + self.fine.unwrap_or(0.0)
    }

    /// Returns the mean squared error of the evaluated pass.
    ///
    /// # Panics
    /// There is no clean pass.
    pub fn mse(&self) -> f64 {
        self.fine.or(self.coarse).expect("every step has a pass that is evaluated")
    }

    /// Returns the weighted terms of the step after `step` finished ones, and their sum.
    pub fn terms(&self, config: &Config, step: u64) -> (Vec<Term>, f64) {
        let (clean_weight, perturbed_weight) = loss_weights(config, step);
        let passes = [
            ("loss_coarse", "loss of the clean coarse pass", self.coarse, clean_weight * coarse_weight(config)),
            ("loss_fine", "loss of the clean fine pass", self.fine, clean_weight),
            ("loss_perturbed", "loss of the perturbed pass", self.perturbed, perturbed_weight),
        ];
        let of_pass = |(name, described, value, weight): (&str, &str, Option<f64>, f64)| {
            value.map(|value| Term { name: name.into(), described: described.into(), value, weight })
        };
        let mut terms: Vec<Term> = passes.into_iter().filter_map(of_pass).collect();
        let mut loss = clean_weight * self.clean(config) + self.perturbed.map_or(0.0, |loss| perturbed_weight * loss);
        loss += self.further.iter().map(|(_, weight, value)| weight * value).sum::<f64>();
        terms.extend(self.further.iter().map(|&(name, weight, value)| Term {
            name: column_of(name),
            described: format!("regularizer {name}"),
            value,
            weight,
        }));
        (terms, loss)
    }
}

fn column_of(term: &str) -> String {
    format!("regularizer.{term}")
}
