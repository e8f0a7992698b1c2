//! Sparsity of density.

use candle_core::Tensor;

use crate::base::Result;
use crate::field::{Cotangents, DensityAt, Order};

use super::SpaceTerm;

/// abs(density).
pub struct L1;

impl SpaceTerm for L1 {
    fn name(&self) -> &str {
        "l1"
    }

    fn order(&self) -> Order {
        Order::Density
    }

    fn at_points(&self, at: &DensityAt) -> Result<Tensor> {
        Ok(at.density.abs()?)
    }

    /// 1 where density is positive, 0 where it is 0.
    fn cotangents(&self, at: &DensityAt) -> Result<Cotangents> {
        Ok(Cotangents { density: Some(at.density.sign()?), ..Cotangents::default() })
    }
}
