//! What a step minimizes next to the photometric losses: terms on the rays of its clean passes, and terms in space.

use candle_core::{DType, Tensor};

use crate::base::Result;
use crate::base::tensors::sum;
use crate::field::Field;
use crate::losses::{LossTerm, RayPass, RayTerm, SpaceTerm, WeightedTerm};
use crate::render::{Pass, PassLoss, clean_pass, clean_pass_loss, photometric_loss};
use crate::settings::RegularizedFields;

use super::learner::FieldLearner;
use super::report::loss_weights;
use super::results::ChunkResult;

/// What the passes of a step minimize.
#[derive(Clone, Copy)]
pub(super) struct StepLoss<'a> {
    /// Weight of the clean passes' photometric loss.
    pub clean: f64,
    /// Weight of the perturbed passes' loss.
    pub perturbed: f64,
    /// Additional terms. Those on rays count in clean passes.
    pub terms: &'a [WeightedTerm],
    /// The fields whose passes they count in.
    pub fields: RegularizedFields,
}

impl StepLoss<'_> {
    /// Returns the terms on rays, with whether they count in a clean pass: of the evaluated field, or of the coarse one
    /// before it.
    fn terms_on(&self, is_evaluated: bool) -> impl Iterator<Item = (&dyn RayTerm, f64, bool)> {
        let both = self.fields == RegularizedFields::Both;
        let counts = move |term: &dyn RayTerm| is_evaluated || both && !term.is_of_evaluated_pass();
        self.terms.iter().filter_map(move |WeightedTerm { term, weight, .. }| match term {
            LossTerm::OnRays(term) => Some((&**term, *weight, counts(&**term))),
            LossTerm::InSpace(_) | LossTerm::OnTables(_) => None,
        })
    }
}

/// The weights of a clean pass in a step.
#[derive(Clone, Copy)]
pub(super) struct Counts {
    /// Weight of its photometric loss, including its fraction of the step's rays.
    pub weight: f64,
    /// Its fraction of the step's rays.
    pub share: f64,
    /// The pass is the evaluated one.
    pub is_evaluated: bool,
}

/// The terms in space with their weights.
pub(super) fn in_space(terms: &[WeightedTerm]) -> Vec<(&dyn SpaceTerm, f64)> {
    let in_space = terms.iter().filter_map(|WeightedTerm { term, weight, .. }| match term {
        LossTerm::InSpace(term) => Some((&**term, *weight)),
        LossTerm::OnRays(_) | LossTerm::OnTables(_) => None,
    });
    in_space.collect()
}

/// The values of all terms in their order, from those of each kind in theirs.
pub(super) fn in_order(terms: &[WeightedTerm], on_rays: &[f64], in_space: &[f64], on_tables: &[f64]) -> Vec<f64> {
    let (mut on_rays, mut in_space, mut on_tables) = (on_rays.iter(), in_space.iter(), on_tables.iter());
    let value = |WeightedTerm { term, .. }: &WeightedTerm| {
        let value = match term {
            LossTerm::OnRays(_) => on_rays.next(),
            LossTerm::InSpace(_) => in_space.next(),
            LossTerm::OnTables(_) => on_tables.next(),
        };
        *value.expect("every term has a value")
    };
    terms.iter().map(value).collect()
}

impl FieldLearner {
    /// What a step of this run minimizes, with these terms.
    pub(super) fn step_loss<'a>(&self, terms: &'a [WeightedTerm]) -> StepLoss<'a> {
        let (clean, perturbed) = loss_weights(&self.config);
        StepLoss { clean, perturbed, terms, fields: self.config.regularizer.fields }
    }

    /// Renders a clean pass and adds the gradients of its photometric loss and of the terms on its rays, in one way back.
    /// Returns the photometric loss times the share; the terms' means over the rays, unweighted, are added to the
    /// result's losses.
    pub(super) fn descend_clean(
        &self,
        field: &Field,
        pass: Pass,
        target: &Tensor,
        step_loss: StepLoss,
        Counts { weight, share, is_evaluated }: Counts,
        result: &mut ChunkResult,
    ) -> Result<(Tensor, PassLoss)> {
        if !step_loss.terms_on(is_evaluated).any(|(.., counts)| counts) {
            let out = clean_pass_loss(field, pass, target)?;
            let loss = self.descend(&out.loss, weight, &mut result.gradients)?;
            return Ok(((loss * share)?, out));
        }
        let out = clean_pass(field, pass)?;
        let seen = RayPass { output: &out, bounds: self.bounds, direction_norm: &pass.rays.direction_norm };
        let loss = photometric_loss(&out.composite.rgb, target)?;
        let mut total = (&loss * weight)?;
        let mut values = Vec::new();
        for (term, weight, counts) in step_loss.terms_on(is_evaluated) {
            if !counts {
                values.push(Tensor::zeros((), DType::F64, &self.device)?);
                continue;
            }
            let mean = term.per_ray(&seen)?.mean_all()?;
            total = (total + (&mean * (weight * share))?.to_dtype(loss.dtype())?)?;
            values.push((mean.detach().to_dtype(DType::F64)? * share)?);
        }
        result.gradients.add(&self.variables, &total.backward()?)?;
        result.losses.on_rays = sum(result.losses.on_rays.take(), Some(Tensor::stack(&values, 0)?))?;
        Ok(((loss.detach().to_dtype(DType::F64)? * share)?, PassLoss::of(out, target)?))
    }
}
