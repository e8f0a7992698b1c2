//! Priors on what light meets: opacity in space, and the accumulation of rays.

use candle_core::{DType, Tensor};

use crate::base::Result;
use crate::field::{Cotangents, DensityAt, Order};

use super::{RayPass, RayTerm, SpaceTerm};

/// Opacity of a step of 1/20 of a scene unit (PlenOctrees: Yu et al. 2021): the mean over the box of 1 - exp(-density /
/// 20). Unlike `l1` it draws large densities hardly at all.
pub struct OpacitySparsity {
    /// The box's volume in cubic scene units, by which the integral is divided.
    pub volume: f64,
}

/// Inverse length of the step, in scene units.
const RATE: f64 = 0.05;

impl SpaceTerm for OpacitySparsity {
    fn name(&self) -> &str {
        "opacity-sparsity"
    }

    fn order(&self) -> Order {
        Order::Density
    }

    fn at_points(&self, at: &DensityAt) -> Result<Tensor> {
        Ok((at.density.affine(-RATE, 0.0)?.exp()?.affine(-1.0, 1.0)? / self.volume)?)
    }

    fn cotangents(&self, at: &DensityAt) -> Result<Cotangents> {
        let slope = (at.density.affine(-RATE, 0.0)?.exp()? * (RATE / self.volume))?;
        Ok(Cotangents { density: Some(slope), ..Cotangents::default() })
    }
}

/// Accumulations near 0 or 1 (Neural Volumes: Lombardi et al. 2019):
///
/// ```text
///     log(0.1 + acc) + log(1.1 - acc) - log(0.1) - log(1.1)
/// ```
///
/// It is 0 at 0 and 1, and largest between them, where it has no slope. Where every ray accumulates to 1 it does nothing, as on
/// networks in NDC, whose last interval has no end.
pub struct OpacityPrior;

impl RayTerm for OpacityPrior {
    fn name(&self) -> &str {
        "opacity-prior"
    }

    fn per_group(&self, pass: &RayPass) -> Result<Tensor> {
        let acc = pass.output.composite.acc.to_dtype(DType::F64)?;
        let sum = (acc.affine(1.0, 0.1)?.log()? + acc.affine(-1.0, 1.1)?.log()?)?;
        Ok((sum - (0.1f64.ln() + 1.1f64.ln()))?)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::rays;
    use super::*;
    use candle_core::Device;

    #[test]
    fn closed_forms_of_rays() {
        // One unit that stops half of the light, and nothing behind it.
        let half = rays(&[2f64.ln(), 0.0], 2.0).value(&OpacityPrior);
        assert!((half - 1.18562).abs() < 1e-5, "{half}");
        assert!((half - (2.0 * 0.6f64.ln() - 0.1f64.ln() - 1.1f64.ln())).abs() < 1e-9);
        assert!(rays(&[0.0, 0.0], 2.0).value(&OpacityPrior).abs() < 1e-12);
        assert!(rays(&[1e3, 0.0], 2.0).value(&OpacityPrior).abs() < 1e-9);
    }

    #[test]
    fn closed_forms_in_space() {
        let of = |density: f64| Tensor::new(&[density], &Device::Cpu).unwrap();
        let at = |density: f64| DensityAt { density: of(density), gradient: of(0.0), laplacian: of(0.0) };
        let term = OpacitySparsity { volume: 8.0 };
        let value = |density: f64| term.at_points(&at(density)).unwrap().to_vec1::<f64>().unwrap()[0];
        assert_eq!(value(0.0), 0.0);
        assert!((8.0 * value(2.0) - (1.0 - (-0.1f64).exp())).abs() < 1e-12);
        let slope = term.cotangents(&at(2.0)).unwrap().density.unwrap().to_vec1::<f64>().unwrap()[0];
        assert!((slope - (value(2.0 + 1e-5) - value(2.0 - 1e-5)) / 2e-5).abs() < 1e-9);
    }
}
