//! Entropy of rays (InfoNeRF: Kim, Seo and Han 2022).

use candle_core::{D, DType, Tensor};

use crate::base::Result;
use crate::render::volume::intervals;

use super::{RayPass, RayTerm};

/// How many places of a ray stop light, in bits:
///
/// ```text
///     -sum over samples of p_k log2(p_k),   p = alpha / sum of alpha,   alpha_k = 1 - exp(-density_k length_k)
/// ```
///
/// It is 0 if one sample is opaque, and log2 of the number of samples if all are alike, so that weights do not carry over
/// between numbers of samples. Rays that accumulate at most 0.1 count 0. The interval behind a last point has no
/// end: InfoNeRF takes it as opaque, and here it does not count.
///
/// InfoNeRF computes it on as many unseen rays: `regularizer.rays = "unseen"`.
pub struct Entropy;

/// Accumulation from which on a ray has an entropy.
const LEAST_ACC: f64 = 0.1;
/// Keeps quotients and logarithms finite.
pub(super) const TINY: f64 = 1e-10;

impl RayTerm for Entropy {
    fn name(&self) -> &str {
        "entropy"
    }

    fn is_of_evaluated_pass(&self) -> bool {
        true
    }

    fn per_group(&self, pass: &RayPass) -> Result<Tensor> {
        let p = stopping(pass)?;
        let bits = ((p.affine(1.0, TINY)?.log()? * &p)?.sum(D::Minus1)? * (-1.0 / 2f64.ln()))?;
        let acc = bounded(pass, &pass.output.composite.weights)?.sum(D::Minus1)?.detach();
        Ok((bits * acc.gt(LEAST_ACC)?.to_dtype(DType::F64)?)?)
    }
}

/// Returns each sample's share of its ray's opacities, p above, `[rays, samples]` in f64, without the sample of an
/// interval that has no end.
pub(super) fn stopping(pass: &RayPass) -> Result<Tensor> {
    let lengths = intervals(&pass.output.t_vals, pass.direction_norm, pass.samples()?)?;
    let optical = (bounded(pass, &pass.output.density)? * bounded(pass, &lengths)?)?;
    let alpha = optical.neg()?.exp()?.affine(-1.0, 1.0)?;
    Ok(alpha.broadcast_div(&alpha.sum_keepdim(D::Minus1)?.affine(1.0, TINY)?)?)
}

/// Returns the columns of samples whose intervals have ends, in f64.
fn bounded(pass: &RayPass, of_samples: &Tensor) -> Result<Tensor> {
    let samples = pass.samples()?;
    let count = if pass.output.t_vals.dim(1)? > samples { samples } else { samples - 1 };
    Ok(of_samples.narrow(1, 0, count)?.to_dtype(DType::F64)?)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{between_edges, rays};
    use super::*;

    #[test]
    fn closed_forms() {
        let of = |density: &[f64]| rays(density, 5.0).value(&Entropy);
        // The last density is that of an interval without an end.
        assert!((of(&[0.4, 0.4, 0.4, 0.4, 9.0]) - 2.0).abs() < 1e-8);
        assert!(of(&[0.0, 50.0, 0.0, 9.0]).abs() < 1e-8);
        let [a, b] = [0.2, 0.7].map(|density: f64| 1.0 - (-density * 5.0 / 3.0).exp());
        let expected: f64 = [a, b].map(|x| x / (a + b)).map(|p| -p * p.log2()).iter().sum();
        assert!((of(&[0.2, 0.7, 0.0]) - expected).abs() < 1e-8);
        // Between edges the last interval has an end, and counts.
        assert!((between_edges(&[0.4; 4], 4.0).value(&Entropy) - 2.0).abs() < 1e-8);
        // Too little in all: it does not count.
        assert_eq!(of(&[0.02, 0.02, 9.0]), 0.0);
    }
}
