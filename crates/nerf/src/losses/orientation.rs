//! Density that falls along a ray (Ref-NeRF: Verbin et al. 2022, equation 11).

use candle_core::{D, DType, Tensor};

use crate::base::{Error, Result};

use super::{RayPass, RayTerm};

/// Weights on the far side of surfaces, which a camera cannot see:
///
/// ```text
///     sum over samples of w_k max(0, n_k . d)^2
/// ```
///
/// d is the ray's unit direction, and n the unit normal -grad density / |grad density|. Where density has no gradient, the
/// sample counts 0. Both the weights and the normals have gradients. In NDC both are directions of NDC.
pub struct Orientation;

impl RayTerm for Orientation {
    fn name(&self) -> &str {
        "orientation"
    }

    fn is_of_evaluated_pass(&self) -> bool {
        true
    }

    fn reads_slopes(&self) -> bool {
        true
    }

    fn per_group(&self, pass: &RayPass) -> Result<Tensor> {
        let slopes =
            pass.slopes.ok_or_else(|| Error::Config("the term 'orientation' needs density's gradient".into()))?;
        let slopes = slopes.to_dtype(DType::F64)?;
        let directions = pass.directions.to_dtype(DType::F64)?;
        let squared = slopes.sqr()?.sum(D::Minus1)?; // [rays, samples]
        let squared = (&squared + squared.eq(0f64)?.to_dtype(DType::F64)?)?;
        let falls = slopes.broadcast_mul(&directions.unsqueeze(1)?)?.sum(D::Minus1)?.neg()?.relu()?.sqr()?;
        let cosines = (falls / squared)?.broadcast_div(&directions.sqr()?.sum_keepdim(1)?)?;
        Ok((cosines * pass.output.composite.weights.to_dtype(DType::F64)?)?.sum(1)?)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::rays;
    use super::*;

    const FAR: f64 = 4.0;

    /// Returns the weights of a ray's samples, the last of which has an interval without an end.
    fn weights(density: &[f64]) -> Vec<f64> {
        let last = density.len() - 1;
        let mut passes = 1.0;
        let weight = |(k, density): (usize, &f64)| {
            let alpha = if k == last { f64::from(*density > 0.0) } else { 1.0 - (-density).exp() };
            let weight = passes * alpha;
            passes *= 1.0 - alpha;
            weight
        };
        density.iter().enumerate().map(weight).collect()
    }

    /// Where density grows along the ray, 0. Where it falls, the weights. Aslant, times the square of the cosine.
    #[test]
    fn closed_forms() {
        let density = [0.3, 0.6, 0.2, 0.5];
        let of = |slope: [f64; 3]| rays(&density, FAR).sloped([slope; 4].concat()).value(&Orientation);
        let all: f64 = weights(&density).iter().sum();
        assert!((of([0.0, 0.0, -2.0]) - all).abs() < 1e-12);
        assert_eq!(of([0.0, 0.0, 5.0]), 0.0);
        assert_eq!(of([3.0, 0.0, 0.0]), 0.0);
        assert_eq!(of([0.0, 0.0, 0.0]), 0.0);
        assert!((of([3.0, 0.0, -4.0]) - 0.64 * all).abs() < 1e-12);
        // Of one sample that faces away, its weight.
        let one = rays(&density, FAR).sloped([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0; 3], [0.0; 3]].concat());
        assert!((one.value(&Orientation) - weights(&density)[1]).abs() < 1e-12);
    }
}
