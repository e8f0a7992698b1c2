//! The values of tensors on the CPU, for custom operations.

use candle_core::WithDType;
use rayon::prelude::*;

pub(super) use crate::base::tensors::{Values, slice};

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
