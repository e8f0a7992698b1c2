//! Raw density of points that may be outside a hash grid's box, as a differentiable operation.

use std::sync::Arc;

use augnerf_fast::inside::replaced_outside;
use candle_core::{Result, Tensor};

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
        if let Some(replaced) = replaced_outside(raw, &self.0, NOTHING)? {
            return Ok(replaced);
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
