//! What a step minimizes next to the photometric losses: terms on the rays of its clean passes, and terms in space.

use candle_core::backprop::GradStore;
use candle_core::{DType, Tensor, Var};

use crate::base::Result;
use crate::base::tensors::sum;
use crate::data::RayGroup;
use crate::field::{Cotangents, Field, Order, Spatial};
use crate::losses::{LossTerm, RayPass, RayTerm, SpaceTerm, TermSource, WeightedTerm};
use crate::methods::gradients::Gradients;
use crate::render::{Pass, PassLoss, PassOutput, clean_pass, clean_pass_loss, photometric_loss, positions_at};
use crate::settings::RegularizedFields;

use super::learner::FieldLearner;
use super::report::loss_weights;
use super::results::ChunkResult;

/// What passes of a step minimize.
#[derive(Clone, Copy)]
pub(super) struct StepLoss<'a> {
    /// Weight of the clean passes' photometric loss.
    pub clean: f64,
    /// Weight of the perturbed passes' loss.
    pub perturbed: f64,
    /// Additional terms, of which those of `source` count in clean passes.
    pub terms: &'a [WeightedTerm],
    /// The rays of the passes: the step's own, or unseen ones.
    pub source: TermSource,
    /// The fields whose passes they count in.
    pub fields: RegularizedFields,
}

impl StepLoss<'_> {
    /// Returns the terms on rays of this source, with whether they count in a clean pass: of the evaluated field, or of
    /// the coarse one before it.
    fn terms_on(&self, is_evaluated: bool) -> impl Iterator<Item = (&dyn RayTerm, f64, bool)> {
        let both = self.fields == RegularizedFields::Both;
        let counts = move |term: &dyn RayTerm| is_evaluated || both && !term.is_of_evaluated_pass();
        self.terms.iter().filter(|weighted| weighted.term.source() == self.source).filter_map(move |weighted| {
            match &weighted.term {
                LossTerm::OnRays(term, _) => Some((&**term, weighted.weight, counts(&**term))),
                LossTerm::InSpace(_) | LossTerm::OnTables(_) => None,
            }
        })
    }

    /// Returns whether any of them counts in the coarse pass before the evaluated one.
    pub(super) fn counts_in_coarse_pass(&self) -> bool {
        self.terms_on(false).any(|(.., counts)| counts)
    }

    /// Returns the rays that belong together.
    pub(super) fn group(&self) -> RayGroup {
        match self.source {
            TermSource::UnseenRays(group) => group,
            TermSource::TrainingRays | TermSource::Space | TermSource::Tables => RayGroup::One,
        }
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

/// A rendered clean pass, whose terms are to be descended.
pub(super) struct Rendered<'a> {
    pub out: &'a PassOutput,
    pub pass: Pass<'a>,
    /// Its photometric loss, if it has one.
    pub loss: Option<&'a Tensor>,
    /// See [`RayPass::point_t`].
    pub point_t: Option<&'a Tensor>,
}

/// The terms in space with their weights.
pub(super) fn in_space(terms: &[WeightedTerm]) -> Vec<(&dyn SpaceTerm, f64)> {
    let in_space = terms.iter().filter_map(|WeightedTerm { term, weight, .. }| match term {
        LossTerm::InSpace(term) => Some((&**term, *weight)),
        LossTerm::OnRays(..) | LossTerm::OnTables(_) => None,
    });
    in_space.collect()
}

/// The groups of unseen rays that terms read, in a fixed order.
pub(super) fn unseen_groups(terms: &[WeightedTerm]) -> impl Iterator<Item = RayGroup> {
    let is_read = |group: &RayGroup| terms.iter().any(|term| term.term.source() == TermSource::UnseenRays(*group));
    [RayGroup::Point, RayGroup::One, RayGroup::Pair, RayGroup::Patch].into_iter().filter(is_read)
}

/// The values of a step's terms, in their order.
pub(super) struct TermValues<'a> {
    terms: &'a [WeightedTerm],
    values: Vec<f64>,
}

impl<'a> TermValues<'a> {
    pub(super) fn of(terms: &'a [WeightedTerm]) -> TermValues<'a> {
        TermValues { terms, values: vec![f64::NAN; terms.len()] }
    }

    /// Fills in the values of all terms of a source, in their order.
    pub(super) fn fill(&mut self, source: TermSource, found: &[f64]) {
        let of_source = self.terms.iter().zip(&mut self.values).filter(|(term, _)| term.term.source() == source);
        of_source.zip(found).for_each(|((_, value), found)| *value = *found);
    }

    /// Returns name, weight and value of each.
    pub(super) fn finish(&self) -> Vec<(&'a str, f64, f64)> {
        let named = self.terms.iter().zip(&self.values);
        named.map(|(WeightedTerm { term, weight, .. }, value)| (term.name(), *weight, *value)).collect()
    }
}

impl FieldLearner {
    /// What the step after `step` finished ones minimizes, with these terms.
    pub(super) fn step_loss<'a>(&self, terms: &'a [WeightedTerm], step: u64) -> StepLoss<'a> {
        let (clean, perturbed) = loss_weights(&self.config, step);
        StepLoss { clean, perturbed, terms, source: TermSource::TrainingRays, fields: self.config.regularizer.fields }
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
        let loss = photometric_loss(&out.composite.rgb, target)?;
        let counts = Counts { weight, share, is_evaluated };
        let rendered = Rendered { out: &out, pass, loss: Some(&loss), point_t: None };
        self.descend_terms(field, rendered, step_loss, counts, result)?;
        Ok(((loss.detach().to_dtype(DType::F64)? * share)?, PassLoss::of(out, target)?))
    }

    /// Adds the gradients of a pass's loss, if it has one, and of the terms on its rays, in one way back. The terms' means
    /// are added to the result's losses.
    pub(super) fn descend_terms(
        &self,
        field: &Field,
        Rendered { out, pass, loss, point_t }: Rendered,
        step_loss: StepLoss,
        Counts { weight, share, is_evaluated }: Counts,
        result: &mut ChunkResult,
    ) -> Result<()> {
        let reads_slopes = step_loss.terms_on(is_evaluated).any(|(term, _, counts)| counts && term.reads_slopes());
        let slopes = reads_slopes.then(|| SampleSlopes::of(field, pass)).transpose()?;
        let seen = RayPass {
            output: out,
            bounds: self.bounds,
            direction_norm: &pass.rays.direction_norm,
            directions: &pass.rays.directions,
            slopes: slopes.as_ref().map(|slopes| slopes.at_samples.as_tensor()),
            point_t,
        };
        let (mut total, values) = self.terms_of(&seen, step_loss, share, is_evaluated)?;
        if let Some(loss) = loss {
            total = ((loss * weight)? + total.to_dtype(loss.dtype())?)?;
        }
        let store = total.backward()?;
        result.gradients.add(&self.variables, &store)?;
        if let Some(slopes) = slopes {
            slopes.descend(field, &self.variables, &store, &mut result.gradients)?;
        }
        result.losses.on_rays = sum(result.losses.on_rays.take(), Some(values))?;
        Ok(())
    }

    /// Returns the weighted sum of the terms on a pass's rays, and the values of all of the source, unweighted and
    /// detached, `[terms]`. Both are multiplied by the share, and f64.
    fn terms_of(
        &self,
        seen: &RayPass,
        step_loss: StepLoss,
        share: f64,
        is_evaluated: bool,
    ) -> Result<(Tensor, Tensor)> {
        let mut total = Tensor::zeros((), DType::F64, &self.device)?;
        let mut values = Vec::new();
        for (term, weight, counts) in step_loss.terms_on(is_evaluated) {
            if !counts {
                values.push(Tensor::zeros((), DType::F64, &self.device)?);
                continue;
            }
            let mean = term.per_group(seen)?.mean_all()?.to_dtype(DType::F64)?;
            total = (total + (&mean * (weight * share))?)?;
            values.push((mean.detach() * share)?);
        }
        Ok((total, Tensor::stack(&values, 0)?))
    }
}

/// Density's gradient at the samples of a pass, whose derivatives go back to the field's weights.
struct SampleSlopes<'a> {
    spatial: Spatial<'a>,
    /// `[rays, samples, 3]`.
    at_samples: Var,
}

impl SampleSlopes<'_> {
    fn of<'a>(field: &'a Field, pass: Pass) -> Result<SampleSlopes<'a>> {
        let positions = positions_at(field, pass.rays, pass.t_vals)?;
        let spatial = field.spatial_up_to(Order::Gradient, &positions.flatten(0, 1)?)?;
        let at_samples = Var::from_tensor(&spatial.at.gradient.reshape(positions.shape())?)?;
        Ok(SampleSlopes { spatial, at_samples })
    }

    /// Adds the field's gradients that `store` asks for.
    fn descend(
        self,
        field: &Field,
        variables: &[(String, Var)],
        store: &GradStore,
        gradients: &mut Gradients,
    ) -> Result<()> {
        let Some(slope) = store.get(&self.at_samples) else { return Ok(()) };
        let slope = slope.detach().flatten(0, 1)?;
        let of_field =
            self.spatial.recording_gradients(&Cotangents { gradient: Some(slope), ..Cotangents::default() })?;
        let first = field.variables().first().expect("a field that trains has parameters");
        let start =
            variables.iter().position(|(_, var)| var.id() == first.1.id()).expect("the field is one of the model's");
        for (total, gradient) in gradients.0[start..].iter_mut().zip(of_field) {
            *total = sum(total.take(), gradient)?;
        }
        Ok(())
    }
}
