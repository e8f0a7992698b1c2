//! One training step: its passes and its terms in space.

use std::sync::Arc;

use candle_core::Tensor;

use crate::base::{Error, Result};
use crate::losses::{LossTerm, TermSource, WeightedTerm};
use crate::methods::diagnostics::columns as site_columns;
use crate::methods::learner::{Learner, LogColumns, StepResult, StopCheck};
use crate::methods::stepper::StepReport;
use crate::perturb::{PaperSite, Site};
use crate::render::render_rays;
use crate::runtime::over_parts;
use crate::settings::{DeltaSource, Encoding};

use super::learner::FieldLearner;
use super::report::{ONLY_SECOND, StepLosses, log_columns};
use super::results::ChunkResult;
use super::terms::{self, TermValues};

impl Learner for FieldLearner {
    fn columns(&self) -> LogColumns {
        let mut columns = log_columns(&self.config, self.terms.iter().map(|WeightedTerm { term, .. }| term.name()));
        columns.further.extend(self.own_sites.iter().flat_map(|site| site_columns(site.name())));
        if self.config.method.is_augmented() && self.separates_entries() {
            columns.further.push(ONLY_SECOND.into());
        }
        columns
    }

    fn add_term(&mut self, term: LossTerm, weight: f64) -> Result<()> {
        if self.terms.iter().any(|known| known.term.name() == term.name()) {
            let name = term.name();
            return Err(Error::Config(format!("the loss already has a term '{name}'; rename the new one")));
        }
        let reads_derivatives = match &term {
            LossTerm::InSpace(_) => true,
            LossTerm::OnRays(term, _) => term.reads_slopes(),
            LossTerm::OnTables(_) => false,
        };
        if reads_derivatives && !self.config.representation().has_derivatives_at_points() {
            return Err(Error::Config(format!(
                "the term '{}' needs density's derivatives at points, which method {} lacks; use nerf or aug-nerf",
                term.name(),
                self.config.method.name()
            )));
        }
        if matches!(term, LossTerm::OnTables(_)) && self.config.field.encoding != Encoding::Hash {
            let name = term.name();
            return Err(Error::Config(format!(
                "the term '{name}' needs the tables of a hash grid; set field.encoding = \"hash\""
            )));
        }
        let term = WeightedTerm::constant(term, weight);
        self.place_unseen_cameras(std::slice::from_ref(&term))?;
        self.terms.push(term);
        Ok(())
    }

    fn add_site(&mut self, site: Arc<dyn Site>) -> Result<()> {
        let (name, at) = (site.name(), site.at());
        let refuse = |why: &str| Err(Error::Config(format!("the site '{name}' cannot be added: {why}")));
        let perturb = &self.config.perturb;
        if !self.config.method.is_augmented() || perturb.source().is_none() {
            return refuse(
                "no pass of this training is perturbed; use --method aug-nerf and a perturb.kind with deltas",
            );
        }
        if perturb.source() == Some(DeltaSource::Permuted) {
            return refuse(
                "perturb.kind = \"permuted\" gives rays each other's deltas, and an own delta need not have rays",
            );
        }
        if name.is_empty()
            || !name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_' || c == '-')
        {
            return refuse(
                "its name must have lower-case letters, digits, '_' and '-' alone, because it names columns of the logs",
            );
        }
        if PaperSite::of_name(name).is_some() || self.own_sites.iter().any(|known| known.name() == name) {
            return refuse("there is a site of that name; rename it");
        }
        if at == PaperSite::View && !perturb.sites[PaperSite::View].on() {
            return refuse("rays have tangents at view only if the site view is on; set perturb.view.passes");
        }
        self.own_sites.push(site);
        Ok(())
    }

    fn has_colours(&self) -> bool {
        true
    }

    fn colours(&mut self, step: u64) -> Result<Option<Tensor>> {
        let fields = self.fields.at_step(&self.config, step)?.frozen()?;
        let rays = self.batches.batch(step).rays.to_tensors(self.dtype, &self.device)?;
        let (sampling, size) = (&self.config.sampling, self.config.train.chunk);
        let starts: Vec<usize> = (0..rays.len()).step_by(size).collect();
        let of_part = |starts: &[usize]| -> Result<Tensor> {
            let part = rays.narrow(starts[0], size.min(rays.len() - starts[0]))?;
            Ok(render_rays(&fields.coarse, fields.fine(), &part, self.bounds, sampling, self.background)?.rgb)
        };
        Ok(Some(Tensor::cat(&over_parts(&self.device, &starts, 1, of_part)?, 0)?))
    }

    fn step(&mut self, step: u64, log: bool, stop_check: &StopCheck) -> Result<StepResult> {
        self.fields = self.fields.at_step(&self.config, step)?;
        let whole = self.draw(step)?;
        let weighted: Vec<WeightedTerm> = self.terms.iter().map(|term| term.at(step)).collect();
        let ChunkResult { mut gradients, losses, only_second, diagnostics, .. } =
            self.passes(&whole, self.step_loss(&weighted, step), log, stop_check)?;
        let mut values = TermValues::of(&weighted);
        values.fill(TermSource::TrainingRays, &losses.on_rays()?);
        for group in terms::unseen_groups(&weighted) {
            let unseen = self.on_unseen(group, &weighted, step, stop_check)?;
            gradients.merge(unseen.gradients)?;
            values.fill(TermSource::UnseenRays(group), &unseen.losses.on_rays()?);
        }
        let terms_in_space = terms::in_space(&weighted);
        let regularized = self.regularize(&terms_in_space, &self.config.regularizer, step, stop_check)?;
        if let Some((in_space, of_terms)) = regularized {
            gradients.merge(of_terms)?;
            values.fill(TermSource::Space, &in_space.to_vec1::<f64>()?);
        }
        for WeightedTerm { term, weight, .. } in &weighted {
            if let LossTerm::OnTables(decay) = term {
                let (value, of_tables) = self.decay(*decay, *weight, &self.config.regularizer, &gradients)?;
                gradients.merge(of_tables)?;
                values.fill(TermSource::Tables, &[value]);
            }
        }
        let ([coarse, fine, perturbed], extremes) = losses.read()?;
        let step_losses = StepLosses { coarse, fine, perturbed, further: values.finish() };
        let clean = step_losses.clean(&self.config);
        let (terms, loss) = step_losses.terms(&self.config, step);
        let report = StepReport {
            terms,
            loss,
            mse: step_losses.mse(),
            extremes,
            sites: diagnostics.map_or_else(Vec::new, |sums| sums.finish(clean)),
            of_weights: only_second.map(|share| (ONLY_SECOND.to_string(), share)).into_iter().collect(),
        };
        Ok(StepResult { gradients, report })
    }
}
