//! The over operator: alpha compositing of planes behind one another.
//!
//! Plane 0 is the farthest. Plane k has the weight `w_k = a_k prod (1 - a_j + 1e-10)`, over the nearer planes j. The
//! constant is LLFF's (Mildenhall et al. 2019, the authors' code), and keeps opaque planes from stopping all gradients.

use candle_core::{CpuStorage, CustomOp1, DType, Layout, Result, Shape, Tensor, WithDType};

use crate::base::place::is_ours;
use rayon::prelude::*;

use super::values::{Values, slice};

/// Transmittance of an opaque plane.
const LEAK: f64 = 1e-10;

/// Rays per thread and iteration.
const PART: usize = 256;

/// Numbers of a plane: red, green, blue, alpha.
const CHANNELS: usize = 4;

/// The transmittance along planes from the nearest on.
#[derive(Clone, Copy, Debug)]
pub struct Passing {
    transmittance: f64,
}

impl Default for Passing {
    fn default() -> Passing {
        Passing { transmittance: 1.0 }
    }
}

impl Passing {
    /// Returns the weight of the next plane.
    #[inline(always)]
    pub fn weight(&mut self, alpha: f64) -> f64 {
        let weight = alpha * self.transmittance;
        self.transmittance *= 1.0 - alpha + LEAK;
        weight
    }
}

/// Composites planes `[rays, planes, 4]` (RGBA, straight alpha). Returns the weighted sum of colours and the sum of
/// weights, `[rays, 4]`. On the CPU sums are in f64.
///
/// # Errors
/// If the shape is wrong; those of candle.
pub fn alpha_over(planes: &Tensor) -> Result<Tensor> {
    let (_, _, channels) = planes.dims3()?;
    if channels != CHANNELS {
        candle_core::bail!("alpha over: planes have red, green, blue and alpha, not {channels} channels");
    }
    if !is_ours(planes) {
        return plain(planes);
    }
    planes.contiguous()?.apply_op1(AlphaOver)
}

/// The same in candle's own operations, plane after plane.
fn plain(planes: &Tensor) -> Result<Tensor> {
    let (rays, count, _) = planes.dims3()?;
    let mut transmittance = Tensor::ones((rays, 1), planes.dtype(), planes.device())?;
    let mut sum = Tensor::zeros((rays, CHANNELS), planes.dtype(), planes.device())?;
    for k in (0..count).rev() {
        let plane = planes.narrow(1, k, 1)?.squeeze(1)?;
        let alpha = plane.narrow(1, CHANNELS - 1, 1)?;
        let weight = (&alpha * &transmittance)?;
        sum = (sum + Tensor::cat(&[&plane.narrow(1, 0, CHANNELS - 1)?.broadcast_mul(&weight)?, &weight], 1)?)?;
        transmittance = (transmittance * ((1.0 - alpha)? + LEAK)?)?;
    }
    Ok(sum)
}

struct AlphaOver;

impl AlphaOver {
    fn forward<T: WithDType>(planes: &[T], count: usize) -> Vec<T> {
        let mut out = vec![T::from_f64(0.0); planes.len() / count.max(1)];
        let parts = out.par_chunks_mut(PART * CHANNELS).zip(planes.par_chunks(PART * CHANNELS * count));
        parts.for_each(|(out, planes)| {
            for (out, ray) in out.chunks_exact_mut(CHANNELS).zip(planes.chunks_exact(CHANNELS * count)) {
                let (mut sum, mut passing) = ([0f64; CHANNELS], Passing::default());
                for plane in ray.chunks_exact(CHANNELS).rev() {
                    let weight = passing.weight(plane[3].to_f64());
                    (0..3).for_each(|c| sum[c] += weight * plane[c].to_f64());
                    sum[3] += weight;
                }
                out.iter_mut().zip(sum).for_each(|(out, sum)| *out = T::from_f64(sum));
            }
        });
        out
    }

    /// Returns the gradient of the planes. With G_k the gradient of weight k, T_k the transmittance before it and S_k
    /// what the farther planes add per unit of transmittance behind it, that of alpha k is `T_k (G_k - S_k)`. For the
    /// next nearer one `S = G_k a_k + (1 - a_k + 1e-10) S_k`.
    fn backward<T: WithDType>(planes: &[T], gradient: &[T], count: usize) -> Vec<T> {
        let mut out = vec![T::from_f64(0.0); planes.len()];
        let size = CHANNELS * count;
        let parts = out.par_chunks_mut(PART * size).zip(planes.par_chunks(PART * size));
        parts.zip(gradient.par_chunks(PART * CHANNELS)).for_each(|((out, planes), gradient)| {
            let mut before = vec![0f64; count];
            let rays = out.chunks_exact_mut(size).zip(planes.chunks_exact(size)).zip(gradient.chunks_exact(CHANNELS));
            for ((out, ray), gradient) in rays {
                let mut passing = Passing::default();
                for k in (0..count).rev() {
                    before[k] = passing.transmittance;
                    passing.weight(ray[CHANNELS * k + 3].to_f64());
                }
                let gradient: [f64; CHANNELS] = std::array::from_fn(|c| gradient[c].to_f64());
                let mut behind = 0.0;
                let planes = out.chunks_exact_mut(CHANNELS).zip(ray.chunks_exact(CHANNELS)).zip(&before);
                for ((out, plane), before) in planes {
                    let alpha = plane[3].to_f64();
                    let of_weight = gradient[3] + (0..3).map(|c| gradient[c] * plane[c].to_f64()).sum::<f64>();
                    (0..3).for_each(|c| out[c] = T::from_f64(gradient[c] * alpha * before));
                    out[3] = T::from_f64(before * (of_weight - behind));
                    behind = of_weight * alpha + (1.0 - alpha + LEAK) * behind;
                }
            }
        });
        out
    }
}

impl CustomOp1 for AlphaOver {
    fn name(&self) -> &'static str {
        "alpha-over"
    }

    fn cpu_fwd(&self, planes: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let (rays, count, _) = layout.shape().dims3()?;
        let out = match planes {
            CpuStorage::F64(_) => CpuStorage::F64(AlphaOver::forward(slice(planes, layout)?, count)),
            _ => CpuStorage::F32(AlphaOver::forward(slice(planes, layout)?, count)),
        };
        Ok((out, Shape::from((rays, CHANNELS))))
    }

    fn bwd(&self, planes: &Tensor, _out: &Tensor, gradient: &Tensor) -> Result<Option<Tensor>> {
        let (shape, device) = (planes.dims3()?, planes.device());
        let gradient = gradient.contiguous()?;
        let (from, gradient) = (Values::of(planes), Values::of(&gradient));
        Ok(Some(match planes.dtype() {
            DType::F64 => {
                Tensor::from_vec(AlphaOver::backward::<f64>(from.slice()?, gradient.slice()?, shape.1), shape, device)?
            }
            _ => {
                Tensor::from_vec(AlphaOver::backward::<f32>(from.slice()?, gradient.slice()?, shape.1), shape, device)?
            }
        }))
    }
}

#[cfg(test)]
mod tests;
