//! Sparsity of density at samples (SNeRG: Hedman et al. 2021).

use candle_core::{D, DType, Tensor};

use crate::base::Result;

use super::{RayPass, RayTerm};

/// The mean over a ray's samples of log(1 + 2 density^2), the logarithm of a Cauchy distribution's density. Small densities
/// are drawn to 0, and large ones hardly at all: the slope is 4 density / (1 + 2 density^2).
pub struct Cauchy;

impl RayTerm for Cauchy {
    fn name(&self) -> &str {
        "cauchy"
    }

    fn per_group(&self, pass: &RayPass) -> Result<Tensor> {
        let density = pass.output.density.to_dtype(DType::F64)?;
        Ok((density.sqr()?.affine(2.0, 1.0)?).log()?.mean(D::Minus1)?)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::rays;
    use super::*;

    #[test]
    fn closed_forms() {
        let of = |density: &[f64]| rays(density, 4.0).value(&Cauchy);
        assert_eq!(of(&[0.0, 0.0]), 0.0);
        assert!((of(&[1.0, 1.0, 1.0]) - 3f64.ln()).abs() < 1e-12);
        assert!((of(&[1.0, 0.0]) - 3f64.ln() / 2.0).abs() < 1e-12);
    }
}
