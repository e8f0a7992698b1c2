//! How much of what a camera sees a level set shows.

use candle_core::{DType, Tensor};
use serde::Serialize;

use crate::base::Result;
use crate::data::{Camera, RayBuffer, RayParts, Scene};
use crate::field::Density;
use crate::mesh::resized;
use crate::settings::PixelOrigin;
use crate::space::{Lattice, over_queries};

/// Largest number of columns of the view.
const COLUMNS: usize = 96;
/// Points along a ray.
const POINTS: usize = 256;
/// Optical depth from which a pixel is solid: half of its light stops.
const SOLID: f64 = std::f64::consts::LN_2;
/// Fraction of the solid pixels that a surface should cover.
const MOST: f64 = 0.9;

/// What the surface shows of the first held-out view.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Coverage {
    /// The view's name.
    pub view: String,
    /// Fraction of the solid pixels whose rays reach the surface's density within its box.
    pub covered: f64,
    /// The density that nine of ten solid pixels reach, if the surface covers fewer. `None` if the box is what hides them.
    pub better_threshold: Option<f64>,
}

impl Coverage {
    /// Measures the coverage of the level set of `density` at `threshold`. `None` without a solid pixel.
    pub fn of(density: &dyn Density, scene: &Scene, lattice: &Lattice, threshold: f64) -> Result<Option<Coverage>> {
        let Some(view) = scene.test.first() else { return Ok(None) };
        let rays = rays(&view.camera, scene);
        let span = |ray: usize| (&rays.origins[3 * ray..3 * ray + 3], &rays.directions[3 * ray..3 * ray + 3]);
        let all: Vec<usize> = (0..rays.len()).collect();
        let peaks = over_queries(density, &all, POINTS, |part| {
            let spans: Vec<_> = part.iter().map(|&ray| span(ray)).collect();
            peaks(density, &spans, scene.bounds(), lattice)
        })?;
        let peaks: Vec<f64> = peaks.into_iter().flatten().flatten().collect();
        Ok(Coverage::of_peaks(view.name.clone(), peaks, threshold))
    }

    /// `peaks` has the largest density of each solid pixel's ray within the box.
    fn of_peaks(view: String, mut peaks: Vec<f64>, threshold: f64) -> Option<Coverage> {
        if peaks.is_empty() {
            return None;
        }
        peaks.sort_by(|a, b| b.total_cmp(a));
        let covered = peaks.partition_point(|peak| *peak >= threshold) as f64 / peaks.len() as f64;
        let reached = peaks[((MOST * peaks.len() as f64).ceil() as usize).clamp(1, peaks.len()) - 1];
        let better_threshold = (covered < MOST && reached > 0.0).then_some(reached);
        Some(Coverage { view, covered, better_threshold })
    }
}

/// Origin and direction of a ray.
type Ray<'a> = (&'a [f32], &'a [f32]);

/// Returns rays through a small copy of a view.
fn rays(camera: &Camera, scene: &Scene) -> RayBuffer {
    let width = camera.width.min(COLUMNS);
    let height = (camera.height as f64 * width as f64 / camera.width as f64).round().max(1.0) as usize;
    let small = resized(camera, width, height);
    let pixels: Vec<(&Camera, u32, u32)> =
        (0..height as u32).flat_map(|y| (0..width as u32).map(move |x| (x, y))).map(|(x, y)| (&small, x, y)).collect();
    RayBuffer::new(&pixels, scene.ndc.as_ref(), PixelOrigin::Centre, RayParts::default())
}

/// Returns the largest density within the lattice's box on each ray `(origin, direction)`; `None` for rays that are not
/// solid.
fn peaks(density: &dyn Density, rays: &[Ray], (near, far): (f64, f64), lattice: &Lattice) -> Result<Vec<Option<f64>>> {
    let interval = (far - near) / POINTS as f64;
    let along = |(origin, direction): &Ray, k: usize| -> [f32; 3] {
        let t = near + (k as f64 + 0.5) * interval;
        std::array::from_fn(|axis| (f64::from(origin[axis]) + t * f64::from(direction[axis])) as f32)
    };
    let points: Vec<[f32; 3]> = rays.iter().flat_map(|ray| (0..POINTS).map(move |k| along(ray, k))).collect();
    let tensor = Tensor::from_vec(points.iter().flatten().copied().collect(), (points.len(), 3), density.device())?;
    let tensor = tensor.to_dtype(density.dtype())?;
    let values = density.density(&tensor, lattice.cell_variance())?.to_dtype(DType::F32)?.to_vec1::<f32>()?;
    let inside = |point: &[f32; 3]| {
        let [lower, upper] = lattice.domain;
        (0..3).all(|axis| (lower[axis]..=upper[axis]).contains(&f64::from(point[axis])))
    };
    let of_ray = |((values, points), (_, direction)): ((&[f32], &[[f32; 3]]), &Ray)| {
        let length = direction.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
        let depth = values.iter().map(|value| f64::from(*value)).sum::<f64>() * interval * length;
        let peak = values.iter().zip(points).filter(|(_, point)| inside(point)).map(|(value, _)| f64::from(*value));
        (depth >= SOLID).then(|| peak.fold(0.0, f64::max))
    };
    Ok(values.chunks_exact(POINTS).zip(points.chunks_exact(POINTS)).zip(rays).map(of_ray).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_threshold_is_named_that_nine_of_ten_solid_pixels_reach() {
        let peaks: Vec<f64> = (1..=20).map(f64::from).collect();
        let of = |threshold| Coverage::of_peaks("a".into(), peaks.clone(), threshold).unwrap();
        assert_eq!((of(11.0).covered, of(11.0).better_threshold), (0.5, Some(3.0)));
        assert_eq!((of(3.0).covered, of(3.0).better_threshold), (0.9, None));
        assert_eq!(Coverage::of_peaks("a".into(), vec![0.0; 4], 1.0).unwrap().better_threshold, None);
        assert_eq!(Coverage::of_peaks("a".into(), Vec::new(), 1.0), None);
    }
}
