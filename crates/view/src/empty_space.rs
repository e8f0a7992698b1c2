//! Where a field has no density: a grid over the space that its cameras see.

use candle_core::{DType, Tensor};

use crate::base::Result;
use crate::base::rng::{Random, Stream};
use crate::data::{RayBuffer, Scene};
use crate::field::Field;
use crate::render::{points_at, ray_parts};
use crate::runtime::Runtime;
use crate::settings::{Config, Contraction, Encoding, FieldConfig, Spacing};

/// Cells along an axis, for a hash grid and for networks, whose densities take longer.
const CELLS: [usize; 2] = [128, 64];
/// Points in each cell at which density is computed.
const POINTS: usize = 2;
/// Cells whose densities are computed at once.
const CHUNK: usize = 1 << 12;

/// A grid whose cells are empty or not.
pub struct EmptySpace {
    /// Whether points outside the grid may have density.
    is_open: bool,
    lower: [f32; 3],
    /// Cells per unit of length, for each axis.
    scale: [f32; 3],
    side: usize,
    /// The greatest density found in each cell, 1 / unit of space.
    densities: Vec<f32>,
    /// Length of an interval of the coarse pass in units of space.
    interval: f64,
    /// Whether each cell, or one of its 26 neighbours, has density enough.
    occupied: Vec<bool>,
}

impl EmptySpace {
    /// Makes the grid of a field, over the box of its hash grid, which ends there, or over the box around all samples of the
    /// training views' outermost rays. Returns `None` for a
    /// field that reads Gaussians (MipNeRF), whose density depends on their size, for a contracted grid, whose space has no end,
    /// and for samples that are not even in depth. `pause` is called on the calling thread before each part of the work.
    ///
    /// # Errors
    /// Those of candle and of `pause`.
    pub fn of(
        field: &Field,
        config: &Config,
        scene: &Scene,
        runtime: &Runtime,
        pause: &mut dyn FnMut() -> Result<()>,
    ) -> Result<Option<EmptySpace>> {
        let FieldConfig { encoding, hash, .. } = field.config();
        let contracts = *encoding == Encoding::Hash && hash.contraction != Some(Contraction::None);
        if encoding.queries_gaussians() || contracts || config.sampling.spacing != Spacing::Depth {
            return Ok(None);
        }
        let (sampled, direction_norm) = sampled_box(field, config, scene)?;
        let own = own_box(field);
        let [lower, upper] = own.unwrap_or(sampled);
        let side = CELLS[usize::from(field.hash_grid().is_none())];
        let size = |axis: usize| (upper[axis] - lower[axis]) / side as f32;
        // Every interval of the coarse pass is this long, in units of space.
        let (near, far) = scene.bounds();
        let interval = (far - near) / config.sampling.coarse as f64 * direction_norm;
        let point = |cell: usize, random: &mut Random| -> [f32; 3] {
            let at = [cell / (side * side), cell / side % side, cell % side];
            std::array::from_fn(|axis| lower[axis] + (at[axis] as f32 + random.uniform() as f32) * size(axis))
        };
        let cells: Vec<usize> = (0..side * side * side).collect();
        let densities_of = |cells: &[usize]| {
            let mut random = Random::new(config.seed, Stream::View, cells[0] as u64);
            let points: Vec<f32> = cells
                .iter()
                .flat_map(|&cell| (0..POINTS).flat_map(|_| point(cell, &mut random)).collect::<Vec<f32>>())
                .collect();
            let points =
                Tensor::from_vec(points, (cells.len() * POINTS, 3), field.device())?.to_dtype(field.dtype())?;
            let density =
                field.activate_density(&field.raw_density(&points)?)?.to_dtype(DType::F32)?.to_vec1::<f32>()?;
            let most = |of_cell: &[f32]| {
                of_cell
                    .iter()
                    .fold(0.0, |most: f32, &density| if density > most || density.is_nan() { density } else { most })
            };
            Ok(density.chunks(POINTS).map(most).collect::<Vec<f32>>())
        };
        let mut densities = Vec::with_capacity(cells.len());
        for cells in cells.chunks(CHUNK * runtime.threads()) {
            pause()?;
            let parts = runtime.install(|| runtime.over_parts(cells, CHUNK, densities_of))?;
            densities.extend(parts.into_iter().flatten());
        }
        let scale = std::array::from_fn(|axis| 1.0 / size(axis));
        Ok(Some(EmptySpace {
            is_open: own.is_none(),
            lower,
            scale,
            side,
            occupied: vec![true; densities.len()],
            densities,
            interval,
        }))
    }

    /// Counts cells as empty, with all of their neighbours, in which an interval of the coarse pass stops less than
    /// `least_alpha` of the light.
    pub fn set_least_alpha(&mut self, least_alpha: f64) {
        let least = (-(1.0 - least_alpha).ln() / self.interval) as f32;
        let dense: Vec<bool> = self.densities.iter().map(|density| density.is_nan() || *density >= least).collect();
        self.occupied = with_neighbours(&dense, self.side);
    }

    /// Returns whether a point may have density.
    pub fn is_occupied(&self, point: &[f32]) -> bool {
        let mut cell = 0;
        for ((&place, lower), scale) in point.iter().zip(&self.lower).zip(&self.scale) {
            let at = (place - lower) * scale;
            // NaN is outside, too, but is to be seen.
            if !(at >= 0.0 && at <= self.side as f32) {
                return self.is_open || at.is_nan();
            }
            cell = cell * self.side + (at as usize).min(self.side - 1);
        }
        self.occupied[cell]
    }

    /// Returns the fraction of the box that is not empty, 0..=1.
    pub fn share(&self) -> f64 {
        self.occupied.iter().filter(|occupied| **occupied).count() as f64 / self.occupied.len() as f64
    }
}

/// Marks cells with a marked neighbour, along one axis after the other.
fn with_neighbours(dense: &[bool], side: usize) -> Vec<bool> {
    let mut found = dense.to_vec();
    for stride in [1, side, side * side] {
        let before = found.clone();
        for (cell, found) in found.iter_mut().enumerate() {
            let at = cell / stride % side;
            *found |= at > 0 && before[cell - stride] || at + 1 < side && before[cell + stride];
        }
    }
    found
}

/// Returns the corners of the box outside of which a field has no density, if it has one.
fn own_box(field: &Field) -> Option<[[f32; 3]; 2]> {
    let hash = &field.config().hash;
    let ends = field.hash_grid().is_some() && hash.contraction == Some(Contraction::None);
    hash.bounds.filter(|_| ends).map(|bounds| bounds.map(|corner| corner.map(|value| value as f32)))
}

/// Returns the corners of the box around the samples of the rays through the training views' corners and middles, and the
/// greatest length of their directions.
fn sampled_box(field: &Field, config: &Config, scene: &Scene) -> Result<([[f32; 3]; 2], f64)> {
    let mut pixels = Vec::new();
    for view in &scene.train {
        let (right, bottom) = (view.camera.width as u32 - 1, view.camera.height as u32 - 1);
        let columns = [0, right / 2, right];
        pixels.extend([0, bottom / 2, bottom].iter().flat_map(|&y| columns.map(|x| (&view.camera, x, y))));
    }
    let origin = config.data.origin_of_pixels();
    let rays =
        RayBuffer::new(&pixels, scene.ndc.as_ref(), origin, ray_parts(field)).to_tensors(DType::F32, field.device())?;
    let (near, far) = scene.bounds();
    let ends =
        Tensor::new(&[[near as f32, far as f32]], field.device())?.broadcast_as((rays.len(), 2))?.contiguous()?;
    let points = points_at(&rays, &ends)?.flatten_all()?.to_vec1::<f32>()?;
    let (mut lower, mut upper) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for point in points.chunks(3) {
        for axis in 0..3 {
            lower[axis] = lower[axis].min(point[axis]);
            upper[axis] = upper[axis].max(point[axis]);
        }
    }
    let norms = rays.direction_norm.flatten_all()?.to_vec1::<f32>()?;
    let longest = norms.into_iter().fold(0.0, f32::max);
    Ok(([lower, upper], f64::from(longest)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_next_to_density_is_not_empty() {
        let side = 5;
        let mut dense = vec![false; side * side * side];
        dense[2 * 25 + 2 * 5 + 4] = true;
        let found = with_neighbours(&dense, side);
        let near = |a: usize, b: usize| a.abs_diff(b) <= 1;
        for (cell, found) in found.into_iter().enumerate() {
            assert_eq!(found, near(cell / 25, 2) && near(cell / 5 % 5, 2) && near(cell % 5, 4), "{cell}");
        }
    }

    #[test]
    fn points_outside_the_box_may_have_density() {
        let space = |is_open| EmptySpace {
            is_open,
            lower: [-1.0; 3],
            scale: [1.0; 3],
            side: 2,
            densities: vec![],
            interval: 1.0,
            occupied: vec![false; 8],
        };
        assert!(!space(true).is_occupied(&[0.5, -0.5, 0.0]));
        for outside in [[1.5, 0.0, 0.0], [0.0, -1.1, 0.0]] {
            assert!(space(true).is_occupied(&outside) && !space(false).is_occupied(&outside), "{outside:?}");
        }
        assert!(space(false).is_occupied(&[0.0, 0.0, f32::NAN]));
    }
}
