//! Which entries of hash grids a step's two passes change.

use candle_core::{DType, Tensor};

use crate::base::Result;
use crate::base::place::is_host;
use crate::field::TableRecord;
use crate::field::settings::{Core, Encoding};
use crate::methods::gradients::Gradients;
use crate::perturb::settings::{ChangedEntries, PerturbField};

use super::learner::FieldLearner;

/// Of the hash grid's entries that a step changes, the fraction that only its second pass changes.
pub(super) const ONLY_SECOND: &str = "only_second.entries";

/// Returns whether the gradients of a hash grid's two passes are known apart.
pub(super) fn are_separate(learner: &FieldLearner) -> bool {
    let FieldLearner { config, device, dtype, .. } = learner;
    let on_grid = config.field.encoding == Encoding::Hash && config.field.core == Core::Fused;
    on_grid && is_host(device) && *dtype == DType::F32 && config.perturb.field == PerturbField::Shared
}

/// Returns the gradients of hash grids from a step's records. With `log`, if there are two passes, it also returns
/// what fraction only the second one changes of the entries that either changes.
pub(super) fn table_gradients(
    learner: &FieldLearner,
    tables: &[Vec<TableRecord>],
    log: bool,
) -> Result<(Gradients, Option<f64>)> {
    let masks = learner.config.perturb.entries == ChangedEntries::Clean;
    let gradients_of = |counts: &dyn Fn(&TableRecord) -> bool| learner.fields.table_gradients(tables, counts);
    let is_of_second = |record: &TableRecord| record.is_of_second_pass;
    let has_second = tables.iter().flatten().any(is_of_second);
    if !has_second || !(masks || log) {
        return Ok((Gradients(gradients_of(&|_| true)?), None));
    }
    let clean = gradients_of(&|record| !is_of_second(record))?;
    let second = gradients_of(&is_of_second)?;
    let (mut changed, mut only_second) = (0.0, 0.0);
    let mut masked = Vec::new();
    for (clean, second) in clean.iter().zip(&second) {
        let (Some(clean), Some(second)) = (clean, second) else {
            masked.push(None);
            continue;
        };
        let [by_clean, by_second] = [is_changed(clean)?, is_changed(second)?];
        changed += count(&by_clean.maximum(&by_second)?)?;
        only_second += count(&(&by_second * (1.0 - &by_clean)?)?)?;
        masked.push(Some(second.broadcast_mul(&by_clean)?));
    }
    let fraction = (log && changed > 0.0).then(|| only_second / changed);
    if !masks {
        // All at once, whose rounding is that of other steps.
        return Ok((Gradients(gradients_of(&|_| true)?), fraction));
    }
    let mut gradients = Gradients(clean);
    gradients.merge(Gradients(masked))?;
    Ok((gradients, fraction))
}

/// Returns 1 for entries, `[entries, 1]`, with a gradient, and 0 for others.
fn is_changed(gradient: &Tensor) -> Result<Tensor> {
    Ok(gradient.abs()?.max_keepdim(1)?.gt(0.0)?.to_dtype(gradient.dtype())?)
}

fn count(ones: &Tensor) -> Result<f64> {
    Ok(ones.to_dtype(DType::F64)?.sum_all()?.to_scalar()?)
}
