//! What a step of fields reports, wherever it is computed.

use crate::methods::diagnostics::{self, SiteDiagnostics};
use crate::methods::learner::{LogColumns, Term};
use crate::methods::{Extremes, StepReport};
use crate::settings::Config;

use super::plan::Plan;

/// Returns the columns that the steps of a configuration with terms of these names log, in order.
pub fn log_columns<'a>(config: &Config, plan: &Plan, terms: impl Iterator<Item = &'a str>) -> LogColumns {
    let photometric = plan.clean.iter().map(|pass| if pass.is_coarse { "loss_coarse" } else { "loss_fine" });
    let mut further: Vec<String> = terms.map(column_of).collect();
    if let Some(second) = plan.second.first() {
        further.push("loss_perturbed".into());
        if second.deltas.is_some() {
            further.extend(config.perturb.sites_on().flat_map(|(site, _)| diagnostics::site_columns(site.name())));
        }
    }
    LogColumns { photometric: photometric.map(String::from).collect(), further }
}

/// The losses of a step, or of a part of its rays, before their weights.
#[derive(Clone, Copy, Debug, Default)]
pub struct StepLosses {
    /// Mean squared error of the clean coarse pass.
    pub coarse: Option<f64>,
    /// That of the clean fine pass.
    pub fine: Option<f64>,
    /// Weighted sum of those of the perturbed passes.
    pub perturbed: Option<f64>,
}

impl StepLosses {
    /// Returns the report of the step after `step` finished ones. `further` has name, weight and value of each further term.
    /// `sites` makes the diagnostics, from the loss of the clean passes.
    ///
    /// # Panics
    /// There is no clean pass.
    pub fn report(
        &self,
        plan: &Plan,
        step: u64,
        further: &[(&str, f64, f64)],
        extremes: Extremes,
        sites: impl FnOnce(f64) -> Vec<SiteDiagnostics>,
    ) -> StepReport {
        let ((clean_weight, perturbed_weight), coarse_weight) = (plan.loss_weights(step), plan.clean[0].weight);
        let passes = [
            ("loss_coarse", "loss of the clean coarse pass", self.coarse, clean_weight * coarse_weight),
            ("loss_fine", "loss of the clean fine pass", self.fine, clean_weight),
            ("loss_perturbed", "loss of the perturbed pass", self.perturbed, perturbed_weight),
        ];
        let term_of_pass = |(name, described, value, weight): (&str, &str, Option<f64>, f64)| {
            value.map(|value| Term { name: name.into(), described: described.into(), value, weight })
        };
        let mut terms: Vec<Term> = passes.into_iter().filter_map(term_of_pass).collect();
        let clean = coarse_weight * self.coarse.unwrap_or(0.0) + self.fine.unwrap_or(0.0);
        let mut loss = clean_weight * clean + self.perturbed.map_or(0.0, |loss| perturbed_weight * loss);
        loss += further.iter().map(|(_, weight, value)| weight * value).sum::<f64>();
        terms.extend(further.iter().map(|&(name, weight, value)| Term {
            name: column_of(name),
            described: format!("regularizer {name}"),
            value,
            weight,
        }));
        let mse = self.fine.or(self.coarse).expect("every step has a pass that is evaluated");
        StepReport { sites: sites(clean), ..StepReport::new(terms, loss, mse, extremes) }
    }
}

fn column_of(term: &str) -> String {
    format!("regularizer.{term}")
}
