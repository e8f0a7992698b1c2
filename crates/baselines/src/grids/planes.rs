//! Images of planes: what rays meet on each of many parallel planes, between four pixels.
//!
//! A plane is an image. Between pixels values are bilinear; outside of the image everything is 0, so that values fade over one
//! pixel beyond its edge, as TensorFlow's resampler has it (the code of LLFF, Mildenhall et al. 2019).

use std::sync::Arc;

use candle_core::{CpuStorage, CustomOp1, DType, Layout, Result, Shape, Tensor, WithDType};
use rayon::prelude::*;

use super::values::{Values, slice};

/// Rays that one thread works through at once.
const PART: usize = 256;

/// Where rays meet planes: a column and a row in pixels for each ray and plane, `[rays, planes]`; (0, 0) is the middle of the
/// first pixel. Not a number where a ray meets nothing.
#[derive(Clone, Debug, Default)]
pub struct Locations {
    /// Planes of each ray.
    pub planes: usize,
    /// Row after row of planes.
    pub of_rays: Vec<[f64; 2]>,
}

impl Locations {
    /// Rays.
    pub fn rays(&self) -> usize {
        self.of_rays.len().checked_div(self.planes).unwrap_or(0)
    }
}

/// A pixel of an image by its number, and its share of the value between four.
pub type Corner = (usize, f64);

/// The four pixels around a place of an image of `width` times `height`, with their shares; the share of one that is outside, and
/// of all where the place is not a number, is 0.
#[inline(always)]
pub fn corners([column, row]: [f64; 2], width: usize, height: usize) -> [Corner; 4] {
    let inside = column > -1.0 && row > -1.0 && column < width as f64 && row < height as f64;
    if !inside {
        return [(0, 0.0); 4];
    }
    let (left, top) = (column.floor(), row.floor());
    let (right, below) = (column - left, row - top);
    let corner = |x: f64, y: f64, share: f64| {
        let is_pixel = x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64;
        if is_pixel { (y as usize * width + x as usize, share) } else { (0, 0.0) }
    };
    [
        corner(left, top, (1.0 - right) * (1.0 - below)),
        corner(left + 1.0, top, right * (1.0 - below)),
        corner(left, top + 1.0, (1.0 - right) * below),
        corner(left + 1.0, top + 1.0, right * below),
    ]
}

/// What rays meet on `planes [planes, height, width, channels]`: `[rays, planes, channels]`, with a gradient of `planes`. The same
/// bits whatever the number of threads.
///
/// # Errors
/// Locations of another number of planes; those of candle.
pub fn plane_sample(planes: &Tensor, places: Arc<Locations>) -> Result<Tensor> {
    let (count, _, _, _) = planes.dims4()?;
    if count != places.planes || !places.of_rays.len().is_multiple_of(count.max(1)) {
        candle_core::bail!("plane sample: {count} planes and places of {}", places.planes);
    }
    if !planes.device().is_cpu() || !matches!(planes.dtype(), DType::F32 | DType::F64) {
        return plain(planes, &places);
    }
    planes.contiguous()?.apply_op1(PlaneSample { places })
}

/// The same in candle's own operations: the sum over four corners.
fn plain(planes: &Tensor, places: &Locations) -> Result<Tensor> {
    let (count, height, width, channels) = planes.dims4()?;
    let pixels = planes.contiguous()?.reshape((count * height * width, channels))?;
    let corners: Vec<[Corner; 4]> = places.of_rays.iter().map(|place| corners(*place, width, height)).collect();
    let of_corner = |corner: usize| -> Result<Tensor> {
        let pixel = |(i, corners): (usize, &[Corner; 4])| (i % count * height * width + corners[corner].0) as u32;
        let rows: Vec<u32> = corners.iter().enumerate().map(pixel).collect();
        let shares: Vec<f64> = corners.iter().map(|corners| corners[corner].1).collect();
        let rows = Tensor::from_vec(rows, corners.len(), planes.device())?;
        let shares = Tensor::from_vec(shares, (corners.len(), 1), planes.device())?.to_dtype(planes.dtype())?;
        pixels.index_select(&rows, 0)?.broadcast_mul(&shares)
    };
    let sum = (1..4).try_fold(of_corner(0)?, |sum, corner| sum + of_corner(corner)?)?;
    sum.reshape((places.rays(), count, channels))
}

struct PlaneSample {
    places: Arc<Locations>,
}

impl PlaneSample {
    fn forward<T: WithDType>(
        &self,
        planes: &[T],
        (_, height, width, channels): (usize, usize, usize, usize),
    ) -> Vec<T> {
        let (count, size) = (self.places.planes, height * width * channels);
        let mut out = vec![T::from_f64(0.0); self.places.of_rays.len() * channels];
        let parts = out.par_chunks_mut(PART * count * channels).zip(self.places.of_rays.par_chunks(PART * count));
        parts.for_each(|(out, places)| {
            for (i, (place, out)) in places.iter().zip(out.chunks_exact_mut(channels)).enumerate() {
                let plane = &planes[i % count * size..][..size];
                for (pixel, share) in corners(*place, width, height) {
                    let share = T::from_f64(share);
                    let pixel = &plane[pixel * channels..][..channels];
                    out.iter_mut().zip(pixel).for_each(|(out, value)| *out += share * *value);
                }
            }
        });
        out
    }

    /// Each plane is a thread's own, and takes its rays in their order.
    fn backward<T: WithDType>(
        &self,
        cotangent: &[T],
        (_, height, width, channels): (usize, usize, usize, usize),
    ) -> Vec<T> {
        let (count, size) = (self.places.planes, height * width * channels);
        let mut out = vec![T::from_f64(0.0); count * size];
        out.par_chunks_mut(size).enumerate().for_each(|(k, plane)| {
            for (ray, places) in self.places.of_rays.chunks_exact(count).enumerate() {
                let cotangent = &cotangent[(ray * count + k) * channels..][..channels];
                for (pixel, share) in corners(places[k], width, height) {
                    let share = T::from_f64(share);
                    let pixel = &mut plane[pixel * channels..][..channels];
                    pixel.iter_mut().zip(cotangent).for_each(|(sum, cotangent)| *sum += share * *cotangent);
                }
            }
        });
        out
    }
}

impl CustomOp1 for PlaneSample {
    fn name(&self) -> &'static str {
        "plane-sample"
    }

    fn cpu_fwd(&self, planes: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let dims = layout.shape().dims4()?;
        let out = match planes {
            CpuStorage::F64(_) => CpuStorage::F64(self.forward(slice(planes, layout)?, dims)),
            _ => CpuStorage::F32(self.forward(slice(planes, layout)?, dims)),
        };
        Ok((out, Shape::from((self.places.rays(), dims.0, dims.3))))
    }

    fn bwd(&self, planes: &Tensor, _out: &Tensor, cotangent: &Tensor) -> Result<Option<Tensor>> {
        let (dims, cotangent) = (planes.dims4()?, cotangent.contiguous()?);
        let values = Values::of(&cotangent);
        Ok(Some(match cotangent.dtype() {
            DType::F64 => Tensor::from_vec(self.backward::<f64>(values.slice()?, dims), dims, planes.device())?,
            _ => Tensor::from_vec(self.backward::<f32>(values.slice()?, dims), dims, planes.device())?,
        }))
    }
}

#[cfg(test)]
mod tests;
