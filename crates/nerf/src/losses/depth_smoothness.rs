//! Smooth depth of unseen patches (RegNeRF: Niemeyer and others 2022, equation 6).

use candle_core::{DType, Tensor};

use crate::base::Result;
use crate::data::{PATCH_SIDE, RayGroup};

use super::{RayPass, RayTerm};

/// The mean over a patch's pixels, without its last row and column, of
///
/// ```text
///     acc_ij ((d_ij - d_(i,j+1))^2 + (d_ij - d_(i+1,j))^2),   d = sum of weight_k t_k / acc, in near..far
/// ```
///
/// `acc` has no gradient as a factor: pixels that see nothing have no depth. In the released configurations for LLFF that
/// factor is 0, so that there the term is nothing; this is the paper's.
pub struct DepthSmoothness;

/// Keeps depths of rays that see nothing finite.
const LEAST_ACC: f64 = 1e-10;

impl RayTerm for DepthSmoothness {
    fn name(&self) -> &str {
        "depth-smoothness"
    }

    fn group(&self) -> RayGroup {
        RayGroup::Patch
    }

    fn is_of_evaluated_pass(&self) -> bool {
        true
    }

    fn per_group(&self, pass: &RayPass) -> Result<Tensor> {
        weighted(pass, &pass.output.composite.acc.detach())
    }
}

/// The term with this factor for each pixel, one number a ray.
fn weighted(pass: &RayPass, factor: &Tensor) -> Result<Tensor> {
    let (near, far) = pass.bounds;
    let by_patch = |rays: &Tensor| rays.to_dtype(DType::F64)?.reshape(((), PATCH_SIDE, PATCH_SIDE));
    let composite = &pass.output.composite;
    let depth = (by_patch(&composite.depth)? / by_patch(&composite.acc)?.maximum(LEAST_ACC)?)?.clamp(near, far)?;
    let part = |of: &Tensor, i: usize, j: usize| of.narrow(1, i, PATCH_SIDE - 1)?.narrow(2, j, PATCH_SIDE - 1);
    let here = part(&depth, 0, 0)?;
    let right = (&here - part(&depth, 0, 1)?)?.sqr()?;
    let below = (&here - part(&depth, 1, 0)?)?.sqr()?;
    let squares = ((right + below)? * part(&by_patch(factor)?, 0, 0)?)?;
    Ok(squares.flatten_from(1)?.mean(1)?)
}

#[cfg(test)]
mod tests {
    use super::super::tests::patch;
    use super::*;

    /// One opaque sample a ray, where a plane is.
    #[test]
    fn a_plane_has_the_square_of_its_slope() {
        let samples = 60;
        let plane = |a: usize, b: usize| {
            let of_ray = |i: usize| {
                let at = 2 + a * (i / PATCH_SIDE) + b * (i % PATCH_SIDE);
                (0..samples).map(move |k| if k == at { 1e6 } else { 0.0 })
            };
            let density: Vec<f64> = (0..PATCH_SIDE * PATCH_SIDE).flat_map(of_ray).collect();
            patch(&density, samples, 6.0).value(&DepthSmoothness)
        };
        let step = 6.0 / samples as f64;
        assert!(plane(0, 0).abs() < 1e-12);
        assert!((plane(3, 0) - (3.0 * step).powi(2)).abs() < 1e-9, "{}", plane(3, 0));
        assert!((plane(2, 5) - step.powi(2) * 29.0).abs() < 1e-9);
    }

    #[test]
    fn a_pixel_counts_as_far_as_it_is_opaque() {
        // Two intervals of length 1. The first pixel is half opaque in the first one, the others opaque in the second.
        let mut density = [0.0, 1e6].repeat(PATCH_SIDE * PATCH_SIDE);
        (density[0], density[1]) = (2f64.ln(), 0.0);
        let value = patch(&density, 2, 2.0).edged().value(&DepthSmoothness);
        assert!((value - 0.5 * (1.0 + 1.0) / 49.0).abs() < 1e-9, "{value}");
        assert!(patch(&[0.0; 2 * 64], 2, 2.0).value(&DepthSmoothness).abs() < 1e-12);
    }
}
