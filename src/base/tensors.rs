//! Sums of tensors that may be missing.

use candle_core::Tensor;

use super::Result;

/// `a + b`; the one that is there where the other is missing.
pub fn sum(a: Option<Tensor>, b: Option<Tensor>) -> Result<Option<Tensor>> {
    Ok(match (a, b) {
        (Some(a), Some(b)) => Some((a + b)?),
        (a, b) => a.or(b),
    })
}
