//! Checks whether a run is alive: scenes that stay empty, or of one colour.

use crate::base::{Error, Result};

use super::stats::StepStats;

/// Accumulation under which a ray counts as empty.
const EMPTY_ACC: f64 = 1e-3;

/// Colours of rays (0 to 1) that differ less count as one colour. A field that first learns a black background differs by
/// more; one whose colours ran off does not differ.
const ONE_COLOUR: f64 = 1e-5;

/// Photos whose colours (0 to 1) differ less may be of one colour.
const MANY_COLOURS: f64 = 0.02;

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
