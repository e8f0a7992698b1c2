//! Layer normalization, with an optional ReLU after it, as one differentiable operation.
//!
//! `y = g n + b` with `n = (x - m) / sqrt(v + epsilon)`. m and v are the mean and the population variance of a group,
//! and g and b belong to channels (Ba, Kiros and Hinton 2016, equation 4). With `e = dy g`, or 0 where a ReLU gave 0:
//! `dx = (e - mean(e) - n mean(e n)) / sqrt(v + epsilon)`. candle's own layer norm has no gradient.

use std::sync::{Mutex, PoisonError};

use candle_core::{CpuStorage, CustomOp3, D, DType, Layout, Result, Shape, Tensor, WithDType};
use rayon::prelude::*;

use crate::base::place::is_ours;
use augnerf_fast::simd::{LANES, vectorized};

use super::values::{Values, slice};

/// The numbers with a common mean and variance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NormGroup {
    /// The channels at one location (PyTorch's `LayerNorm` over the last axis).
    Channels,
    /// All locations and channels of one sample, an entry of the first axis (TensorFlow slim's `layer_norm`).
    Sample,
}

/// A normalization of tensors whose last axis holds channels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LayerNorm {
    /// The numbers with a common mean and variance.
    pub group: NormGroup,
    /// Added to variances.
    pub epsilon: f64,
    /// Whether a ReLU follows.
    pub relu: bool,
}

impl LayerNorm {
    /// Returns `x [.., channels]` normalized, times `scale [channels]`, plus `shift [channels]`, in f32 or f64, on any
    /// device. The bits do not depend on the number of threads.
    pub fn apply(&self, x: &Tensor, scale: &Tensor, shift: &Tensor) -> Result<Tensor> {
        if !is_ours(x) {
            return self.reference(x, scale, shift);
        }
        let operation = Normalize { norm: *self, moments: Mutex::default() };
        x.contiguous()?.apply_op3(&scale.contiguous()?, &shift.contiguous()?, operation)
    }

    /// Returns the same in candle's operations.
    pub fn reference(&self, x: &Tensor, scale: &Tensor, shift: &Tensor) -> Result<Tensor> {
        let groups = match self.group {
            NormGroup::Channels => x.flatten_to(D::Minus2)?,
            NormGroup::Sample => x.flatten_from(1)?,
        };
        let centred = groups.broadcast_sub(&groups.mean_keepdim(1)?)?;
        let deviation = (centred.sqr()?.mean_keepdim(1)? + self.epsilon)?.sqrt()?;
        let normal = centred.broadcast_div(&deviation)?.reshape(x.shape())?;
        let y = normal.broadcast_mul(scale)?.broadcast_add(shift)?;
        if self.relu { y.relu() } else { Ok(y) }
    }
}

/// Numbers per thread and iteration. Sums are taken block by block, in order.
const BLOCK: usize = 1 << 15;

/// f32 or f64. Sums are in f64.
trait Number: WithDType + Into<f64> {
    const ZERO: Self;
    fn of(value: f64) -> Self;
}

impl Number for f32 {
    const ZERO: f32 = 0.0;
    #[inline(always)]
    fn of(value: f64) -> f32 {
        value as f32
    }
}

impl Number for f64 {
    const ZERO: f64 = 0.0;
    #[inline(always)]
    fn of(value: f64) -> f64 {
        value
    }
}

/// Mean and 1 / sqrt(v + epsilon) of a group.
#[derive(Clone, Copy)]
struct Moments {
    mean: f64,
    inverse: f64,
}

/// The division of a tensor: counts of numbers, each a multiple of the one before.
#[derive(Clone, Copy)]
struct Cut {
    channels: usize,
    /// Numbers in a group.
    group: usize,
    /// Least number of numbers per thread, in complete groups.
    part: usize,
}

impl Cut {
    fn new(group: NormGroup, shape: &Shape) -> Cut {
        let dims = shape.dims();
        let channels = dims[dims.len() - 1];
        let group = match group {
            NormGroup::Channels => channels,
            NormGroup::Sample => dims.iter().skip(1).product(),
        };
        Cut { channels, group, part: (BLOCK / group).max(1) * group }
    }

    /// Returns the numbers of a block within a group.
    fn block(self) -> usize {
        (BLOCK / self.channels).max(1) * self.channels
    }
}

struct Normalize {
    norm: LayerNorm,
    /// Of every group, kept from the forward to the backward pass.
    moments: Mutex<Vec<Moments>>,
}

impl Normalize {
    fn forward<T: Number>(&self, cut: Cut, x: &[T], scale: &[T], shift: &[T]) -> Vec<T> {
        let mut y = vec![T::ZERO; x.len()];
        let of_group = |(x, y): (&[T], &mut [T])| -> Moments {
            let moments = self.moments_of(x);
            let blocks = x.par_chunks(cut.block()).zip(y.par_chunks_mut(cut.block()));
            blocks.for_each(|(x, y)| normalize(x, moments, (scale, shift), self.norm.relu, y));
            moments
        };
        let parts = x.par_chunks(cut.part).zip(y.par_chunks_mut(cut.part));
        let of_part = |(x, y): (&[T], &mut [T])| -> Vec<Moments> {
            x.chunks(cut.group).zip(y.chunks_mut(cut.group)).map(of_group).collect()
        };
        let moments: Vec<Vec<Moments>> = parts.map(of_part).collect();
        *self.moments.lock().unwrap_or_else(PoisonError::into_inner) = moments.concat();
        y
    }

    fn moments_of<T: Number>(&self, group: &[T]) -> Moments {
        let count = group.len() as f64;
        let mean = sum_of(group, |value| value) / count;
        let variance = sum_of(group, |value| (value - mean) * (value - mean)) / count;
        Moments { mean, inverse: 1.0 / (variance + self.norm.epsilon).sqrt() }
    }

    /// Returns gradients of x, scale and shift from that of `y`, the result of the forward pass.
    fn backward<T: Number>(&self, cut: Cut, [x, y, dy]: [&[T]; 3], scale: &[T]) -> [Vec<T>; 3] {
        let moments = self.moments.lock().unwrap_or_else(PoisonError::into_inner);
        let mut dx = vec![T::ZERO; x.len()];
        let of_part = |(part, dx): (usize, &mut [T])| -> Gradients {
            let mut gradients = Gradients::none(cut.channels);
            for (i, dx) in dx.chunks_mut(cut.group).enumerate() {
                let first = part * cut.part + i * cut.group;
                let [x, y, dy] = [x, y, dy].map(|values| &values[first..first + cut.group]);
                let back = Back { x, y, dy, moments: moments[first / cut.group], relu: self.norm.relu, cut };
                gradients.add(&back.group(scale, dx));
            }
            gradients
        };
        let parts: Vec<Gradients> = dx.par_chunks_mut(cut.part).enumerate().map(of_part).collect();
        let Gradients { scale, shift } = Gradients::sum(cut.channels, &parts);
        let numbers = |sums: Vec<f64>| sums.into_iter().map(T::of).collect();
        [dx, numbers(scale), numbers(shift)]
    }
}

impl Normalize {
    /// Returns gradients of x, scale and shift.
    fn gradients<T: Number>(&self, x: &Tensor, scale: &Tensor, y: &Tensor, dy: &Tensor) -> Result<[Tensor; 3]> {
        let cut = Cut::new(self.norm.group, x.shape());
        let (y, dy) = (y.contiguous()?, dy.contiguous()?);
        let [of_x, of_y, of_dy, of_scale] = [x, &y, &dy, scale].map(Values::of);
        let all = [of_x.slice::<T>()?, of_y.slice()?, of_dy.slice()?];
        let [dx, d_scale, d_shift] = self.backward(cut, all, of_scale.slice()?);
        let tensor = |values, like: &Tensor| Tensor::from_vec(values, like.shape(), like.device());
        Ok([tensor(dx, x)?, tensor(d_scale, scale)?, tensor(d_shift, scale)?])
    }
}

/// Gradients of scale and shift, `[channels]` each.
struct Gradients {
    scale: Vec<f64>,
    shift: Vec<f64>,
}

impl Gradients {
    fn none(channels: usize) -> Gradients {
        Gradients { scale: vec![0.0; channels], shift: vec![0.0; channels] }
    }

    fn sum(channels: usize, parts: &[Gradients]) -> Gradients {
        let mut sum = Gradients::none(channels);
        parts.iter().for_each(|part| sum.add(part));
        sum
    }

    fn add(&mut self, other: &Gradients) {
        self.scale.iter_mut().zip(&other.scale).for_each(|(sum, value)| *sum += value);
        self.shift.iter_mut().zip(&other.shift).for_each(|(sum, value)| *sum += value);
    }
}

/// The backward pass of one group.
struct Back<'a, T> {
    x: &'a [T],
    y: &'a [T],
    dy: &'a [T],
    moments: Moments,
    relu: bool,
    cut: Cut,
}

impl<T: Number> Back<'_, T> {
    /// Writes the gradient of x, and returns the others.
    fn group(&self, scale: &[T], dx: &mut [T]) -> Gradients {
        let (channels, block, count) = (self.cut.channels, self.cut.block(), self.x.len() as f64);
        let blocks = self.x.par_chunks(block).zip(self.y.par_chunks(block)).zip(self.dy.par_chunks(block));
        let parts: Vec<Gradients> = blocks.clone().map(|((x, y), dy)| self.gradients(x, y, dy)).collect();
        let gradients = Gradients::sum(channels, &parts);
        let weighted = |sums: &[f64]| sums.iter().zip(scale).map(|(sum, scale)| sum * (*scale).into()).sum::<f64>();
        let means = [weighted(&gradients.shift) / count, weighted(&gradients.scale) / count];
        let blocks = blocks.zip(dx.par_chunks_mut(block));
        blocks.for_each(|(((x, y), dy), dx)| self.input(x, y, dy, (scale, means), dx));
        gradients
    }

    /// Returns a block's part of the gradients of scale and shift.
    fn gradients(&self, x: &[T], y: &[T], dy: &[T]) -> Gradients {
        let (mut sums, channels) = (Gradients::none(self.cut.channels), self.cut.channels);
        let Moments { mean, inverse } = self.moments;
        vectorized(
            #[inline(always)]
            || {
                let rows = x.chunks_exact(channels).zip(y.chunks_exact(channels)).zip(dy.chunks_exact(channels));
                for ((x, y), dy) in rows {
                    let sums = sums.scale.iter_mut().zip(&mut sums.shift);
                    for ((x, (y, dy)), (scale, shift)) in x.iter().zip(y.iter().zip(dy)).zip(sums) {
                        let dy: f64 = masked(*dy, *y, self.relu).into();
                        *shift += dy;
                        *scale += dy * (((*x).into() - mean) * inverse);
                    }
                }
            },
        );
        sums
    }

    /// Writes a block of the gradient of x. `means`: of e, and of e n.
    fn input(&self, x: &[T], y: &[T], dy: &[T], (scale, means): (&[T], [f64; 2]), dx: &mut [T]) {
        let [mean, inverse, of_e, of_e_n] = [self.moments.mean, self.moments.inverse, means[0], means[1]].map(T::of);
        let channels = self.cut.channels;
        vectorized(
            #[inline(always)]
            || {
                let rows = x.chunks_exact(channels).zip(y.chunks_exact(channels)).zip(dy.chunks_exact(channels));
                for (((x, y), dy), dx) in rows.zip(dx.chunks_exact_mut(channels)) {
                    let given = x.iter().zip(y.iter().zip(dy)).zip(scale);
                    for (((x, (y, dy)), scale), dx) in given.zip(dx) {
                        let normal = (*x - mean) * inverse;
                        *dx = (masked(*dy, *y, self.relu) * *scale - of_e - normal * of_e_n) * inverse;
                    }
                }
            },
        );
    }
}

/// Returns a gradient behind the optional ReLU.
#[inline(always)]
fn masked<T: Number>(dy: T, y: T, relu: bool) -> T {
    if !relu || y > T::ZERO { dy } else { T::ZERO }
}

/// Normalizes a block of complete rows.
fn normalize<T: Number>(x: &[T], moments: Moments, (scale, shift): (&[T], &[T]), relu: bool, y: &mut [T]) {
    let (mean, inverse) = (T::of(moments.mean), T::of(moments.inverse));
    vectorized(
        #[inline(always)]
        || {
            for (x, y) in x.chunks_exact(scale.len()).zip(y.chunks_exact_mut(scale.len())) {
                for ((x, y), (scale, shift)) in x.iter().zip(y).zip(scale.iter().zip(shift)) {
                    let value = (*x - mean) * inverse * *scale + *shift;
                    // Not `max`: NaN must stay, to be found and reported.
                    *y = if relu && value < T::ZERO { T::ZERO } else { value };
                }
            }
        },
    );
}

/// Sums `term` of numbers, block by block in order.
fn sum_of<T: Number>(numbers: &[T], term: impl Fn(f64) -> f64 + Sync) -> f64 {
    let of_block = |block: &[T]| {
        let mut lanes = [0f64; LANES];
        let (whole, rest) = block.as_chunks::<LANES>();
        vectorized(
            #[inline(always)]
            || {
                for numbers in whole {
                    for (lane, number) in lanes.iter_mut().zip(numbers) {
                        *lane += term((*number).into());
                    }
                }
            },
        );
        lanes.iter().sum::<f64>() + rest.iter().map(|number| term((*number).into())).sum::<f64>()
    };
    match numbers.len() <= BLOCK {
        true => of_block(numbers),
        false => numbers.par_chunks(BLOCK).map(of_block).collect::<Vec<f64>>().iter().sum(),
    }
}

impl CustomOp3 for Normalize {
    fn name(&self) -> &'static str {
        "layer-norm"
    }

    fn cpu_fwd(
        &self,
        x: &CpuStorage,
        x_layout: &Layout,
        scale: &CpuStorage,
        scale_layout: &Layout,
        shift: &CpuStorage,
        shift_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let shape = x_layout.shape();
        let cut = Cut::new(self.norm.group, shape);
        let y = match x {
            CpuStorage::F32(_) => {
                let (scale, shift) = (slice(scale, scale_layout)?, slice(shift, shift_layout)?);
                CpuStorage::F32(self.forward(cut, slice::<f32>(x, x_layout)?, scale, shift))
            }
            CpuStorage::F64(_) => {
                let (scale, shift) = (slice(scale, scale_layout)?, slice(shift, shift_layout)?);
                CpuStorage::F64(self.forward(cut, slice::<f64>(x, x_layout)?, scale, shift))
            }
            _ => candle_core::bail!("layer norm is for f32 and f64"),
        };
        Ok((y, shape.clone()))
    }

    fn bwd(
        &self,
        x: &Tensor,
        scale: &Tensor,
        _shift: &Tensor,
        y: &Tensor,
        dy: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let [dx, d_scale, d_shift] = match x.dtype() {
            DType::F32 => self.gradients::<f32>(x, scale, y, dy)?,
            _ => self.gradients::<f64>(x, scale, y, dy)?,
        };
        Ok((Some(dx), Some(d_scale), Some(d_shift)))
    }
}

#[cfg(test)]
mod tests;
