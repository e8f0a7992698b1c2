//! The terms of a step's loss next to the photometric ones: those in space, and those on the rays of a clean pass.

use candle_core::backprop::GradStore;
use candle_core::{DType, Tensor, Var};

use crate::base::Result;
use crate::base::tensors::sum;
use crate::field::{Cotangents, Field, Order, Spatial};
use crate::losses::{LossTerm, RayPass, RayTerm, SpaceTerm, TermSource, WeightedTerm};
use crate::methods::gradients::Gradients;
use crate::render::{Pass, PassOutput, positions_at};

use super::learner::FieldLearner;
use super::plan::PassPlan;
use super::rays::StepRays;
use super::sums::Sums;

/// The terms in space with their weights.
pub(super) fn in_space(terms: &[WeightedTerm]) -> Vec<(&dyn SpaceTerm, f64)> {
    let in_space = terms.iter().filter_map(|WeightedTerm { term, weight, .. }| match term {
        LossTerm::InSpace(term) => Some((&**term, *weight)),
        LossTerm::OnRays(..) | LossTerm::OnTables(_) => None,
    });
    in_space.collect()
}

/// The terms on the rays of a pass with their weights, and whether each counts in it.
pub(super) struct RayTerms<'a>(Vec<(&'a dyn RayTerm, f64, bool)>);

impl<'a> RayTerms<'a> {
    /// Returns those of a source.
    pub(super) fn of(terms: &'a [WeightedTerm], source: TermSource, plan: &PassPlan) -> RayTerms<'a> {
        let of_source = terms.iter().filter(|weighted| weighted.term.source() == source);
        let on_rays = of_source.filter_map(|weighted| match &weighted.term {
            LossTerm::OnRays(term, _) => Some((&**term, weighted.weight, plan.counts(term.is_of_evaluated_pass()))),
            LossTerm::InSpace(_) | LossTerm::OnTables(_) => None,
        });
        RayTerms(on_rays.collect())
    }

    /// Returns whether any of them counts.
    pub(super) fn any_counts(&self) -> bool {
        self.0.iter().any(|(.., counts)| *counts)
    }

    /// Adds the gradients of a pass's weighted loss, if it has one, and of its terms, in one way back. The terms' means are
    /// added to the sums, unweighted.
    pub(super) fn descend(
        &self,
        learner: &FieldLearner,
        (field, pass): (&Field, Pass),
        out: &PassOutput,
        loss: Option<&Tensor>,
        chunk: &StepRays,
        sums: &mut Sums,
    ) -> Result<()> {
        let reads_slopes = self.0.iter().any(|(term, _, counts)| *counts && term.reads_slopes());
        let slopes = reads_slopes.then(|| SampleSlopes::of(field, pass)).transpose()?;
        let seen = RayPass {
            output: out,
            bounds: learner.geometry.bounds,
            direction_norm: &pass.rays.direction_norm,
            directions: &pass.rays.directions,
            slopes: slopes.as_ref().map(|slopes| slopes.at_samples.as_tensor()),
            point_t: chunk.point_t.as_ref(),
        };
        let (mut total, mut values) = (Tensor::zeros((), DType::F64, &learner.device)?, Vec::new());
        for (term, weight, counts) in &self.0 {
            if !counts {
                values.push(0.0);
                continue;
            }
            let mean = term.per_group(&seen)?.mean_all()?.to_dtype(DType::F64)?;
            total = (total + (&mean * (weight * chunk.fraction))?)?;
            values.push(mean.to_scalar::<f64>()? * chunk.fraction);
        }
        if let Some(loss) = loss {
            total = (loss + total.to_dtype(loss.dtype())?)?;
        }
        let store = total.backward()?;
        sums.gradients.add(&learner.variables, &store)?;
        if let Some(slopes) = slopes {
            slopes.descend(field, &learner.variables, &store, &mut sums.gradients)?;
        }
        sums.add_on_rays(&values);
        Ok(())
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
        let positions = positions_at(field, pass.rays, &pass.samples.t_vals)?;
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
        let cotangents = Cotangents { gradient: Some(slope), ..Cotangents::default() };
        let (of_field, record) = self.spatial.weight_gradients(&cotangents)?;
        field.add_table_record(record);
        let first = field.variables().first().expect("a field that trains has parameters");
        let start =
            variables.iter().position(|(_, var)| var.id() == first.1.id()).expect("the field is one of the model's");
        for (total, gradient) in gradients.0[start..].iter_mut().zip(of_field) {
            *total = sum(total.take(), gradient)?;
        }
        Ok(())
    }
}
