//! Raw density of points that may be outside a hash grid's box.

use std::sync::Arc;

use candle_core::{Result, Tensor};

/// Raw density of empty space, for which every activation gives 0.
pub(super) const NOTHING: f32 = -1e4;

/// Which of `n` points are where density can be.
#[derive(Clone)]
pub(super) struct Inside(pub(super) Arc<[bool]>);

impl Inside {
    pub(super) fn new(inside: Vec<bool>) -> Inside {
        Inside(inside.into())
    }

    /// Returns 1 inside and 0 outside, `[n]`, in the type of `like`.
    pub(super) fn mask(&self, like: &Tensor) -> Result<Tensor> {
        let mask: Vec<u8> = self.0.iter().map(|inside| u8::from(*inside)).collect();
        Tensor::new(mask, like.device())?.to_dtype(like.dtype())
    }

    /// Returns raw density `[n]` with [`NOTHING`] at points outside, where it has no gradient. NaN stays NaN.
    pub(super) fn only(&self, raw: &Tensor) -> Result<Tensor> {
        let mask = self.mask(raw)?;
        (raw * &mask)? + mask.affine(f64::from(-NOTHING), f64::from(NOTHING))?
    }
}
