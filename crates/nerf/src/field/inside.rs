//! Raw density of points that may be outside a hash grid's box, as a differentiable operation.

use std::sync::Arc;

use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor, WithDType};

use crate::base::place::is_ours;

use super::contiguous;

/// Raw density of empty space, for which every activation gives 0.
pub(super) const NOTHING: f64 = -1e4;

/// Which of `n` points are where density can be.
#[derive(Clone)]
pub(super) struct Inside(Arc<[bool]>);

impl Inside {
    pub(super) fn new(inside: Vec<bool>) -> Inside {
        Inside(inside.into())
    }

    /// Returns 1 inside and 0 outside, `[n]`, in the type of `like`.
    pub(super) fn mask(&self, like: &Tensor) -> Result<Tensor> {
        let mask: Vec<u8> = self.0.iter().map(|inside| u8::from(*inside)).collect();
        Tensor::new(mask, like.device())?.to_dtype(like.dtype())
    }

    /// Returns raw density `[n]` with [`NOTHING`] at points outside, where it has no gradient. It also takes numbers
    /// that end with raw density, such as raw output `[4 n]`.
    pub(super) fn only(&self, raw: &Tensor) -> Result<Tensor> {
        if is_ours(raw) {
            return raw.contiguous()?.apply_op1(Replace { inside: self.clone(), by: NOTHING });
        }
        // 0 times NaN is NaN.
        let mask = self.mask(raw)?;
        let mask = match raw.elem_count() - self.0.len() {
            0 => mask,
            before => Tensor::cat(&[&Tensor::ones(before, raw.dtype(), raw.device())?, &mask], 0)?,
        };
        (raw * &mask)? + mask.affine(-NOTHING, NOTHING)?
    }
}

/// Replaces those of its argument's last `n` numbers whose points are outside.
struct Replace {
    inside: Inside,
    by: f64,
}

impl Replace {
    fn replaced<T: WithDType>(&self, values: &[T]) -> Result<Vec<T>> {
        let Inside(inside) = &self.inside;
        let Some(first) = values.len().checked_sub(inside.len()) else {
            candle_core::bail!("{} numbers do not end with those of {} points", values.len(), inside.len());
        };
        let by = T::from_f64(self.by);
        let mut values = values.to_vec();
        for (value, _) in values[first..].iter_mut().zip(&**inside).filter(|(_, inside)| !**inside) {
            // Adds 0, or NaN if the value was NaN.
            *value = *value * T::zero() + by;
        }
        Ok(values)
    }
}

impl CustomOp1 for Replace {
    fn name(&self) -> &'static str {
        "only-inside"
    }

    fn cpu_fwd(&self, values: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let replaced = match values {
            CpuStorage::F32(values) => CpuStorage::F32(self.replaced(contiguous(values, layout)?)?),
            CpuStorage::F64(values) => CpuStorage::F64(self.replaced(contiguous(values, layout)?)?),
            _ => candle_core::bail!("raw density is f32 or f64"),
        };
        Ok((replaced, layout.shape().clone()))
    }

    fn bwd(&self, _raw: &Tensor, _replaced: &Tensor, gradient: &Tensor) -> Result<Option<Tensor>> {
        let zeros = Replace { inside: self.inside.clone(), by: 0.0 };
        Ok(Some(gradient.contiguous()?.apply_op1_no_bwd(&zeros)?))
    }
}
