//! Depth at the points that a capture's program triangulated (DS-NeRF: Deng et al. 2022).

use candle_core::DType;
use candle_core::Tensor;

use crate::base::{Error, Result};
use crate::data::RayGroup;

use super::{RayPass, RayTerm};

/// The squared difference between a ray's depth and that of the point on it:
///
/// ```text
///     (sum over samples of w_k t_k - t of the point)^2
/// ```
///
/// It is in square units of t, which are those of depth along the camera's axis. DS-NeRF also weighs points by their
/// errors of reprojection; here they count alike.
pub struct SparseDepth;

impl RayTerm for SparseDepth {
    fn name(&self) -> &str {
        "sparse-depth"
    }

    fn is_of_evaluated_pass(&self) -> bool {
        true
    }

    fn group(&self) -> RayGroup {
        RayGroup::Point
    }

    fn per_group(&self, pass: &RayPass) -> Result<Tensor> {
        let known = pass.point_t.ok_or_else(|| Error::Config("the term 'sparse-depth' needs rays to points".into()))?;
        let depth = pass.output.composite.depth.to_dtype(DType::F64)?;
        Ok((depth.flatten_all()? - known.to_dtype(DType::F64)?)?.sqr()?)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::rays;
    use super::*;

    /// Of a ray that is stopped at t = 1 by its second sample, the square of the distance from there.
    #[test]
    fn closed_forms() {
        let of = |point: f64| rays(&[0.0, 1e9, 0.5, 2.0], 4.0).with_point(point).value(&SparseDepth);
        assert_eq!(of(1.0), 0.0);
        assert!((of(2.5) - 2.25).abs() < 1e-12);
        // A ray that nothing stops has depth 0.
        assert!((rays(&[0.0; 4], 4.0).with_point(3.0).value(&SparseDepth) - 9.0).abs() < 1e-12);
    }
}
