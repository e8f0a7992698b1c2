//! The search for the worst case: projected gradient descent, PGD (paper, equation "PGD"; Madry et al. 2017).

use candle_core::{Tensor, Var};

use crate::base::Result;
use crate::perturb::sets::{Deltas, Sets, SiteSet};

/// Ascends `loss` from `start` and returns the last deltas, without a final evaluation:
///
/// delta <- project(delta + step size * direction(d loss / d delta))
///
/// All sites move together. A site stops after its own number of steps. `loss(deltas, samples_stay)` is called with deltas of
/// which the moving ones are tracked. `samples_stay`: no site moves samples in this step or a later one. It returns the loss,
/// and the deltas as they were really used: the output level is projected again onto what the forward pass allows. PGD
/// continues from there. Weights must be frozen in `loss`.
///
/// # Errors
/// Those of `loss` and of candle.
pub fn worst_case(
    sets: &Sets,
    start: Deltas,
    mut loss: impl FnMut(&Deltas, bool) -> Result<(Tensor, Deltas)>,
) -> Result<Deltas> {
    let mut deltas = start;
    let most_steps = sets.iter().map(|entry| entry.site.pgd().steps).max().unwrap_or(0);
    for step in 0..most_steps {
        let moving: Vec<&SiteSet> = sets.iter().filter(|entry| step < entry.site.pgd().steps).collect();
        let samples_stay = !moving.iter().any(|entry| entry.site.at().spec().moves_samples);
        let mut tracked = deltas.clone();
        for SiteSet { site, .. } in &moving {
            let delta = deltas.get(site.name()).expect("is on").detach();
            tracked.insert(site.name(), Var::from_tensor(&delta)?.into_inner());
        }
        let (value, used) = loss(&tracked, samples_stay)?;
        let gradients = value.backward()?;
        for SiteSet { site, set } in &moving {
            // Without a gradient the loss does not depend on this delta (sign(0) = 0).
            let Some(gradient) = gradients.get(tracked.get(site.name()).expect("is on")) else { continue };
            let delta = used.get(site.name()).expect("is on").detach();
            deltas.insert(site.name(), set.ascend(&delta, &gradient.detach(), site.pgd())?);
        }
    }
    Ok(deltas)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::perturb::geometry::{AttackGeometry, PassGeometry};
    use crate::perturb::set::{DeltaSet, Norm};
    use crate::perturb::{PaperSite, Pgd, PixelScale, Site, StepUnit};
    use candle_core::{DType, Device};

    /// A site with one vector as its delta.
    struct Vector {
        at: PaperSite,
        steps: usize,
        norm: Norm,
        radius: f64,
    }

    impl Site for Vector {
        fn at(&self) -> PaperSite {
            self.at
        }

        fn pgd(&self) -> Pgd {
            Pgd { steps: self.steps, step_size: 0.1, unit: StepUnit::Absolute }
        }

        fn set(&self, _: &PassGeometry) -> Result<DeltaSet> {
            Ok(DeltaSet::new(self.norm, Tensor::new(&[[[self.radius]]], &Device::Cpu)?, &[1, 1, 3]))
        }
    }

    /// Searches from zeros.
    fn search(
        sites: impl IntoIterator<Item = Vector>,
        loss: impl FnMut(&Deltas, bool) -> Result<(Tensor, Deltas)>,
    ) -> Deltas {
        let one = Tensor::ones((1, 1), DType::F64, &Device::Cpu).unwrap();
        let pixel = PixelScale { width: 1.0, height: 1.0, focal: 1.0, ndc: false };
        let run =
            AttackGeometry { bounds: (0.0, 1.0), pixel, coarse_samples: 1, are_even: false, width: 1, paper: None };
        let pass = PassGeometry { run, is_coarse: false, t_vals: &one, samples: 1, direction_norm: &one };
        let sites = sites.into_iter().map(|site| Arc::new(site) as Arc<dyn Site>);
        let sets = Sets::new(sites, &pass).unwrap();
        let mut start = Deltas::default();
        for entry in sets.iter() {
            start.insert(entry.site.name(), Tensor::zeros((1, 1, 3), DType::F64, &Device::Cpu).unwrap());
        }
        worst_case(&sets, start, loss).unwrap()
    }

    /// -|delta - peak|^2 is largest in the set at the projection of the peak.
    #[test]
    fn the_maximum_of_a_quadratic_is_found_on_the_box_and_on_the_ball() {
        for (norm, peak, steps, expected) in [
            (Norm::Linf, [3.0, -2.0, 0.0], 20, [0.5, -0.5, 0.0]),
            (Norm::L2, [3.0, 0.0, -4.0], 20, [0.3, 0.0, -0.4]),
            (Norm::L2, [3.0, 0.0, -4.0], 0, [0.0, 0.0, 0.0]),
        ] {
            let peak = Tensor::new(&[[peak]], &Device::Cpu).unwrap();
            let deltas = search([Vector { at: PaperSite::Xyz, steps, norm, radius: 0.5 }], |deltas, _| {
                let offset = (deltas.get(PaperSite::Xyz).unwrap() - &peak)?;
                Ok((offset.sqr()?.sum_all()?.neg()?, deltas.clone()))
            });
            let maximum: Vec<f64> = deltas.get(PaperSite::Xyz).unwrap().flatten_all().unwrap().to_vec1().unwrap();
            assert!(maximum.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{maximum:?}");
        }
    }

    #[test]
    fn samples_are_fixed_after_the_steps_of_the_sites_that_move_them() {
        let site = |at, steps| Vector { at, steps, norm: Norm::Linf, radius: 9.0 };
        let mut fixed = Vec::new();
        let deltas = search([site(PaperSite::Xyz, 2), site(PaperSite::Rgb, 4)], |deltas, samples_stay| {
            fixed.push(samples_stay);
            let sum = (deltas.get(PaperSite::Xyz).unwrap() + deltas.get(PaperSite::Rgb).unwrap())?;
            Ok((sum.sum_all()?, deltas.clone()))
        });
        assert_eq!(fixed, [false, false, true, true]);
        let travelled = |site| deltas.get(site).unwrap().max_all().unwrap().to_scalar::<f64>().unwrap();
        assert!((travelled(PaperSite::Xyz) - 0.2).abs() < 1e-12 && (travelled(PaperSite::Rgb) - 0.4).abs() < 1e-12);
    }
}
