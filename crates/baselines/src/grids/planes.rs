//! Images on planes: the values of many parallel planes along rays, interpolated between four pixels.
//!
//! A plane is an image. Values are bilinear between pixels, and 0 outside of the image. They fade over one pixel beyond
//! its edge, as with TensorFlow's resampler (the code of LLFF, Mildenhall et al. 2019).

use candle_core::{Result, Tensor};

/// The intersections of rays with planes: column and row in pixels for each ray and plane, `[rays, planes]`. (0, 0) is
/// the centre of the first pixel. NaN if a ray does not meet the plane.
#[derive(Clone, Debug, Default)]
pub struct Locations {
    /// Number of planes.
    pub planes: usize,
    /// Rows of planes, one per ray.
    pub of_rays: Vec<[f64; 2]>,
}

impl Locations {
    /// Returns the number of rays.
    pub fn rays(&self) -> usize {
        self.of_rays.len().checked_div(self.planes).unwrap_or(0)
    }
}

/// A pixel of an image by its number, and its weight among four.
pub type Corner = (usize, f64);

/// Returns the four pixels around a location in an image of `width` x `height`, with their weights. The weight of a
/// pixel outside is 0, and all are 0 if the location is NaN.
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

/// Returns the values of `planes [planes, height, width, channels]` along rays: `[rays, planes, channels]`, with a
/// gradient of `planes`: the sum over four corners.
pub fn plane_sample(planes: &Tensor, places: &Locations) -> Result<Tensor> {
    let (count, height, width, channels) = planes.dims4()?;
    let pixels = planes.reshape((count * height * width, channels))?;
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

#[cfg(test)]
mod tests;
