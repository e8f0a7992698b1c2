//! The loss that every method minimises.

use candle_core::Tensor;

use crate::base::Result;

/// Mean squared error over rays and channels between colours `[rays, 3]`.
pub fn photometric_loss(rgb: &Tensor, target: &Tensor) -> Result<Tensor> {
    Ok((rgb - target)?.sqr()?.mean_all()?)
}
