//! The search for the worst case: projected gradient descent, PGD (paper, equation "PGD"; Madry et al. 2017).

use candle_core::{Tensor, Var};

use crate::augment::flat::ascend;
use crate::augment::own::OwnEntry;
use crate::augment::sets::{Deltas, Sets};
use crate::augment::site::{SiteNumbers, StepUnit};
use crate::augment::sites::{PerSite, Site};
use crate::base::Result;

/// One evaluation of the loss in a search.
pub struct Iterate<'a> {
    /// The deltas. Those of sites that still move are tracked.
    pub deltas: &'a Deltas,
    moving: &'a [Site],
}

impl Iterate<'_> {
    /// Returns whether no site that moves samples moves in this step, and so in no later one. What depends only on the
    /// samples need not be computed again.
    pub fn fixes_samples(&self) -> bool {
        !self.moving.iter().any(|site| site.about().moves_samples)
    }
}

/// Ascends `loss` from `start` and returns the last iterate, without a final evaluation.
///
/// All sites move together. A site stops after its own number of steps. `loss` returns the loss, and the deltas as they
/// were really used: the output level is projected again onto what the forward pass allows. PGD continues from there.
/// Weights must be frozen in `loss`.
///
/// # Errors
/// Those of `loss` and of candle.
pub fn worst_case(
    sets: &Sets,
    numbers: &PerSite<SiteNumbers>,
    unit: StepUnit,
    start: Deltas,
    mut loss: impl FnMut(Iterate) -> Result<(Tensor, Deltas)>,
) -> Result<Deltas> {
    let of_sites = sets.iter().map(|(site, _)| numbers[site].steps);
    let longest = of_sites.chain(sets.own().iter().map(|entry| entry.site.steps())).max().unwrap_or(0);
    let mut deltas = start;
    for step in 0..longest {
        let moving: Vec<Site> = sets.iter().map(|(site, _)| site).filter(|&site| step < numbers[site].steps).collect();
        let own: Vec<&OwnEntry> = sets.own().iter().filter(|entry| step < entry.site.steps()).collect();
        let mut tracked = deltas.clone();
        let mut variables = Vec::with_capacity(moving.len());
        for &site in &moving {
            let variable = Var::from_tensor(&deltas.get(site).expect("is on").detach())?;
            tracked.set(site, variable.as_tensor().clone());
            variables.push((site, variable));
        }
        let mut own_variables = Vec::with_capacity(own.len());
        for entry in &own {
            let variable = Var::from_tensor(&deltas.own(entry.site.name()).expect("is on").detach())?;
            tracked.set_own(entry, variable.as_tensor().clone());
            own_variables.push((*entry, variable));
        }
        let places: Vec<Site> = moving.iter().copied().chain(own.iter().map(|entry| entry.site.place())).collect();
        let (loss, used) = loss(Iterate { deltas: &tracked, moving: &places })?;
        let gradients = loss.backward()?;
        for (site, variable) in variables {
            // Without a gradient the loss does not depend on this delta (sign(0) = 0).
            let Some(gradient) = gradients.get(&variable) else { continue };
            let set = sets.get(site).expect("is on");
            let delta = used.get(site).expect("is on").detach();
            deltas.set(site, ascend(set, &delta, &gradient.detach(), numbers[site].step_size, unit)?);
        }
        for (entry, variable) in own_variables {
            let Some(gradient) = gradients.get(&variable) else { continue };
            let delta = used.own(entry.site.name()).expect("is on").detach();
            let step_size = entry.site.step_size();
            deltas.set_own(entry, ascend(&entry.own.set, &delta, &gradient.detach(), step_size, StepUnit::Relative)?);
        }
    }
    Ok(deltas)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::augment::epsilon::Epsilon;
    use crate::augment::set::{DeltaSet, Norm};
    use crate::augment::site::Passes;
    use candle_core::{DType, Device};

    fn numbers(steps: impl Fn(Site) -> usize) -> PerSite<SiteNumbers> {
        let norm = Norm::Linf;
        PerSite::from_fn(|site| SiteNumbers {
            passes: Passes::Both,
            steps: steps(site),
            step_size: 0.1,
            epsilon: Epsilon::Units(1.0),
            norm,
        })
    }

    fn zeros() -> Tensor {
        Tensor::zeros((1, 1, 3), DType::F64, &Device::Cpu).unwrap()
    }

    /// -|delta - peak|^2 is largest in the set at the projection of the peak.
    fn climb(norm: Norm, peak: [f64; 3], steps: usize) -> Vec<f64> {
        let radius = Tensor::new(&[[[0.5f64]]], &Device::Cpu).unwrap();
        let mut sets = Sets::default();
        sets.set(Site::Xyz, DeltaSet::new(norm, radius, &[1, 1, 3]));
        let mut start = Deltas::default();
        start.set(Site::Xyz, zeros());
        let peak = Tensor::new(&[[peak]], &Device::Cpu).unwrap();
        let found = worst_case(&sets, &numbers(|_| steps), StepUnit::Absolute, start, |at| {
            let offset = (at.deltas.get(Site::Xyz).unwrap() - &peak)?;
            Ok((offset.sqr()?.sum_all()?.neg()?, at.deltas.clone()))
        });
        found.unwrap().get(Site::Xyz).unwrap().flatten_all().unwrap().to_vec1().unwrap()
    }

    #[test]
    fn the_maximum_of_a_quadratic_is_found_on_the_box_and_on_the_ball() {
        let close = |found: &[f64], expected: [f64; 3]| {
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}");
        };
        close(&climb(Norm::Linf, [3.0, -2.0, 0.0], 20), [0.5, -0.5, 0.0]);
        close(&climb(Norm::L2, [3.0, 0.0, -4.0], 20), [0.3, 0.0, -0.4]);
        close(&climb(Norm::L2, [3.0, 0.0, -4.0], 0), [0.0, 0.0, 0.0]);
    }

    #[test]
    fn samples_are_fixed_after_the_steps_of_the_sites_that_move_them() {
        let (mut sets, mut start) = (Sets::default(), Deltas::default());
        for site in [Site::Xyz, Site::Rgb] {
            sets.set(site, DeltaSet::new(Norm::Linf, Tensor::new(&[[[9f64]]], &Device::Cpu).unwrap(), &[1, 1, 3]));
            start.set(site, zeros());
        }
        let steps = numbers(|site| if site == Site::Xyz { 2 } else { 4 });
        let mut fixed = Vec::new();
        let found = worst_case(&sets, &steps, StepUnit::Absolute, start, |at| {
            fixed.push(at.fixes_samples());
            let sum = (at.deltas.get(Site::Xyz).unwrap() + at.deltas.get(Site::Rgb).unwrap())?;
            Ok((sum.sum_all()?, at.deltas.clone()))
        });
        assert_eq!(fixed, [false, false, true, true]);
        let travelled =
            |site| found.as_ref().unwrap().get(site).unwrap().max_all().unwrap().to_scalar::<f64>().unwrap();
        assert!((travelled(Site::Xyz) - 0.2).abs() < 1e-12 && (travelled(Site::Rgb) - 0.4).abs() < 1e-12);
    }
}
