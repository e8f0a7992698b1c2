//! Checks whether a run is alive: numbers that are not finite, and scenes that stay empty.

use candle_core::{DType, Tensor};

use crate::base::{Error, Result};
use crate::methods::Gradients;

use super::stats::StepStats;
use crate::optimizer::Adam;

/// Accumulation under which a ray counts as empty.
const EMPTY_ACC: f64 = 1e-3;

/// Returns an error if a loss or a gradient of a step is not finite.
pub(super) fn check_step(stats: &StepStats, gradients: &Gradients, adam: &Adam, learning_rate: f64) -> Result<()> {
    let loss = stats.terms.iter().find(|term| !term.value.is_finite());
    let broken = match loss {
        Some(term) => Some(term.described.clone()),
        None => find_non_finite(&gradients.0, adam)?.map(|name| format!("gradient of {name}")),
    };
    broken.map_or(Ok(()), |tensor| Err(non_finite(stats.step, &tensor, learning_rate)))
}

/// Returns an error if a parameter is not finite after an update.
pub(super) fn check_parameters(step: u64, adam: &Adam, learning_rate: f64) -> Result<()> {
    let parameters: Vec<Option<Tensor>> =
        adam.variables().iter().map(|(_, var)| Some(var.as_detached_tensor())).collect();
    let broken = find_non_finite(&parameters, adam)?;
    broken.map_or(Ok(()), |name| Err(non_finite(step, &format!("parameter {name}"), learning_rate)))
}

/// Returns the name of the first parameter whose tensor is not finite. `tensors` are in the order of the variables.
fn find_non_finite(tensors: &[Option<Tensor>], adam: &Adam) -> Result<Option<String>> {
    let named = adam.variables().iter().zip(tensors).filter_map(|((name, _), g)| g.as_ref().map(|g| (name, g)));
    let (names, sums): (Vec<&String>, Vec<_>) = named.map(|(name, g)| (name, g.sum_all())).unzip();
    let sums: Vec<Tensor> = sums.into_iter().collect::<candle_core::Result<_>>()?;
    let sums: Vec<f64> = Tensor::stack(&sums, 0)?.to_dtype(DType::F64)?.to_vec1()?;
    Ok(names.into_iter().zip(sums).find(|(_, sum)| !sum.is_finite()).map(|(name, _)| name.clone()))
}

fn non_finite(step: u64, tensor: &str, learning_rate: f64) -> Error {
    Error::Diverged(format!(
        "training diverged at step {step}: the {tensor} is not a number; lower train.learning_rate \
         ({learning_rate}), or step sizes and weights in sections perturb, regularizer, srn or nv, and start a new run"
    ))
}

/// Counts successive steps on which every ray was empty, this one included. Returns an error if they reach `limit` (0
/// = never).
pub(super) fn count_empty(before: u64, stats: &StepStats, limit: u64) -> Result<u64> {
    let empty = if stats.largest_acc < EMPTY_ACC { before.saturating_add(1) } else { 0 };
    if limit == 0 || empty < limit {
        return Ok(empty);
    }
    Err(Error::Diverged(format!(
        "training collapsed at step {}: acc (accumulated weight) was below {EMPTY_ACC} on every ray for {empty} steps; \
         try another seed, a lower train.learning_rate, or precropping (train.precrop_steps); \
         train.collapse_steps = 0 disables this check",
        stats.step
    )))
}
