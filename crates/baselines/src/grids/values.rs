//! The values of tensors on the CPU, for custom operations.

use std::ops::Deref;

use candle_core::{CpuStorage, Layout, Result, Storage, Tensor, WithDType};
use rayon::prelude::*;

/// A tensor's values, readable while this lives.
pub(super) struct Values<'a> {
    storage: Box<dyn Deref<Target = Storage> + 'a>,
    layout: &'a Layout,
}

impl<'a> Values<'a> {
    pub(super) fn of(tensor: &'a Tensor) -> Values<'a> {
        let (storage, layout) = tensor.storage_and_layout();
        Values { storage: Box::new(storage), layout }
    }

    /// Returns the values row by row.
    pub(super) fn slice<T: WithDType>(&self) -> Result<&[T]> {
        match &**self.storage {
            Storage::Cpu(storage) => slice(storage, self.layout),
            _ => candle_core::bail!("this operation needs tensors on the CPU"),
        }
    }
}

/// Returns the values of a contiguous argument.
pub(super) fn slice<'a, T: WithDType>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [T]> {
    match layout.contiguous_offsets() {
        Some((start, end)) => Ok(&T::cpu_storage_as_slice(storage)?[start..end]),
        None => candle_core::bail!("this operation needs contiguous arguments, got {layout:?}"),
    }
}

/// Runs a block with `T` as the number type, f32 or f64.
macro_rules! each_kind {
    ($dtype:expr, $kind:ident => $work:block) => {
        match $dtype {
            candle_core::DType::F32 => {
                type $kind = f32;
                $work
            }
            candle_core::DType::F64 => {
                type $kind = f64;
                $work
            }
            other => candle_core::bail!("this operation is of f32 and f64, not {other:?}"),
        }
    };
}

pub(super) use each_kind;

/// Sums parts of `count` numbers each, in order.
pub(super) fn summed<T: WithDType>(parts: Vec<Vec<T>>, count: usize) -> Vec<T> {
    const BLOCK: usize = 1 << 14;
    let mut parts = parts.into_iter();
    let mut total = parts.next().unwrap_or_else(|| vec![T::zero(); count]);
    let rest: Vec<Vec<T>> = parts.collect();
    total.par_chunks_mut(BLOCK).enumerate().for_each(|(block, total)| {
        for part in &rest {
            total.iter_mut().zip(&part[block * BLOCK..]).for_each(|(total, value)| *total += *value);
        }
    });
    total
}
