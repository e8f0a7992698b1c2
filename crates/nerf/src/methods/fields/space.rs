//! The terms in space and on tables of a step, and how long those in space take.

use candle_core::{DType, Tensor};

use crate::base::{Error, Result};
use crate::field::Field;
use crate::losses::{HashDecay, SpaceTerm, WeightedTerm, estimate_seconds, regularize_unless};
use crate::losses::{LatticePoints, RegularizedFields, RegularizerConfig};
use crate::methods::gradients::Gradients;
use crate::methods::learner::StopCheck;
use crate::space::Lattice;

use super::learner::FieldLearner;
use super::terms::in_space;

/// Longest time of regularizers in days. A run with more is rejected.
const MOST_DAYS: f64 = 30.0;
/// Longest time of a single step in minutes. There is no checkpoint within a step.
const MOST_MINUTES_A_STEP: f64 = 10.0;
const SECONDS_PER_MINUTE: f64 = 60.0;
const SECONDS_PER_DAY: f64 = 86_400.0;
/// With this few points per step no estimate is needed.
const SURELY_FINISHED: usize = 1 << 16;

/// Returns the sampling grid of a configuration.
pub(super) fn lattice(config: &RegularizerConfig) -> Lattice {
    Lattice { domain: config.domain, side: config.lattice }
}

/// Returns whether a check of a run measures how long its terms in space take.
pub fn is_timed(config: &RegularizerConfig) -> bool {
    config.has_space_terms() && points_per_step(config) > SURELY_FINISHED
}

/// Returns the points of a step's terms in space.
fn points_per_step(config: &RegularizerConfig) -> usize {
    match config.points {
        LatticePoints::Sampled => config.points_per_step,
        LatticePoints::Full => lattice(config).cells(),
    }
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

impl FieldLearner {
    /// Returns an error for terms in space whose points would take this machine too long in `steps` steps.
    ///
    /// # Errors
    /// They take more than 10 minutes a step, or 30 days.
    pub fn check_duration(&self, terms: &[WeightedTerm], config: &RegularizerConfig, steps: u64) -> Result<()> {
        let terms = in_space(terms);
        let (lattice, points) = (lattice(config), points_per_step(config));
        if points <= SURELY_FINISHED || terms.is_empty() {
            return Ok(());
        }
        let fields: Vec<&Field> =
            regularized(self, config).filter(|(_, counts)| *counts).map(|(field, _)| field).collect();
        let step = estimate_seconds(fields[0], &lattice, points, &terms)? * fields.len() as f64;
        let days = step * steps as f64 / SECONDS_PER_DAY;
        if days <= MOST_DAYS && step <= MOST_MINUTES_A_STEP * SECONDS_PER_MINUTE {
            return Ok(());
        }
        Err(Error::Config(format!(
            "regularizer.lattice = {}, points = \"{}\" queries {} points per step: about {step:.0} s per step here, \
             {days:.0} days for {steps} steps (at most {MOST_MINUTES_A_STEP} minutes and {MOST_DAYS} days are allowed); set \
             regularizer.points = \"sampled\" with \
             fewer points_per_step, or a smaller lattice",
            lattice.side,
            if config.points == LatticePoints::Full { "full" } else { "sampled" },
            points * fields.len()
        )))
    }
}
