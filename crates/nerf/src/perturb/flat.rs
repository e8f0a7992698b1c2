//! Constraint sets in f32 on the CPU, in loops ([`augnerf_fast::sets`]). [`DeltaSet`]'s tensor operations serve f64 and other
//! devices, and are the reference, which the loops equal bit for bit.

use augnerf_fast::sets::{Flat, Set, Step};
use candle_core::Tensor;

use crate::base::Result;
use crate::base::rng::Random;
use crate::perturb::set::{DeltaSet, Draw, Norm};
use crate::perturb::site::{Pgd, StepUnit};

/// Implements [`DeltaSet::draw`].
pub(super) fn draw(set: &DeltaSet, draw: Draw, random: &mut Random) -> Result<Tensor> {
    match flat(set)?.filter(|_| draw == Draw::Uniform) {
        Some(flat) => Ok(flat.draw(random)?),
        None => set.draw(draw, random),
    }
}

/// Computes [`DeltaSet::ascend`], in loops where they can.
pub(super) fn ascend(set: &DeltaSet, delta: &Tensor, gradient: &Tensor, pgd: Pgd) -> Result<Tensor> {
    if let Some(flat) = flat(set)?
        && let Some(moved) = flat.ascend(delta, gradient, step(pgd))?
    {
        return Ok(moved);
    }
    set.ascend(delta, gradient, pgd)
}

fn flat(set: &DeltaSet) -> Result<Option<Flat<'_>>> {
    Ok(Flat::of(Set {
        is_ball: set.norm == Norm::L2,
        radius: &set.radius,
        bounds: set.bounds.as_ref().map(|(lower, upper)| (lower, upper)),
        mask: set.mask.as_ref(),
        shape: &set.shape,
    })?)
}

fn step(pgd: Pgd) -> Step {
    match pgd.unit {
        StepUnit::Absolute => Step::Absolute(pgd.step_size),
        StepUnit::Relative => Step::Radii(pgd.step_size),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::rng::Stream;
    use candle_core::{DType, Device};

    fn random(part: u64) -> Random {
        Random::part(3, Stream::Search, 5, part)
    }

    fn uniform(shape: &[usize], part: u64) -> Tensor {
        random(part).uniform_tensor(shape, DType::F32, &Device::Cpu).unwrap()
    }

    fn bits(tensor: &Tensor) -> Vec<u32> {
        tensor.flatten_all().unwrap().to_vec1::<f32>().unwrap().into_iter().map(f32::to_bits).collect()
    }

    /// Boxes and balls as the sites have them: one radius, one a ray, one a sample; bounds; a mask.
    fn sets() -> Vec<DeltaSet> {
        let shape = [4, 5, 3];
        let one = Tensor::new(&[[[0.3f32]]], &Device::Cpu).unwrap();
        let of_rays = uniform(&[4, 1, 1], 1);
        let of_samples = uniform(&[4, 5], 2);
        let lower = (uniform(&[4, 5], 3) * -0.4).unwrap();
        let mask = Tensor::new(&[[1f32, 1.0, 1.0, 1.0, 0.0]], &Device::Cpu).unwrap();
        let bounded = DeltaSet::new(Norm::Linf, of_samples.clone(), &[4, 5]).within(lower, uniform(&[4, 5], 4));
        let mut masked = DeltaSet::new(Norm::Linf, of_samples, &[4, 5]);
        masked.mask = Some(mask);
        vec![
            DeltaSet::new(Norm::Linf, one.clone(), &shape),
            DeltaSet::new(Norm::L2, one, &shape),
            DeltaSet::new(Norm::Linf, of_rays.clone(), &shape),
            DeltaSet::new(Norm::L2, of_rays, &shape),
            bounded,
            masked,
        ]
    }

    #[test]
    fn large_balls_are_left_to_tensors() {
        let radius = Tensor::new(&[[[0.3f32]]], &Device::Cpu).unwrap();
        for (columns, is_flat) in [(3, true), (4, false), (64, false)] {
            let set = DeltaSet::new(Norm::L2, radius.clone(), &[4, 5, columns]);
            assert_eq!(flat(&set).unwrap().is_some(), is_flat, "{columns}");
            let drawn = draw(&set, Draw::Uniform, &mut random(2)).unwrap();
            assert_eq!(bits(&drawn), bits(&set.draw(Draw::Uniform, &mut random(2)).unwrap()), "{columns}");
        }
    }

    #[test]
    fn loops_give_the_bits_of_tensor_operations() {
        for (index, set) in sets().iter().enumerate() {
            let flat = flat(set).unwrap().expect("f32 on the processor");
            let drawn = set.draw(Draw::Uniform, &mut random(9)).unwrap();
            assert_eq!(bits(&flat.draw(&mut random(9)).unwrap()), bits(&drawn), "draw {index}");
            // From inside, and from beyond the set's end; a gradient with zeros.
            let gradient = (uniform(&set.shape, 7) - 0.5).unwrap();
            let gradient =
                (&gradient * gradient.abs().unwrap().gt(0.1f64).unwrap().to_dtype(DType::F32).unwrap()).unwrap();
            for (delta, step_size) in [(&drawn, 0.01), (&(&drawn * 1.7).unwrap(), 0.4)] {
                for unit in [StepUnit::Absolute, StepUnit::Relative] {
                    let pgd = Pgd { steps: 1, step_size, unit };
                    let found = flat.ascend(delta, &gradient, step(pgd)).unwrap().expect("contiguous");
                    let expected = set.ascend(delta, &gradient, pgd).unwrap();
                    assert_eq!(bits(&found), bits(&expected), "step {step_size} {unit:?} in set {index}");
                }
            }
        }
    }
}
