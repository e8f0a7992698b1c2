//! The box over which regularizers integrate, divided into cells.

use candle_core::{DType, Device, Tensor};

use crate::base::rng::{Random, Stream};
use crate::base::{Error, Result};
use crate::data::settings::PixelOrigin;
use crate::data::{Camera, RayBuffer, RayParts, Scene};

/// A box divided into `side`^3 equal cells, numbered with z fastest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    /// Lower and upper corner, in the units of `points`.
    pub domain: [[f64; 3]; 2],
    /// Cells along each side (N).
    pub side: usize,
}

impl Lattice {
    /// Returns the number of cells.
    pub fn cells(&self) -> usize {
        self.side.pow(3)
    }

    /// Returns the volume of the box, length^3.
    pub fn volume(&self) -> f64 {
        let [lower, upper] = self.domain;
        lower.iter().zip(upper).map(|(a, b)| b - a).product()
    }

    /// Returns the variance of a uniform point in a cell, along each axis, length^2.
    pub fn cell_variance(&self) -> [f64; 3] {
        let [lower, upper] = self.domain;
        std::array::from_fn(|axis| ((upper[axis] - lower[axis]) / self.side as f64).powi(2) / 12.0)
    }

    /// Returns the point of cell `cell` at `offset`, 0..1 along each axis; 0.5 is the midpoint.
    pub fn point(&self, cell: usize, offset: [f64; 3]) -> [f64; 3] {
        let index = [cell / (self.side * self.side), cell / self.side % self.side, cell % self.side];
        let [lower, upper] = self.domain;
        std::array::from_fn(|axis| {
            let share = (index[axis] as f64 + offset[axis]) / self.side as f64;
            lower[axis] + share * (upper[axis] - lower[axis])
        })
    }

    /// Returns the box, `[lower, upper]`, around the rays of a scene's training views between its bounds. The corner
    /// rays stand for all.
    pub fn seen(scene: &Scene) -> [[f64; 3]; 2] {
        let corners = |camera: &'_ Camera| {
            let (right, bottom) = (camera.width as u32 - 1, camera.height as u32 - 1);
            [(0, 0), (right, 0), (0, bottom), (right, bottom)]
        };
        let pixels: Vec<(&Camera, u32, u32)> =
            scene.train.iter().flat_map(|view| corners(&view.camera).map(|(x, y)| (&view.camera, x, y))).collect();
        let rays = RayBuffer::new(&pixels, scene.ndc.as_ref(), PixelOrigin::Corner, RayParts::default());
        let mut seen = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
        for (origin, direction) in rays.origins.chunks_exact(3).zip(rays.directions.chunks_exact(3)) {
            for t in [scene.near, scene.far] {
                for axis in 0..3 {
                    let x = f64::from(origin[axis]) + t * f64::from(direction[axis]);
                    seen[0][axis] = seen[0][axis].min(x);
                    seen[1][axis] = seen[1][axis].max(x);
                }
            }
        }
        seen
    }

    /// Returns an error unless the box, which `field` names, meets the scene's rays.
    pub fn check_meets(&self, scene: &Scene, field: &str) -> Result<()> {
        let seen = Lattice::seen(scene);
        let meets = (0..3).all(|axis| self.domain[0][axis] < seen[1][axis] && seen[0][axis] < self.domain[1][axis]);
        if meets {
            return Ok(());
        }
        let text = |[x, y, z]: [f64; 3]| format!("[{x:.3}, {y:.3}, {z:.3}]");
        Err(Error::Config(format!(
            "{field}: the box from {} to {} is outside of {}, whose training rays run from {} to {}; choose a box within",
            text(self.domain[0]),
            text(self.domain[1]),
            scene.name,
            text(seen[0]),
            text(seen[1])
        )))
    }
}

/// Points of equal weight for the integral over a box. The integral of f is [`Quadrature::volume_each`] times the sum
/// of f over the points.
pub struct Quadrature {
    lattice: Lattice,
    /// Cells with the offset of the point in each. `None` for the midpoint of every cell.
    sampled: Option<Vec<(u32, [f64; 3])>>,
}

impl Quadrature {
    /// Returns the midpoint of every cell: the paper's sum.
    pub fn full(lattice: Lattice) -> Quadrature {
        Quadrature { lattice, sampled: None }
    }

    /// Returns one point in each of `count` cells, a function of `seed` and `step`: anywhere in the cell, or without `jitter` in
    /// its middle.
    pub fn draw(lattice: Lattice, count: usize, jitter: bool, seed: u64, step: u64) -> Quadrature {
        let mut random = Random::new(seed, Stream::Regularizer, step);
        let cells = random.distinct(count, lattice.cells() as u32);
        let mut offset = |_| if jitter { random.uniform() } else { 0.5 };
        let sampled = cells.into_iter().map(|cell| (cell, std::array::from_fn(&mut offset))).collect();
        Quadrature { lattice, sampled: Some(sampled) }
    }

    /// Returns the number of points.
    pub fn count(&self) -> usize {
        self.sampled.as_ref().map_or_else(|| self.lattice.cells(), Vec::len)
    }

    /// Returns the volume that each point stands for, length^3.
    pub fn volume_each(&self) -> f64 {
        self.lattice.volume() / self.count() as f64
    }

    /// Returns points `start..start + count` as `[count, 3]`.
    pub fn tensor(&self, start: usize, count: usize, dtype: DType, device: &Device) -> Result<Tensor> {
        let at = |i: usize| match &self.sampled {
            None => self.lattice.point(i, [0.5; 3]),
            Some(points) => self.lattice.point(points[i].0 as usize, points[i].1),
        };
        let values: Vec<f64> = (start..start + count).flat_map(at).collect();
        Ok(Tensor::from_vec(values, (count, 3), &Device::Cpu)?.to_dtype(dtype)?.to_device(device)?)
    }
}
