//! Checks whether a run is alive: numbers that are not finite, and scenes that stay empty.

use candle_core::{DType, Tensor};

use crate::base::{Error, Result};
use crate::methods::Gradients;

use super::stats::StepStats;
use crate::optimizer::Adam;

/// Accumulation under which a ray counts as empty.
const EMPTY_ACC: f64 = 1e-3;

/// Colours of rays (0 to 1) that differ less count as one colour. A field that first learns a black background differs by
/// more; one whose colours ran off does not differ.
const ONE_COLOUR: f64 = 1e-5;

/// Photos whose colours (0 to 1) differ less may be of one colour.
const MANY_COLOURS: f64 = 0.02;

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

/// Counts successive steps on which every ray was empty, or all rays had one colour and their photos had not, this one
/// included. Returns an error if they reach `limit` (0 = never).
pub(super) fn count_dead(before: u64, stats: &StepStats, limit: u64) -> Result<u64> {
    let extremes = &stats.extremes;
    let is_empty = extremes.largest_acc < EMPTY_ACC;
    let is_one_colour = extremes.rendered_spread() < ONE_COLOUR && extremes.target_spread() > MANY_COLOURS;
    let dead = if is_empty || is_one_colour { before.saturating_add(1) } else { 0 };
    if limit == 0 || dead < limit {
        return Ok(dead);
    }
    let sign = match is_empty {
        true => format!("acc (accumulated weight) was below {EMPTY_ACC} on every ray"),
        false => "all rays had one colour, and the photos had not,".into(),
    };
    Err(Error::Diverged(format!(
        "training collapsed at step {}: {sign} for {dead} steps; try another seed, a lower train.learning_rate, {} \
         (train.precrop_steps); train.collapse_steps = 0 disables this check",
        stats.step,
        if is_empty { "or precropping" } else { "field.rgb_limit = 8, or precropping" }
    )))
}
