//! Constraint sets of deltas in f32 on the CPU: one pass over a delta instead of one per operation. The results equal those
//! of `DeltaSet` of `augnerf_nerf::perturb` in tensor operations bit for bit.

use augnerf_base::place::is_ours_in_f32;
use augnerf_base::rng::Random;
use augnerf_base::tensors::with_values;
use candle_core::{Result, Tensor};

/// Largest number of entries of a ball. candle adds those of larger balls in an order of its own.
const LARGEST_BALL: usize = 3;

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

/// The constraint set of a delta.
pub struct Set<'a> {
    /// A ball over the delta's last axis, or a box.
    pub is_ball: bool,
    /// It broadcasts to the delta's shape; for a ball its last axis has length 1.
    pub radius: &'a Tensor,
    /// Smallest and largest allowed values.
    pub bounds: Option<(&'a Tensor, &'a Tensor)>,
    /// Multiplied in last.
    pub mask: Option<&'a Tensor>,
    /// The delta's shape.
    pub shape: &'a [usize],
}

/// The length of a step.
#[derive(Clone, Copy)]
pub enum Step {
    /// In the delta's own unit.
    Absolute(f64),
    /// In radii.
    Radii(f64),
}

/// A set in a layout for loops.
pub struct Flat<'a> {
    set: Set<'a>,
    /// Of an entry, or of a ball.
    radius: Each,
    bounds: Option<(Each, Each)>,
    mask: Option<Each>,
    /// Entries of a ball.
    columns: usize,
}

impl<'a> Flat<'a> {
    /// Returns `None` for tensors in f64 or on another device, and for large balls, which candle's own operations serve.
    ///
    /// # Errors
    /// Shapes do not fit.
    pub fn of(set: Set<'a>) -> Result<Option<Flat<'a>>> {
        let (radius, shape) = (set.radius, set.shape);
        let columns = *shape.last().expect("a delta has axes");
        let large = set.is_ball && columns > LARGEST_BALL;
        if !is_ours_in_f32(radius) || large {
            return Ok(None);
        }
        let mut outer = shape.to_vec();
        if set.is_ball {
            outer[shape.len() - 1] = 1;
        }
        let bounds =
            |(lower, upper)| -> Result<(Each, Each)> { Ok((Each::of(lower, shape)?, Each::of(upper, shape)?)) };
        Ok(Some(Flat {
            radius: Each::of(radius, &outer)?,
            bounds: set.bounds.map(bounds).transpose()?,
            mask: set.mask.map(|mask| Each::of(mask, shape)).transpose()?,
            columns,
            set,
        }))
    }

    fn tensor(&self, values: Vec<f32>) -> Result<Tensor> {
        Tensor::from_vec(values, self.set.shape, self.set.radius.device())
    }

    /// Returns the single radius of a box without bounds.
    fn plain_box(&self) -> Option<f32> {
        match (self.set.is_ball, &self.radius.0[..], &self.bounds, &self.mask) {
            (false, &[radius], None, None) => Some(radius),
            _ => None,
        }
    }

    /// Projects values onto the set.
    fn project(&self, values: &mut [f32]) {
        match self.set.is_ball {
            false => values.iter_mut().enumerate().for_each(|(i, value)| *value = clip(*value, self.radius.at(i))),
            true => {
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

    /// Returns a point drawn uniformly from the set.
    ///
    /// # Errors
    /// Those of candle.
    pub fn draw(&self, random: &mut Random) -> Result<Tensor> {
        let count = self.set.shape.iter().product();
        if let Some(radius) = self.plain_box() {
            // No random point is outside the box, so that nothing needs projection.
            return self.tensor(random.uniform_map(count, |unit| (unit * 2.0 - 1.0) * radius));
        }
        let mut values;
        match (self.set.is_ball, &self.bounds) {
            (false, None) => {
                values = random.uniform_values(count);
                for (i, value) in values.iter_mut().enumerate() {
                    *value = (*value * 2.0 - 1.0) * self.radius.at(i);
                }
            }
            (false, Some((lower, upper))) => {
                values = random.uniform_values(count);
                for (i, value) in values.iter_mut().enumerate() {
                    let radius = self.radius.at(i);
                    let (low, high) = (larger(lower.at(i), -radius), smaller(upper.at(i), radius));
                    *value = *value * (high - low) + low;
                }
            }
            (true, _) => {
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

    /// Returns `delta` after a step up the gradient, projected onto the set. `None` if delta or gradient are not contiguous.
    ///
    /// # Errors
    /// Those of candle.
    pub fn ascend(&self, delta: &Tensor, gradient: &Tensor, step: Step) -> Result<Option<Tensor>> {
        let step = |i: usize| match step {
            Step::Absolute(size) => size as f32,
            Step::Radii(size) => self.radius.at(i) * size as f32,
        };
        if let Some(radius) = self.plain_box() {
            let step = step(0);
            let moved = |(delta, &gradient): (&f32, &f32)| clip(delta + sign(gradient) * step, radius);
            let all = |delta: &[f32], gradient: &[f32]| delta.iter().zip(gradient).map(moved).collect();
            let moved = with_values(gradient, |gradient| with_values(delta, |delta| all(delta, gradient)));
            return moved.flatten().map(|moved| self.tensor(moved)).transpose();
        }
        let moved = with_values(gradient, |gradient| match self.set.is_ball {
            false => with_values(delta, |delta| {
                let entries = delta.iter().zip(gradient).enumerate();
                entries.map(|(i, (delta, &gradient))| delta + sign(gradient) * step(i)).collect::<Vec<f32>>()
            }),
            true => with_values(delta, |delta| {
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

/// Scales values to length 1; 0 stays. By the largest first, so that tiny ones do not underflow.
fn normalize(values: &mut [f32]) {
    let positive = |size: f32| if size > 0.0 { size } else { 1.0 };
    let largest = values.iter().fold(0.0, |largest: f32, value| larger(largest, value.abs()));
    values.iter_mut().for_each(|value| *value /= positive(largest));
    let norm = positive(length(values));
    values.iter_mut().for_each(|value| *value /= norm);
}
