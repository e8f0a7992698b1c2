//! Lattices twice as fine: every cell becomes eight.

use candle_core::{CpuStorage, CustomOp1, DType, Layout, Result, Shape, Tensor, WithDType};
use rayon::prelude::*;

use super::values::{Values, slice};

/// `[z, y, x, channels]` to `[2 z, 2 y, 2 x, channels]` by the nearest cell; f32 or f64 on a processor. candle's own forgets all
/// but one consumer's gradient where its input has several.
///
/// # Errors
/// Another shape; those of candle.
pub fn upsample(x: &Tensor) -> Result<Tensor> {
    x.dims4()?;
    x.contiguous()?.apply_op1(Upsample)
}

struct Upsample;

/// Rows of cells along x: for each of the finer lattice, the coarse one that it is made of.
fn coarse_row(fine: usize, height: usize) -> usize {
    let (z, y) = (fine / (2 * height), fine % (2 * height));
    z / 2 * height + y / 2
}

impl Upsample {
    fn forward<T: WithDType>(x: &[T], (_, height, width, channels): (usize, usize, usize, usize)) -> Vec<T> {
        let row = width * channels;
        let mut out = vec![T::from_f64(0.0); 8 * x.len()];
        out.par_chunks_mut(2 * row).enumerate().for_each(|(fine, out)| {
            let x = &x[coarse_row(fine, height) * row..][..row];
            for (out, x) in out.chunks_exact_mut(2 * channels).zip(x.chunks_exact(channels)) {
                let (left, right) = out.split_at_mut(channels);
                left.copy_from_slice(x);
                right.copy_from_slice(x);
            }
        });
        out
    }

    fn backward<T: WithDType>(pull: &[T], (_, height, width, channels): (usize, usize, usize, usize)) -> Vec<T> {
        let row = width * channels;
        let mut out = vec![T::from_f64(0.0); pull.len() / 8];
        out.par_chunks_mut(row).enumerate().for_each(|(coarse, out)| {
            let (z, y) = (coarse / height, coarse % height);
            for fine in [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(dz, dy)| (2 * z + dz) * 2 * height + 2 * y + dy) {
                let pull = &pull[fine * 2 * row..][..2 * row];
                for (out, pull) in out.chunks_exact_mut(channels).zip(pull.chunks_exact(2 * channels)) {
                    let (left, right) = pull.split_at(channels);
                    out.iter_mut().zip(left.iter().zip(right)).for_each(|(sum, (l, r))| *sum += *l + *r);
                }
            }
        });
        out
    }
}

impl CustomOp1 for Upsample {
    fn name(&self) -> &'static str {
        "upsample"
    }

    fn cpu_fwd(&self, x: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let dims = layout.shape().dims4()?;
        let out = match x {
            CpuStorage::F64(_) => CpuStorage::F64(Upsample::forward(slice(x, layout)?, dims)),
            _ => CpuStorage::F32(Upsample::forward(slice(x, layout)?, dims)),
        };
        let (depth, height, width, channels) = dims;
        Ok((out, Shape::from((2 * depth, 2 * height, 2 * width, channels))))
    }

    fn bwd(&self, x: &Tensor, _out: &Tensor, pull: &Tensor) -> Result<Option<Tensor>> {
        let (dims, pull) = (x.dims4()?, pull.contiguous()?);
        let values = Values::of(&pull);
        Ok(Some(match pull.dtype() {
            DType::F64 => Tensor::from_vec(Upsample::backward::<f64>(values.slice()?, dims), dims, x.device())?,
            _ => Tensor::from_vec(Upsample::backward::<f32>(values.slice()?, dims), dims, x.device())?,
        }))
    }
}

#[cfg(test)]
mod tests;
