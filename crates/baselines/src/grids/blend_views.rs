//! The head of LLFF's network (Mildenhall et al. 2019): alpha, and a colour blended from the input views.

use candle_core::{CpuStorage, CustomOp1, D, DType, Layout, Result, Shape, Tensor, WithDType};

use crate::base::place::is_ours;
use candle_nn::ops::{sigmoid, softmax};
use rayon::prelude::*;

use super::values::{Values, slice};

/// Cells per thread and iteration.
const PART: usize = 4096;

/// Largest number of input views.
pub const MOST_INPUTS: usize = 16;

/// Maps `raw [.., inputs]` and `sweep [.., 3 inputs]` to RGBA `[.., 4]`, with a gradient of `raw`. Alpha is the sigmoid
/// of channel 0. The softmax of the other channels and of a last 0 weights the views' colours.
///
/// # Errors
/// If shapes do not fit; those of candle.
pub fn blend_views(raw: &Tensor, sweep: &Tensor) -> Result<Tensor> {
    let (rank, inputs) = (raw.rank(), *raw.dims().last().unwrap_or(&0));
    let fits = raw.dims()[..rank - 1] == sweep.dims()[..rank - 1] && sweep.dims().last() == Some(&(3 * inputs));
    if !fits || inputs > MOST_INPUTS || inputs == 0 || raw.dtype() != sweep.dtype() {
        candle_core::bail!("blend views: {:?} and {:?} do not fit", raw.shape(), sweep.shape());
    }
    let sweep = sweep.contiguous()?.detach();
    if !is_ours(raw) {
        return plain(raw, &sweep);
    }
    raw.contiguous()?.apply_op1(BlendViews { sweep, inputs })
}

/// The same in candle's own operations.
fn plain(raw: &Tensor, sweep: &Tensor) -> Result<Tensor> {
    let (shape, inputs) = (raw.dims(), raw.dim(D::Minus1)?);
    let raw = raw.contiguous()?.reshape(((), inputs))?;
    let first = raw.narrow(1, 0, 1)?;
    let logits = Tensor::cat(&[&raw.narrow(1, 1, inputs - 1)?, &first.zeros_like()?], 1)?;
    let weights = softmax(&logits, 1)?.unsqueeze(2)?;
    let rgb = sweep.reshape(((), inputs, 3))?.broadcast_mul(&weights)?.sum(1)?;
    Tensor::cat(&[&rgb, &sigmoid(&first)?], 1)?.reshape([&shape[..shape.len() - 1], &[4]].concat())
}

struct BlendViews {
    sweep: Tensor,
    inputs: usize,
}

/// Returns alpha and the views' weights.
#[inline(always)]
fn shares<T: WithDType>(raw: &[T]) -> (f64, [f64; MOST_INPUTS]) {
    let alpha = 1.0 / (1.0 + (-raw[0].to_f64()).exp());
    let mut weights = [0f64; MOST_INPUTS];
    for (weight, raw) in weights.iter_mut().zip(&raw[1..]) {
        *weight = raw.to_f64();
    }
    let weights_there = &mut weights[..raw.len()];
    let largest = weights_there.iter().copied().fold(0.0, f64::max);
    weights_there.iter_mut().for_each(|weight| *weight = (*weight - largest).exp());
    let sum: f64 = weights_there.iter().sum();
    weights_there.iter_mut().for_each(|weight| *weight /= sum);
    (alpha, weights)
}

impl BlendViews {
    fn forward<T: WithDType>(&self, raw: &[T], sweep: &[T]) -> Vec<T> {
        let n = self.inputs;
        let mut out = vec![T::from_f64(0.0); raw.len() / n * 4];
        let parts = out.par_chunks_mut(4 * PART).zip(raw.par_chunks(n * PART)).zip(sweep.par_chunks(3 * n * PART));
        parts.for_each(|((out, raw), sweep)| {
            let cells = out.chunks_exact_mut(4).zip(raw.chunks_exact(n)).zip(sweep.chunks_exact(3 * n));
            for ((out, raw), sweep) in cells {
                let (alpha, weights) = shares(raw);
                for c in 0..3 {
                    out[c] = T::from_f64((0..n).map(|v| weights[v] * sweep[3 * v + c].to_f64()).sum());
                }
                out[3] = T::from_f64(alpha);
            }
        });
        out
    }

    /// Returns the gradient of `raw`. With q_v the derivative in view v's weight w_v, that of its raw number is
    /// `w_v (q_v - sum w q)`.
    fn backward<T: WithDType>(&self, raw: &[T], sweep: &[T], gradient: &[T]) -> Vec<T> {
        let n = self.inputs;
        let mut out = vec![T::from_f64(0.0); raw.len()];
        let parts = out.par_chunks_mut(n * PART).zip(raw.par_chunks(n * PART)).zip(sweep.par_chunks(3 * n * PART));
        parts.zip(gradient.par_chunks(4 * PART)).for_each(|(((out, raw), sweep), gradient)| {
            let cells = out.chunks_exact_mut(n).zip(raw.chunks_exact(n)).zip(sweep.chunks_exact(3 * n));
            for (((out, raw), sweep), gradient) in cells.zip(gradient.chunks_exact(4)) {
                let (alpha, weights) = shares(raw);
                let slope = |v: usize| (0..3).map(|c| gradient[c].to_f64() * sweep[3 * v + c].to_f64()).sum::<f64>();
                let mean: f64 = (0..n).map(|v| weights[v] * slope(v)).sum();
                out[0] = T::from_f64(gradient[3].to_f64() * alpha * (1.0 - alpha));
                for v in 0..n - 1 {
                    out[v + 1] = T::from_f64(weights[v] * (slope(v) - mean));
                }
            }
        });
        out
    }
}

impl CustomOp1 for BlendViews {
    fn name(&self) -> &'static str {
        "blend-views"
    }

    fn cpu_fwd(&self, raw: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let sweep = Values::of(&self.sweep);
        let out = match raw {
            CpuStorage::F64(_) => CpuStorage::F64(self.forward(slice(raw, layout)?, sweep.slice()?)),
            _ => CpuStorage::F32(self.forward(slice(raw, layout)?, sweep.slice()?)),
        };
        let mut dims = layout.shape().dims().to_vec();
        *dims.last_mut().expect("raw has channels") = 4;
        Ok((out, Shape::from(dims)))
    }

    fn bwd(&self, raw: &Tensor, _out: &Tensor, gradient: &Tensor) -> Result<Option<Tensor>> {
        let gradient = gradient.contiguous()?;
        let (from, sweep, gradient) = (Values::of(raw), Values::of(&self.sweep), Values::of(&gradient));
        let (shape, device) = (raw.shape(), raw.device());
        Ok(Some(match raw.dtype() {
            DType::F64 => {
                Tensor::from_vec(self.backward::<f64>(from.slice()?, sweep.slice()?, gradient.slice()?), shape, device)?
            }
            _ => {
                Tensor::from_vec(self.backward::<f32>(from.slice()?, sweep.slice()?, gradient.slice()?), shape, device)?
            }
        }))
    }
}

#[cfg(test)]
mod tests;
