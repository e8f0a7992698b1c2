//! Layer normalization, with an optional ReLU after it, as one differentiable operation.
//!
//! `y = g n + b` with `n = (x - m) / sqrt(v + epsilon)`. m and v are the mean and the population variance of a group,
//! and g and b belong to channels (Ba, Kiros and Hinton 2016, equation 4). With `e = dy g`, or 0 where a ReLU gave 0:
//! `dx = (e - mean(e) - n mean(e n)) / sqrt(v + epsilon)`. candle's own layer norm has no gradient.

use std::sync::{Mutex, PoisonError};

use candle_core::{CpuStorage, CustomOp3, D, Device, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use crate::base::place::is_ours_in_f32;
use crate::base::tensors::relu;
use augnerf_fast::simd::{LANES, vectorized};

use super::values::{Values, slice, summed};

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
    /// Returns `x [.., channels]` normalized, times `scale [channels]`, plus `shift [channels]`, on any device. The bits do not depend on the number of threads.
    pub fn apply(&self, x: &Tensor, scale: &Tensor, shift: &Tensor) -> Result<Tensor> {
        if !is_ours_in_f32(x) {
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
        if self.relu { relu(&y) } else { Ok(y) }
    }
}

/// Numbers per thread and iteration. Sums are taken block by block, in order.
const BLOCK: usize = 1 << 15;

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
    fn forward(&self, cut: Cut, x: &[f32], scale: &[f32], shift: &[f32]) -> Vec<f32> {
        let mut y = vec![0f32; x.len()];
        let of_group = |(x, y): (&[f32], &mut [f32])| -> Moments {
            let moments = self.moments_of(x);
            let blocks = x.par_chunks(cut.block()).zip(y.par_chunks_mut(cut.block()));
            blocks.for_each(|(x, y)| normalize(x, moments, (scale, shift), self.norm.relu, y));
            moments
        };
        let parts = x.par_chunks(cut.part).zip(y.par_chunks_mut(cut.part));
        let of_part = |(x, y): (&[f32], &mut [f32])| -> Vec<Moments> {
            x.chunks(cut.group).zip(y.chunks_mut(cut.group)).map(of_group).collect()
        };
        let moments: Vec<Vec<Moments>> = parts.map(of_part).collect();
        *self.moments.lock().unwrap_or_else(PoisonError::into_inner) = moments.concat();
        y
    }

    fn moments_of(&self, group: &[f32]) -> Moments {
        let count = group.len() as f64;
        let mean = sum_of(group, |value| value) / count;
        let variance = sum_of(group, |value| (value - mean) * (value - mean)) / count;
        Moments { mean, inverse: 1.0 / (variance + self.norm.epsilon).sqrt() }
    }

    /// Returns the gradient of x, and those of scale and shift, one after the other, from that of `y`, the result of the
    /// forward pass.
    fn backward(&self, cut: Cut, [x, y, dy]: [&[f32]; 3], scale: &[f32]) -> (Vec<f32>, Vec<f64>) {
        let moments = self.moments.lock().unwrap_or_else(PoisonError::into_inner);
        let mut dx = vec![0f32; x.len()];
        let of_part = |(part, dx): (usize, &mut [f32])| -> Vec<f64> {
            let mut sums = vec![0f64; 2 * cut.channels];
            for (i, dx) in dx.chunks_mut(cut.group).enumerate() {
                let first = part * cut.part + i * cut.group;
                let [x, y, dy] = [x, y, dy].map(|values| &values[first..first + cut.group]);
                let back = Back { x, y, dy, moments: moments[first / cut.group], relu: self.norm.relu, cut };
                sums.iter_mut().zip(back.group(scale, dx)).for_each(|(sum, value)| *sum += value);
            }
            sums
        };
        let parts = dx.par_chunks_mut(cut.part).enumerate().map(of_part).collect();
        (dx, summed(parts, 2 * cut.channels))
    }
}

/// The backward pass of one group.
struct Back<'a> {
    x: &'a [f32],
    y: &'a [f32],
    dy: &'a [f32],
    moments: Moments,
    relu: bool,
    cut: Cut,
}

impl Back<'_> {
    /// Writes the gradient of x, and returns those of scale and shift, one after the other.
    fn group(&self, scale: &[f32], dx: &mut [f32]) -> Vec<f64> {
        let (channels, block, count) = (self.cut.channels, self.cut.block(), self.x.len() as f64);
        let blocks = self.x.par_chunks(block).zip(self.y.par_chunks(block)).zip(self.dy.par_chunks(block));
        let parts = blocks.clone().map(|((x, y), dy)| self.gradients(x, y, dy)).collect();
        let sums = summed(parts, 2 * channels);
        let weighted = |sums: &[f64]| sums.iter().zip(scale).map(|(sum, scale)| sum * f64::from(*scale)).sum::<f64>();
        let means = [weighted(&sums[channels..]) / count, weighted(&sums[..channels]) / count];
        let blocks = blocks.zip(dx.par_chunks_mut(block));
        blocks.for_each(|(((x, y), dy), dx)| self.input(x, y, dy, (scale, means), dx));
        sums
    }

    /// Returns a block's part of the gradients of scale and shift.
    fn gradients(&self, x: &[f32], y: &[f32], dy: &[f32]) -> Vec<f64> {
        let channels = self.cut.channels;
        let mut sums = vec![0f64; 2 * channels];
        let (of_scale, of_shift) = sums.split_at_mut(channels);
        let Moments { mean, inverse } = self.moments;
        vectorized(
            #[inline(always)]
            || {
                let rows = x.chunks_exact(channels).zip(y.chunks_exact(channels)).zip(dy.chunks_exact(channels));
                for ((x, y), dy) in rows {
                    let sums = of_scale.iter_mut().zip(of_shift.iter_mut());
                    for ((x, (y, dy)), (scale, shift)) in x.iter().zip(y.iter().zip(dy)).zip(sums) {
                        let dy = f64::from(masked(*dy, *y, self.relu));
                        *shift += dy;
                        *scale += dy * ((f64::from(*x) - mean) * inverse);
                    }
                }
            },
        );
        sums
    }

    /// Writes a block of the gradient of x. `means`: of e, and of e n.
    fn input(&self, x: &[f32], y: &[f32], dy: &[f32], (scale, means): (&[f32], [f64; 2]), dx: &mut [f32]) {
        let [mean, inverse, of_e, of_e_n] =
            [self.moments.mean, self.moments.inverse, means[0], means[1]].map(|value| value as f32);
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
fn masked(dy: f32, y: f32, relu: bool) -> f32 {
    if !relu || y > 0.0 { dy } else { 0.0 }
}

/// Normalizes a block of complete rows.
fn normalize(x: &[f32], moments: Moments, (scale, shift): (&[f32], &[f32]), relu: bool, y: &mut [f32]) {
    let (mean, inverse) = (moments.mean as f32, moments.inverse as f32);
    vectorized(
        #[inline(always)]
        || {
            for (x, y) in x.chunks_exact(scale.len()).zip(y.chunks_exact_mut(scale.len())) {
                for ((x, y), (scale, shift)) in x.iter().zip(y).zip(scale.iter().zip(shift)) {
                    let value = (*x - mean) * inverse * *scale + *shift;
                    // Not `max`: NaN must stay, to be found and reported.
                    *y = if relu && value < 0.0 { 0.0 } else { value };
                }
            }
        },
    );
}

/// Sums `term` of numbers, block by block in order.
fn sum_of(numbers: &[f32], term: impl Fn(f64) -> f64 + Sync) -> f64 {
    let of_block = |block: &[f32]| {
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
        let (scale, shift) = (slice(scale, scale_layout)?, slice(shift, shift_layout)?);
        Ok((CpuStorage::F32(self.forward(cut, slice(x, x_layout)?, scale, shift)), shape.clone()))
    }

    fn bwd(
        &self,
        x: &Tensor,
        scale: &Tensor,
        _shift: &Tensor,
        y: &Tensor,
        dy: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let (y, dy) = (y.contiguous()?, dy.contiguous()?);
        let [of_x, of_y, of_dy, of_scale] = [x, &y, &dy, scale].map(Values::of);
        let all = [of_x.slice()?, of_y.slice()?, of_dy.slice()?];
        let (dx, sums) = self.backward(Cut::new(self.norm.group, x.shape()), all, of_scale.slice()?);
        let (d_scale, d_shift) = sums.split_at(scale.elem_count());
        let parameter = |sums: &[f64]| Tensor::from_iter(sums.iter().map(|sum| *sum as f32), &Device::Cpu).map(Some);
        Ok((Some(Tensor::from_vec(dx, x.shape(), &Device::Cpu)?), parameter(d_scale)?, parameter(d_shift)?))
    }
}

#[cfg(test)]
mod tests;
