//! Curvature of density.

use candle_core::Tensor;

use crate::base::Result;
use crate::field::{Cotangents, DensityAt};

use super::SpaceTerm;

/// abs(Laplacian of density).
pub struct Laplacian;

impl SpaceTerm for Laplacian {
    fn name(&self) -> &str {
        "laplacian"
    }

    fn at_points(&self, at: &DensityAt) -> Result<Tensor> {
        Ok(at.laplacian.abs()?)
    }

    /// The Laplacian's sign, 0 where it is 0.
    fn cotangents(&self, at: &DensityAt) -> Result<Cotangents> {
        Ok(Cotangents { laplacian: Some(at.laplacian.sign()?), ..Cotangents::default() })
    }
}
