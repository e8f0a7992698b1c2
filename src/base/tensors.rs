//! Sums of tensors that may be missing, and a look at their values.

use candle_core::{CpuStorage, Storage, Tensor};

use super::Result;

/// `a + b`; the one that is there where the other is missing.
pub fn sum(a: Option<Tensor>, b: Option<Tensor>) -> Result<Option<Tensor>> {
    Ok(match (a, b) {
        (Some(a), Some(b)) => Some((a + b)?),
        (a, b) => a.or(b),
    })
}

/// Lets `read` see the values of a contiguous f32 tensor on a processor; none of another.
pub fn with_values<R>(tensor: &Tensor, read: impl FnOnce(&[f32]) -> R) -> Option<R> {
    let (storage, layout) = tensor.storage_and_layout();
    match (&*storage, layout.contiguous_offsets()) {
        (Storage::Cpu(CpuStorage::F32(values)), Some((start, end))) => Some(read(&values[start..end])),
        _ => None,
    }
}
