//! A hash grid by candle's operations: the table is a parameter, and points and table are in candle's graph. candle has no
//! integers to hash with, so the entries of corners are looked up on the host.

use std::sync::Arc;

use candle_core::{D, DType, Device, Result, Tensor};
use candle_nn::{Init, VarBuilder};

use super::inside::Inside;
use super::spatial::Order;
use crate::base::tensors::with_values;
use crate::field::settings::{Contraction, Encoding, FieldConfig, Interpolation};
use augnerf_fast::hash::{Domain, HashGrid};

/// Initial entries of a table are uniform within +- this (Mueller et al. 2022, section 4).
const INITIAL: f64 = 1e-4;

/// A hash grid with its table.
#[derive(Clone)]
pub(super) struct Grid {
    pub(super) shape: Arc<HashGrid>,
    pub(super) domain: Domain,
    /// `[entries, features]`.
    pub(super) table: Tensor,
}

impl Grid {
    /// Creates the grid of a configuration with the builder's `table`, `[entries, features]`. `None` without a grid.
    ///
    /// # Errors
    /// Those of the builder.
    pub(super) fn new(config: &FieldConfig, builder: &VarBuilder) -> Result<Option<Grid>> {
        if config.encoding != Encoding::Hash {
            return Ok(None);
        }
        let (shape, domain) = config.hash.grid();
        let init = Init::Uniform { lo: -INITIAL, up: INITIAL };
        let table = builder.get_with_hints((shape.entries(), shape.features()), "table", init)?;
        Ok(Some(Grid { shape: Arc::new(shape), domain, table }))
    }

    /// Returns the same table as a constant.
    pub(super) fn detached(&self) -> Grid {
        Grid { table: self.table.detach(), ..self.clone() }
    }

    /// Returns features `[n, channels]` at points `[n, 3]`.
    pub(super) fn encode(&self, points: &Tensor) -> Result<Tensor> {
        let unit = match self.inside(points)? {
            None => self.to_unit_cube(points)?,
            Some(inside) => {
                // A point outside has no gradient along any axis.
                let inside = inside.mask(points)?.unsqueeze(1)?;
                let (free, fixed) =
                    (points.broadcast_mul(&inside)?, points.detach().broadcast_mul(&inside.affine(-1.0, 1.0)?)?);
                self.to_unit_cube(&(free + fixed)?)?
            }
        };
        let (n, device, dtype) = (unit.dim(0)?, points.device(), points.dtype());
        let levels = self.shape.levels();
        let cells: Vec<f32> = levels.iter().map(|level| level.resolution as f32).collect();
        let cells = Tensor::from_vec(cells, (1, levels.len(), 1), device)?.to_dtype(dtype)?;
        let scaled = unit.unsqueeze(1)?.broadcast_mul(&cells)?; // [n, levels, 3]
        let (lower, entries) = self.corners(&scaled.detach())?;
        let lower = Tensor::from_vec(lower, scaled.shape(), device)?.to_dtype(dtype)?;
        let fraction = (scaled - lower)?;
        let upper = match self.shape.interpolation() {
            Interpolation::Linear => fraction,
            Interpolation::Smoothstep => (fraction.sqr()? * fraction.affine(-2.0, 3.0)?)?,
        };
        let weights = Tensor::stack(&[upper.affine(-1.0, 1.0)?, upper], 3)?; // [n, levels, axis, lower and upper]
        let along = |axis: usize| weights.narrow(2, axis, 1)?.squeeze(2);
        let (x, y, z) = (along(0)?, along(1)?, along(2)?);
        let square = y.unsqueeze(3)?.broadcast_mul(&x.unsqueeze(2)?)?.flatten_from(2)?; // [n, levels, 4], x fastest
        let weights = z.unsqueeze(3)?.broadcast_mul(&square.unsqueeze(2)?)?.flatten_from(2)?; // [n, levels, 8]
        let entries = Tensor::from_vec(entries, n * levels.len() * 8, device)?;
        let features = self.table.index_select(&entries, 0)?;
        let features = features.reshape((n, levels.len(), 8, self.shape.features()))?;
        features.broadcast_mul(&weights.unsqueeze(3)?)?.sum(2)?.flatten_from(1)
    }

    /// Returns the positions of points in the unit cube.
    fn to_unit_cube(&self, points: &Tensor) -> Result<Tensor> {
        let (low, high) = self.domain.corners();
        let row = |values: [f64; 3]| Tensor::new(&[values], points.device())?.to_dtype(points.dtype());
        let unit = points.broadcast_sub(&row(low)?)?.broadcast_div(&row(std::array::from_fn(|i| high[i] - low[i]))?)?;
        let y = unit.affine(2.0, -1.0)?;
        let size = match self.domain.contraction() {
            Contraction::None => return unit.maximum(0.0)?.minimum(1.0),
            Contraction::Axes => y.abs()?.maximum(1.0)?,
            Contraction::Ball => y.sqr()?.sum_keepdim(D::Minus1)?.maximum(1.0)?.sqrt()?,
        };
        // y (2 - 1 / size) / size, which is y itself where the size is 1.
        let factor = (size.recip()?.affine(-1.0, 2.0)? / &size)?;
        y.broadcast_mul(&factor)?.affine(0.25, 0.5)
    }

    /// Returns the lower corner of the cells of `scaled [n, levels, 3]`, and the entries of their eight corners.
    fn corners(&self, scaled: &Tensor) -> Result<(Vec<f64>, Vec<u32>)> {
        let scaled = scaled.to_device(&Device::Cpu)?.to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>()?;
        let levels = self.shape.levels();
        let mut lower = Vec::with_capacity(scaled.len());
        let mut entries = Vec::with_capacity(scaled.len() / 3 * 8);
        for (i, position) in scaled.as_chunks::<3>().0.iter().enumerate() {
            let level = &levels[i % levels.len()];
            let last = f64::from(level.resolution - 1);
            // A position that is NaN is in the first cell, where its weights are NaN.
            let cell = position.map(|x| x.floor().max(0.0).min(last));
            lower.extend(cell);
            let entry = |k: u32| {
                let corner = [k & 1, k >> 1 & 1, k >> 2];
                (level.offset + level.entry(std::array::from_fn(|axis| cell[axis] as u32 + corner[axis]))) as u32
            };
            entries.extend((0..8).map(entry));
        }
        Ok((lower, entries))
    }

    /// Returns which of points `[n, 3]` are in the box. `None` if the grid covers all of space, or all points are
    /// inside.
    pub(super) fn are_inside(&self, points: &Tensor) -> Result<Option<Vec<bool>>> {
        if self.domain.contraction() != Contraction::None {
            return Ok(None);
        }
        let points = points.detach().contiguous()?;
        let inside = match with_values(&points, |points| self.domain.inside(points)) {
            Some(inside) => inside,
            None => self.domain.inside(&points.to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>()?),
        };
        Ok(inside.iter().any(|inside| !inside).then_some(inside))
    }

    /// Returns the same for later results at these points.
    pub(super) fn inside(&self, points: &Tensor) -> Result<Option<Inside>> {
        Ok(self.are_inside(points)?.map(Inside::new))
    }

    /// Returns the encoding of points `[n, 3]`, its derivative along each axis and its Laplacian, up to `order`, each
    /// `[n, channels]`. The table is in the graph, and the points are constants.
    pub(super) fn derivatives(&self, points: &Tensor, order: Order) -> Result<Vec<Tensor>> {
        let scene = points.detach().to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>()?;
        let mut unit = vec![0.0; scene.len()];
        self.domain.map(&scene, &mut unit, &mut vec![false; scene.len() / 3]);
        let vertices = self.shape.corners(&unit);
        let (n, levels, device) = (scene.len() / 3, self.shape.levels().len(), points.device());
        let entries: Vec<u32> = vertices.iter().map(|vertex| vertex.entry as u32).collect();
        let features = self.table.index_select(&Tensor::from_vec(entries, vertices.len(), device)?, 0)?;
        let features = features.reshape((n, levels, 8, self.shape.features()))?;
        let derivative = |(value, gradient, laplacian): (f64, [f64; 3], f64)| {
            let points = scene.as_chunks::<3>().0.iter().zip(vertices.chunks(levels * 8));
            let weights = points.flat_map(|(point, vertices)| {
                let operator = self.domain.operator(*point, value, gradient, laplacian);
                vertices.iter().map(move |vertex| vertex.operated(Some(&operator)))
            });
            let weights = Tensor::from_vec(weights.collect::<Vec<f64>>(), (n, levels, 8, 1), device)?;
            features.broadcast_mul(&weights.to_dtype(features.dtype())?)?.sum(2)?.flatten_from(1)
        };
        let along = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| (0.0, axis, 0.0));
        let operators = [&[(1.0, [0.0; 3], 0.0)], &along[..], &[(0.0, [0.0; 3], 1.0)]].concat();
        operators.into_iter().take(1 + order.derivatives()).map(derivative).collect()
    }
}
