//! Projected gradient ascent (paper, equation "PGD"; Madry et al. 2017).

use candle_core::{Tensor, Var};

use crate::augment::{Deltas, Sets};
use crate::base::Result;
use crate::settings::{LEVELS, Level, ResolvedPerturb, StepUnit};

/// Steps and step sizes of each level.
#[derive(Clone, Debug)]
pub struct StepSizes {
    steps: [usize; 6],
    step_sizes: [f64; 6],
    unit: StepUnit,
}

impl StepSizes {
    /// Those of a configuration.
    pub fn new(config: &ResolvedPerturb) -> StepSizes {
        StepSizes {
            steps: LEVELS.map(|level| config.delta(level).steps),
            step_sizes: LEVELS.map(|level| config.delta(level).step_size),
            unit: config.step_unit,
        }
    }
}

/// Ascends `loss` from `start` and returns the last iterate, without a final evaluation.
///
/// All levels move together; a level stops after its own number of steps. `loss` returns the loss
/// and the deltas as they were really used: the output level is projected again onto what the
/// forward pass leaves it, and the ascent continues from there. Weights must be frozen in `loss`.
pub fn worst_case(
    sets: &Sets,
    sizes: &StepSizes,
    start: Deltas,
    loss: impl Fn(&Deltas) -> Result<(Tensor, Deltas)>,
) -> Result<Deltas> {
    let longest = sets.levels().map(|level| sizes.steps[level as usize]).max().unwrap_or(0);
    let mut deltas = start;
    for step in 0..longest {
        let moving: Vec<Level> = sets.levels().filter(|&level| step < sizes.steps[level as usize]).collect();
        let mut tracked = deltas.clone();
        let mut variables = Vec::with_capacity(moving.len());
        for &level in &moving {
            let variable = Var::from_tensor(&deltas.get(level).expect("is on").detach())?;
            tracked.set(level, variable.as_tensor().clone());
            variables.push((level, variable));
        }
        let (loss, used) = loss(&tracked)?;
        let gradients = loss.backward()?;
        for (level, variable) in variables {
            // No gradient: the loss does not depend on this delta (sign(0) = 0).
            let Some(gradient) = gradients.get(&variable) else { continue };
            let moved = ascend(sets, sizes, level, used.get(level).expect("is on"), gradient)?;
            deltas.set(level, moved);
        }
    }
    Ok(deltas)
}

/// One projected step of one level.
fn ascend(sets: &Sets, sizes: &StepSizes, level: Level, from: &Tensor, gradient: &Tensor) -> Result<Tensor> {
    let set = sets.get(level).expect("is on");
    let step_size = sizes.step_sizes[level as usize];
    let direction = set.direction(&gradient.detach())?;
    let step = match sizes.unit {
        StepUnit::Absolute => (direction * step_size)?,
        StepUnit::Relative => direction.broadcast_mul(&(&set.radius * step_size)?)?,
    };
    Ok(set.project(&(from.detach() + step)?)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::augment::DeltaSet;
    use crate::settings::{Norm, PerturbConfig};
    use candle_core::{DType, Device};

    fn quadratic(norm: Norm, steps: usize) -> (Sets, StepSizes) {
        let mut config = PerturbConfig::default();
        config.xyz.steps = Some(steps);
        config.xyz.step_size = Some(0.1);
        let radius = Tensor::new(&[[[0.5f64]]], &Device::Cpu).unwrap();
        let mut sets = Sets::default();
        sets.set(Level::Xyz, DeltaSet::new(norm, radius, &[1, 1, 3]));
        (sets, StepSizes::new(&config.resolve(1.0)))
    }

    /// -|delta - peak|^2 is largest in the set at the projection of the peak.
    fn climb(norm: Norm, peak: [f64; 3], steps: usize) -> Vec<f64> {
        let (sets, sizes) = quadratic(norm, steps);
        let mut start = Deltas::default();
        start.set(Level::Xyz, Tensor::zeros((1, 1, 3), DType::F64, &Device::Cpu).unwrap());
        let peak = Tensor::new(&[[peak]], &Device::Cpu).unwrap();
        let found = worst_case(&sets, &sizes, start, |deltas| {
            let offset = (deltas.get(Level::Xyz).unwrap() - &peak)?;
            Ok((offset.sqr()?.sum_all()?.neg()?, deltas.clone()))
        });
        found.unwrap().get(Level::Xyz).unwrap().flatten_all().unwrap().to_vec1().unwrap()
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
}
