//! Constraint sets in f32 on the CPU: one pass over a delta instead of one per operation. The results equal those of
//! [`DeltaSet`]'s tensor operations bit for bit. The latter serve f64 and other devices, and are the reference.

use candle_core::Tensor;

use crate::base::Result;
use crate::base::place::is_ours_in_f32;
use crate::base::rng::Random;
use crate::base::tensors::with_values;
use crate::perturb::set::{DeltaSet, Draw, Norm};
use crate::perturb::site::{Pgd, StepUnit};

/// Largest number of entries of a ball. candle adds those of larger balls in an order of its own.
const LARGEST_BALL: usize = 3;

/// Implements [`DeltaSet::draw`].
pub(super) fn draw(set: &DeltaSet, draw: Draw, random: &mut Random) -> Result<Tensor> {
    match Flat::of(set)?.filter(|_| draw == Draw::Uniform) {
        Some(flat) => flat.draw(random),
        None => set.draw(draw, random),
    }
}

/// Computes [`DeltaSet::ascend`], in loops where they can.
pub(super) fn ascend(set: &DeltaSet, delta: &Tensor, gradient: &Tensor, pgd: Pgd) -> Result<Tensor> {
    if let Some(flat) = Flat::of(set)?
        && let Some(moved) = flat.ascend(delta, gradient, pgd)?
    {
        return Ok(moved);
    }
    set.ascend(delta, gradient, pgd)
}

/// One number for all entries (for a ball: for all samples), or one for each.
struct Each(Vec<f32>);

impl Each {
    /// Broadcasts `tensor` over `shape`.
    fn of(tensor: &Tensor, shape: &[usize]) -> Result<Each> {
        let tensor = if tensor.elem_count() == 1 { tensor.clone() } else { tensor.broadcast_as(shape)? };
        Ok(Each(tensor.flatten_all()?.to_vec1()?))
    }

    fn at(&self, index: usize) -> f32 {
        if self.0.len() == 1 { self.0[0] } else { self.0[index] }
    }
}

/// A set in a layout for loops.
struct Flat<'a> {
    set: &'a DeltaSet,
    /// Of an entry, or of a ball.
    radius: Each,
    bounds: Option<(Each, Each)>,
    mask: Option<Each>,
    /// Entries of a ball.
    columns: usize,
}

impl<'a> Flat<'a> {
    /// Returns `None` for tensors in f64 or on another device, and for large balls.
    fn of(set: &'a DeltaSet) -> Result<Option<Flat<'a>>> {
        let (radius, shape) = (&set.radius, &set.shape);
        let columns = *shape.last().expect("a delta has axes");
        let large = set.norm == Norm::L2 && columns > LARGEST_BALL;
        if !is_ours_in_f32(radius) || large {
            return Ok(None);
        }
        let mut outer = shape.clone();
        if set.norm == Norm::L2 {
            outer[shape.len() - 1] = 1;
        }
        let bounds = set
            .bounds
            .as_ref()
            .map(|(lower, upper)| -> Result<(Each, Each)> { Ok((Each::of(lower, shape)?, Each::of(upper, shape)?)) });
        Ok(Some(Flat {
            set,
            radius: Each::of(radius, &outer)?,
            bounds: bounds.transpose()?,
            mask: set.mask.as_ref().map(|mask| Each::of(mask, shape)).transpose()?,
            columns,
        }))
    }

    fn tensor(&self, values: Vec<f32>) -> Result<Tensor> {
        Ok(Tensor::from_vec(values, self.set.shape.as_slice(), self.set.radius.device())?)
    }

    /// Returns the single radius of a box without bounds.
    fn plain_box(&self) -> Option<f32> {
        match (self.set.norm, &self.radius.0[..], &self.bounds, &self.mask) {
            (Norm::Linf, &[radius], None, None) => Some(radius),
            _ => None,
        }
    }

    /// Implements [`DeltaSet::project`].
    fn project(&self, values: &mut [f32]) {
        match self.set.norm {
            Norm::Linf => values.iter_mut().enumerate().for_each(|(i, value)| *value = clip(*value, self.radius.at(i))),
            Norm::L2 => {
                for (ball, values) in values.chunks_exact_mut(self.columns).enumerate() {
                    let (radius, norm) = (self.radius.at(ball), length(values));
                    let scale = if norm <= radius { 1.0 } else { smaller(radius / norm, 1.0) };
                    values.iter_mut().for_each(|value| *value *= scale);
                }
            }
        }
        if let Some((lower, upper)) = &self.bounds {
            for (i, value) in values.iter_mut().enumerate() {
                *value = larger(smaller(*value, upper.at(i)), lower.at(i));
            }
        }
        if let Some(mask) = &self.mask {
            values.iter_mut().enumerate().for_each(|(i, value)| *value *= mask.at(i));
        }
    }

    /// Implements [`DeltaSet::draw`] for a uniform point.
    fn draw(&self, random: &mut Random) -> Result<Tensor> {
        let count = self.set.shape.iter().product();
        if let Some(radius) = self.plain_box() {
            // No random point is outside the box, so that nothing needs projection.
            return self.tensor(random.uniform_map(count, |unit| (unit * 2.0 - 1.0) * radius));
        }
        let mut values;
        match (self.set.norm, &self.bounds) {
            (Norm::Linf, None) => {
                values = random.uniform_values(count);
                for (i, value) in values.iter_mut().enumerate() {
                    *value = (*value * 2.0 - 1.0) * self.radius.at(i);
                }
            }
            (Norm::Linf, Some((lower, upper))) => {
                values = random.uniform_values(count);
                for (i, value) in values.iter_mut().enumerate() {
                    let radius = self.radius.at(i);
                    let (low, high) = (larger(lower.at(i), -radius), smaller(upper.at(i), radius));
                    *value = *value * (high - low) + low;
                }
            }
            (Norm::L2, _) => {
                values = random.normal_values(count);
                let distances = random.uniform_values(count / self.columns);
                let root = (1.0 / self.columns as f64) as f32;
                for (ball, (values, distance)) in values.chunks_exact_mut(self.columns).zip(distances).enumerate() {
                    normalize(values);
                    let (distance, radius) = (distance.powf(root), self.radius.at(ball));
                    values.iter_mut().for_each(|value| *value = *value * distance * radius);
                }
            }
        }
        self.project(&mut values);
        self.tensor(values)
    }

    /// Implements [`ascend`]. Returns `None` if delta or gradient are not contiguous.
    fn ascend(&self, delta: &Tensor, gradient: &Tensor, pgd: Pgd) -> Result<Option<Tensor>> {
        let size = pgd.step_size as f32;
        let step = |i: usize| match pgd.unit {
            StepUnit::Absolute => size,
            StepUnit::Relative => self.radius.at(i) * size,
        };
        if let Some(radius) = self.plain_box() {
            let step = step(0);
            let moved = |(delta, &gradient): (&f32, &f32)| clip(delta + sign(gradient) * step, radius);
            let all = |delta: &[f32], gradient: &[f32]| delta.iter().zip(gradient).map(moved).collect();
            let moved = with_values(gradient, |gradient| with_values(delta, |delta| all(delta, gradient)));
            return moved.flatten().map(|moved| self.tensor(moved)).transpose();
        }
        let moved = with_values(gradient, |gradient| match self.set.norm {
            Norm::Linf => with_values(delta, |delta| {
                let entries = delta.iter().zip(gradient).enumerate();
                entries.map(|(i, (delta, &gradient))| delta + sign(gradient) * step(i)).collect::<Vec<f32>>()
            }),
            Norm::L2 => with_values(delta, |delta| {
                let mut moved = gradient.to_vec();
                let rows = moved.chunks_exact_mut(self.columns).zip(delta.chunks_exact(self.columns));
                for (ball, (moved, delta)) in rows.enumerate() {
                    normalize(moved);
                    let step = step(ball);
                    moved.iter_mut().zip(delta).for_each(|(moved, delta)| *moved = delta + *moved * step);
                }
                moved
            }),
        });
        let Some(mut moved) = moved.flatten() else { return Ok(None) };
        self.project(&mut moved);
        self.tensor(moved).map(Some)
    }
}

/// candle's `minimum` of two numbers: NaN on the left stays.
pub fn smaller(a: f32, b: f32) -> f32 {
    if a > b { b } else { a }
}

/// candle's `maximum` of two numbers: NaN on the left stays.
pub fn larger(a: f32, b: f32) -> f32 {
    if a < b { b } else { a }
}

/// Clips to a box.
fn clip(value: f32, radius: f32) -> f32 {
    larger(smaller(value, radius), -radius)
}

fn sign(value: f32) -> f32 {
    f32::from(u8::from(value > 0.0)) - f32::from(u8::from(value < 0.0))
}

fn length(values: &[f32]) -> f32 {
    values.iter().fold(0.0, |sum: f32, value| sum + value * value).sqrt()
}

/// Implements [`DeltaSet::direction`] for a ball.
fn normalize(values: &mut [f32]) {
    let positive = |size: f32| if size > 0.0 { size } else { 1.0 };
    let largest = values.iter().fold(0.0, |largest: f32, value| larger(largest, value.abs()));
    values.iter_mut().for_each(|value| *value /= positive(largest));
    let norm = positive(length(values));
    values.iter_mut().for_each(|value| *value /= norm);
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
        for (columns, flat) in [(3, true), (4, false), (64, false)] {
            let set = DeltaSet::new(Norm::L2, radius.clone(), &[4, 5, columns]);
            assert_eq!(Flat::of(&set).unwrap().is_some(), flat, "{columns}");
            let drawn = draw(&set, Draw::Uniform, &mut random(2)).unwrap();
            assert_eq!(bits(&drawn), bits(&set.draw(Draw::Uniform, &mut random(2)).unwrap()), "{columns}");
        }
    }

    #[test]
    fn loops_give_the_bits_of_tensor_operations() {
        for (index, set) in sets().iter().enumerate() {
            let flat = Flat::of(set).unwrap().expect("f32 on the processor");
            let drawn = set.draw(Draw::Uniform, &mut random(9)).unwrap();
            assert_eq!(bits(&flat.draw(&mut random(9)).unwrap()), bits(&drawn), "draw {index}");
            // From inside, and from beyond the set's end; a gradient with zeros.
            let gradient = (uniform(&set.shape, 7) - 0.5).unwrap();
            let gradient =
                (&gradient * gradient.abs().unwrap().gt(0.1f64).unwrap().to_dtype(DType::F32).unwrap()).unwrap();
            for (delta, step_size) in [(&drawn, 0.01), (&(&drawn * 1.7).unwrap(), 0.4)] {
                for unit in [StepUnit::Absolute, StepUnit::Relative] {
                    let pgd = Pgd { steps: 1, step_size, unit };
                    let found = flat.ascend(delta, &gradient, pgd).unwrap().expect("contiguous");
                    let expected = set.ascend(delta, &gradient, pgd).unwrap();
                    assert_eq!(bits(&found), bits(&expected), "step {step_size} {unit:?} in set {index}");
                }
            }
        }
    }
}
