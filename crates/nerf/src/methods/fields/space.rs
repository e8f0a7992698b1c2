//! The terms in space and on tables of a step.

use candle_core::{DType, Tensor};

use crate::base::Result;
use crate::field::Field;
use crate::losses::{HashDecay, RegularizedFields, RegularizerConfig, SpaceTerm, regularize_unless};
use crate::methods::gradients::Gradients;
use crate::methods::learner::StopCheck;
use crate::space::Lattice;

use super::learner::FieldLearner;

/// Returns the sampling grid of a configuration.
pub(super) fn lattice(config: &RegularizerConfig) -> Lattice {
    Lattice { domain: config.domain, side: config.lattice }
}

/// Returns whether terms in space count for the field of this role, one of `roles`.
pub fn is_regularized(config: &RegularizerConfig, roles: &[&str], role: &str) -> bool {
    let evaluated = if roles.contains(&"fine") { "fine" } else { "coarse" };
    match config.fields {
        RegularizedFields::Both => role != "adversarial",
        RegularizedFields::Fine => role == evaluated,
    }
}

/// Returns the fields with their names, and whether terms count for each.
fn regularized<'a>(
    learner: &'a FieldLearner,
    config: &'a RegularizerConfig,
) -> impl Iterator<Item = (&'a Field, bool)> {
    let roles: Vec<&str> = learner.fields.by_role().map(|(role, _)| role).collect();
    learner.fields.by_role().map(move |(role, field)| (field, is_regularized(config, &roles, role)))
}

/// Returns unweighted values (f64 `[terms]`) and gradients of the weighted terms in space after `step` finished steps.
/// `None` if there are no such terms.
pub(super) fn space_terms(
    learner: &FieldLearner,
    terms: &[(&dyn SpaceTerm, f64)],
    config: &RegularizerConfig,
    step: u64,
    stop_check: &StopCheck,
) -> Result<Option<(Tensor, Gradients)>> {
    if terms.is_empty() {
        return Ok(None);
    }
    let points = config.quadrature(learner.config.seed, step);
    let mut values = Tensor::zeros(terms.len(), DType::F64, &learner.device)?;
    let mut gradients = Vec::new();
    for (field, counts) in regularized(learner, config) {
        if !counts {
            gradients.extend(vec![None; field.variables().len()]);
            continue;
        }
        let regularized = regularize_unless(field, &points, terms, stop_check)?;
        values = (values + regularized.values)?;
        gradients.extend(regularized.gradients);
    }
    Ok(Some((values, Gradients(gradients))))
}

/// Returns the value of the tables' decay, and the gradients of `weight` times it in the entries that `reached`,
/// gradients of the step, are not 0 at.
pub(super) fn table_terms(
    learner: &FieldLearner,
    decay: HashDecay,
    weight: f64,
    config: &RegularizerConfig,
    reached: &Gradients,
) -> Result<(f64, Gradients)> {
    let (mut value, mut gradients) = (0.0, Vec::new());
    let mut rest = &reached.0[..];
    for (field, counts) in regularized(learner, config) {
        let variables = field.variables();
        let (own, others) = rest.split_at(variables.len());
        rest = others;
        let mut of_field = vec![None; variables.len()];
        if let (Some(grid), Some(reached), true) = (field.hash_grid(), &own[0], counts) {
            let (of_table, gradient) = decay.value_and_gradient(grid, &variables[0].1.as_detached_tensor(), reached)?;
            value += of_table;
            of_field[0] = Some((gradient * weight)?);
        }
        gradients.extend(of_field);
    }
    Ok((value, Gradients(gradients)))
}
