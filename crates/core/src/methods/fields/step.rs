//! One training step: its passes and its terms in space.

use crate::base::{Error, Result};
use crate::losses::{LossTerm, WeightedTerm};
use crate::methods::learner::{Learner, LogColumns, StepResult, StopCheck, Term};
use crate::methods::stepper::StepReport;

use super::learner::FieldLearner;
use super::results::ChunkResult;
use super::terms::{self, mixing};
use crate::methods::diagnostics;

impl Learner for FieldLearner {
    fn columns(&self) -> LogColumns {
        let config = &self.config;
        let mut photometric = Vec::new();
        if self.has_coarse_loss() {
            photometric.push("loss_coarse".to_string());
        }
        if config.sampling.fine > 0 {
            photometric.push("loss_fine".into());
        }
        let mut further: Vec<String> =
            self.terms.iter().map(|WeightedTerm { term, .. }| format!("regularizer.{}", term.name())).collect();
        if config.method.is_augmented() {
            further.push("loss_perturbed".into());
            if config.perturb.source().is_some() {
                further.extend(config.perturb.sites_on().flat_map(|(site, _)| diagnostics::columns(site)));
            }
        }
        LogColumns { photometric, further }
    }

    fn add_term(&mut self, term: LossTerm, weight: f64) -> Result<()> {
        if self.terms.iter().any(|known| known.term.name() == term.name()) {
            let name = term.name();
            return Err(Error::Config(format!("the loss already has a term '{name}'; rename the new one")));
        }
        if matches!(term, LossTerm::InSpace(_)) && !self.config.representation().has_derivatives_at_points() {
            return Err(Error::Config(format!(
                "the term '{}' needs density's derivatives at points, which method {} lacks; use nerf or aug-nerf",
                term.name(),
                self.config.method.name()
            )));
        }
        self.terms.push(WeightedTerm { term, weight });
        Ok(())
    }

    fn step(&mut self, step: u64, log: bool, stop_check: &StopCheck) -> Result<StepResult> {
        let whole = self.draw(step)?;
        let ChunkResult { mut gradients, losses, diagnostics, .. } =
            self.passes(&whole, self.step_loss(), log, stop_check)?;
        let mut in_space = Vec::new();
        let terms_in_space = terms::in_space(&self.terms);
        let regularized = self.regularize(&terms_in_space, &self.config.regularizer, step, stop_check)?;
        if let Some((values, terms)) = regularized {
            gradients.merge(terms)?;
            in_space = values.to_vec1::<f64>()?;
        }
        let on_rays = losses.on_rays.as_ref().map_or(Ok(Vec::new()), |values| values.to_vec1::<f64>())?;
        let regularizers = terms::in_order(&self.terms, &on_rays, &in_space);
        let ([coarse, fine, perturbed], extremes) = losses.read()?;
        let clean = self.coarse_weight(&self.fields) * coarse.unwrap_or(0.0) + fine.unwrap_or(0.0);
        let (terms, loss) = self.terms([coarse, fine, perturbed], regularizers);
        let report = StepReport {
            terms,
            loss,
            mse: fine.or(coarse).expect("every chunk has a pass that is evaluated"),
            extremes,
            sites: diagnostics.map_or_else(Vec::new, |sums| sums.finish(clean)),
        };
        Ok(StepResult { gradients, report })
    }
}

impl FieldLearner {
    /// Returns the weighted terms of a step and their sum, from the losses of its passes and its regularizers.
    fn terms(&self, [coarse, fine, perturbed]: [Option<f64>; 3], regularizers: Vec<f64>) -> (Vec<Term>, f64) {
        let (clean_weight, perturbed_weight) = mixing(&self.config);
        let coarse_weight = self.coarse_weight(&self.fields);
        let clean = coarse_weight * coarse.unwrap_or(0.0) + fine.unwrap_or(0.0);
        let mut loss = clean_weight * clean + perturbed.map_or(0.0, |loss| perturbed_weight * loss);
        let passes = [
            ("loss_coarse", "loss of the clean coarse pass", coarse, clean_weight * coarse_weight),
            ("loss_fine", "loss of the clean fine pass", fine, clean_weight),
            ("loss_perturbed", "loss of the perturbed pass", perturbed, perturbed_weight),
        ];
        let of_pass = |(name, described, value, weight): (&str, &str, Option<f64>, f64)| {
            value.map(|value| Term { name: name.into(), described: described.into(), value, weight })
        };
        let mut terms: Vec<Term> = passes.into_iter().filter_map(of_pass).collect();
        if !regularizers.is_empty() {
            let of_term = |(WeightedTerm { term, weight }, value): (&WeightedTerm, f64)| Term {
                name: format!("regularizer.{}", term.name()),
                described: format!("regularizer {}", term.name()),
                value,
                weight: *weight,
            };
            let regularizers: Vec<Term> = self.terms.iter().zip(regularizers).map(of_term).collect();
            loss += regularizers.iter().map(|term| term.weight * term.value).sum::<f64>();
            terms.extend(regularizers);
        }
        (terms, loss)
    }
}
