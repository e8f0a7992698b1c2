//! Divergence of a ray and its twin (InfoNeRF: Kim, Seo and Han 2022, equation 9).

use candle_core::{D, DType, Tensor};

use crate::base::Result;
use crate::data::RayGroup;

use super::entropy::{TINY, stopping};
use super::{RayPass, RayTerm};

/// How differently a ray and its twin from nearby are stopped, in natural units:
///
/// ```text
///     sum over samples of q_k log(q_k / p_k)
/// ```
///
/// p and q are the shares of opacity of [`Entropy`](super::Entropy), of the ray and of its twin. Both have gradients.
pub struct InformationGain;

impl RayTerm for InformationGain {
    fn name(&self) -> &str {
        "information-gain"
    }

    fn group(&self) -> RayGroup {
        RayGroup::Pair
    }

    fn is_of_evaluated_pass(&self) -> bool {
        true
    }

    fn per_group(&self, pass: &RayPass) -> Result<Tensor> {
        let shares = stopping(pass)?.to_dtype(DType::F64)?;
        let pairs = shares.reshape(((), 2, shares.dim(1)?))?;
        let of = |which: usize| pairs.narrow(1, which, 1)?.squeeze(1)?.affine(1.0, TINY);
        let (p, q) = (of(0)?, of(1)?);
        Ok((&q * (q.log()? - p.log()?)?)?.sum(D::Minus1)?)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::pair;
    use super::*;

    /// The density of an opacity, where intervals are 1 long.
    fn of_opacity(alpha: f64) -> f64 {
        -(1.0 - alpha).ln()
    }

    #[test]
    fn closed_forms() {
        let [half, quarter] = [0.5, 0.25].map(of_opacity);
        // The last density is that of an interval without an end, which does not count.
        let of = |a: [f64; 3], b: [f64; 3]| {
            let density: Vec<f64> = a.iter().chain(&[9.0]).chain(&b).chain(&[9.0]).copied().collect();
            pair(&density, 4.0).value(&InformationGain)
        };
        let (a, b) = ([half, quarter, quarter], [quarter, half, quarter]);
        assert!((of(a, b) - 0.25 * 2f64.ln()).abs() < 1e-8, "{}", of(a, b));
        assert!(of(a, a).abs() < 1e-8);
        // The twin's shares weigh: 1/3 (ln 2/3 + 2 ln 4/3). The other way round it would be 1/2 ln 9/8.
        let even = [quarter; 3];
        assert!((of(a, even) - (32f64 / 27.0).ln() / 3.0).abs() < 1e-8, "{}", of(a, even));
        // Shares, not opacities: half as opaque everywhere is the same.
        let faint = [0.25, 0.125, 0.125].map(of_opacity);
        assert!(of(a, faint).abs() < 1e-8);
        assert!(of(a, [half, 0.0, half]) > 0.0);
    }
}
