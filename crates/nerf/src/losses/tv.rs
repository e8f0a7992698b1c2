//! Total variation of density.

use candle_core::Tensor;

use crate::base::Result;
use crate::field::{Cotangents, DensityAt, Order};

use super::SpaceTerm;

/// Euclidean length of density's gradient.
pub struct Tv;

impl SpaceTerm for Tv {
    fn name(&self) -> &str {
        "tv"
    }

    fn order(&self) -> Order {
        Order::Gradient
    }

    fn at_points(&self, at: &DensityAt) -> Result<Tensor> {
        Ok(at.gradient.sqr()?.sum(1)?.sqrt()?)
    }

    /// The gradient over its length. Where that is 0, the subgradient of least length, 0.
    fn cotangents(&self, at: &DensityAt) -> Result<Cotangents> {
        let length = at.gradient.sqr()?.sum_keepdim(1)?.sqrt()?;
        let divisor = (&length + length.eq(0f64)?.to_dtype(length.dtype())?)?;
        Ok(Cotangents { gradient: Some(at.gradient.broadcast_div(&divisor)?), ..Cotangents::default() })
    }
}
