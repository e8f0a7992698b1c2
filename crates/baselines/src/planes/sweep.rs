//! Plane-sweep volumes: the views around a camera, projected onto each of its planes.

use candle_core::{DType, Device, Tensor, WithDType};
use rayon::prelude::*;

use crate::base::{Image, Result};
use crate::grids::planes::corners;

use super::geometry::{Homography, Viewpoint};

/// A part of a view's pixels that the network processes at once. Its sides are multiples of 8, and may reach beyond the
/// view, where the view's edge is repeated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// First column.
    pub left: usize,
    /// First row.
    pub top: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Window {
    /// Returns the window of a complete view.
    pub fn whole(width: usize, height: usize) -> Window {
        Window { left: 0, top: 0, width: padded(width), height: padded(height) }
    }

    /// Returns whether the pixel is in it.
    pub fn holds(&self, [column, row]: [f64; 2]) -> bool {
        let within = |at: f64, first: usize, size: usize| at >= first as f64 && at <= (first + size - 1) as f64;
        within(column, self.left, self.width) && within(row, self.top, self.height)
    }
}

/// Length of the cells of the network's coarsest grid.
pub const COARSEST: usize = 8;

/// Returns the next multiple of [`COARSEST`].
pub fn padded(size: usize) -> usize {
    size.next_multiple_of(COARSEST)
}

/// Projects each of `seen` (camera and image) onto the planes of `own` at `depths`, in `window`:
/// `[planes, height, width, 3 views]`, channel 3 v + c.
pub fn sweep(
    own: &Viewpoint,
    seen: &[(&Viewpoint, &Image)],
    depths: &[f64],
    window: Window,
    dtype: DType,
    device: &Device,
) -> Result<Tensor> {
    let shape = (depths.len(), window.height, window.width, 3 * seen.len());
    Ok(match dtype {
        DType::F64 => Tensor::from_vec(values::<f64>(own, seen, depths, window), shape, device)?,
        _ => Tensor::from_vec(values::<f32>(own, seen, depths, window), shape, device)?,
    })
}

fn values<T: WithDType>(own: &Viewpoint, seen: &[(&Viewpoint, &Image)], depths: &[f64], window: Window) -> Vec<T> {
    let channels = 3 * seen.len();
    let mut out = vec![T::from_f64(0.0); depths.len() * window.height * window.width * channels];
    // Beyond the view its edge is repeated.
    let columns: Vec<f64> =
        (window.left..window.left + window.width).map(|x| x.min(own.camera.width - 1) as f64).collect();
    out.par_chunks_mut(window.width * channels).enumerate().for_each(|(i, out)| {
        let (k, row) = (i / window.height, window.top + i % window.height);
        let row = row.min(own.camera.height - 1) as f64;
        for (v, (eye, image)) in seen.iter().enumerate() {
            let homography = Homography::new(own, eye, depths[k]);
            for (column, out) in columns.iter().zip(out.chunks_exact_mut(channels)) {
                let mut colour = [0f64; 3];
                for (pixel, share) in corners(homography.pixel(*column, row), image.width, image.height) {
                    let pixel = &image.pixels[3 * pixel..][..3];
                    (0..3).for_each(|c| colour[c] += share * f64::from(pixel[c]));
                }
                (0..3).for_each(|c| out[3 * v + c] = T::from_f64(colour[c]));
            }
        }
    });
    out
}
