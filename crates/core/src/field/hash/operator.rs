//! Derivatives of the encoding in space, and the tables' gradients of functions of them.
//!
//! An encoding is linear in the tables. The weight of each vertex is a function of the point, and a derivative of the
//! encoding is the same sum with that function's derivative. One linear differential operator per point is therefore
//! enough. It can be the derivative along an axis of the scene, the Laplacian there, or the sum of a loss's derivatives
//! in each of them.

use super::cell::{BLOCK, Block, Cells, gather_corners, of_part};
use super::simd::{Kernel, LANES, Lanes, Processor, Simd};
use super::{Cotangents, HashGrid, Level, by_features, count_corners};

/// A linear differential operator at a point of the unit cube, of at most second order. It has the coefficients of the
/// value, of the derivatives along x, y, z, of those along xx, yy, zz, and of those along xy, xz, yz.
pub type Operator<T> = [T; 10];

/// The order of each of an operator's derivatives along each axis.
pub const ORDERS: Operator<[usize; 3]> =
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [2, 0, 0], [0, 2, 0], [0, 0, 2], [1, 1, 0], [1, 0, 1], [0, 1, 1]];

impl HashGrid {
    /// Applies `operators [n]` to the encodings of `points [n, 3]`: `out [n, channels]`. The derivatives are the cell's
    /// own. With linear interpolation, first derivatives jump at its faces, and second derivatives along an axis are 0
    /// within it.
    ///
    /// # Panics
    /// If the sizes do not fit.
    pub fn differentiate(&self, tables: &[f32], points: &[f32], operators: &[Operator<f32>], out: &mut [f32]) {
        self.differentiate_on(Processor::here(), tables, (points, operators), out);
    }

    pub(super) fn differentiate_on(
        &self,
        processor: Processor,
        tables: &[f32],
        (points, operators): (&[f32], &[Operator<f32>]),
        out: &mut [f32],
    ) {
        assert_eq!(self.check(tables.len(), points.len(), out.len()), operators.len(), "one operator a point");
        count_corners(out.len());
        by_features!(processor, self.features, W => {
            let (tables, out) = (tables.as_chunks().0, out.as_chunks_mut().0);
            Differentiate::<W> { grid: self, tables, points, operators, out }
        });
    }
}

/// Sizes were checked.
struct Differentiate<'a, const W: usize> {
    grid: &'a HashGrid,
    tables: &'a [[f32; W]],
    points: &'a [f32],
    operators: &'a [Operator<f32>],
    out: &'a mut [[f32; W]],
}

impl<const W: usize> Kernel for Differentiate<'_, W> {
    #[inline(always)]
    fn run(self, simd: impl Simd) {
        let parts = self.grid.parts::<W>();
        let length = self.grid.levels.len() * parts;
        let (mut block, mut operators) = (Block::empty(), Operators::empty());
        let blocks = self.points.chunks(3 * BLOCK).zip(self.operators.chunks(BLOCK));
        for ((points, of_points), out) in blocks.zip(self.out.chunks_mut(length * BLOCK)) {
            block.fill(points);
            operators.fill(of_points);
            for (l, level) in self.grid.levels.iter().enumerate() {
                let table = level.table(self.tables, parts);
                for ((start, count, points), operator) in block.groups().zip(&operators.groups) {
                    let cells = Cells::of(simd, level, points);
                    let entries = cells.corners(simd, level);
                    let weights = weights(simd, self.grid, level, &cells, operator);
                    for part in 0..parts {
                        let corners = gather_corners(simd, level, table, entries, (part, parts));
                        let mut features = [simd.splat(0.0); W];
                        for (corner, weight) in corners.iter().zip(weights) {
                            for (sum, feature) in features.iter_mut().zip(corner) {
                                *sum = simd.mul_add(weight, *feature, *sum);
                            }
                        }
                        let rows = out[start * length..][..count * length].chunks_exact_mut(length);
                        for (row, features) in rows.zip(simd.rows(features)) {
                            row[l * parts + part] = features;
                        }
                    }
                }
            }
        }
    }
}

/// Implements [`HashGrid::scatter`] for a record with operators, with checked sizes.
pub struct Scatter<'a, const W: usize> {
    pub grid: &'a HashGrid,
    pub level: usize,
    pub points: &'a [f32],
    pub operators: &'a [Operator<f32>],
    pub d_out: &'a [[f32; W]],
    pub sum: &'a mut [[f32; W]],
}

impl<const W: usize> Kernel for Scatter<'_, W> {
    #[inline(always)]
    fn run(self, simd: impl Simd) {
        let parts = self.grid.parts::<W>();
        let length = self.grid.levels.len() * parts;
        let level = &self.grid.levels[self.level];
        let (mut block, mut operators) = (Block::empty(), Operators::empty());
        let mut d_block = [[0.0; W]; BLOCK];
        let blocks = self.points.chunks(3 * BLOCK).zip(self.operators.chunks(BLOCK));
        for ((points, of_points), d_out) in blocks.zip(self.d_out.chunks(length * BLOCK)) {
            block.fill(points);
            operators.fill(of_points);
            for part in 0..parts {
                for (d_features, row) in d_block.iter_mut().zip(d_out.chunks_exact(length)) {
                    *d_features = row[self.level * parts + part];
                }
                for ((start, count, points), operator) in block.groups().zip(&operators.groups) {
                    let cells = Cells::of(simd, level, points);
                    let corners = of_part::<W, _>(simd, cells.corners(simd, level), (part, parts));
                    let corners = simd.store_corners(corners);
                    let mut counts = [[0.0; LANES]; 8];
                    for (counts, weights) in counts.iter_mut().zip(weights(simd, self.grid, level, &cells, operator)) {
                        *counts = simd.store(weights);
                    }
                    simd.add_weighted(self.sum, &corners, &counts, &d_block[start..][..count]);
                }
            }
        }
    }
}

impl<'a> Cotangents<'a> {
    /// Creates cotangents from `points [n, 3]` in the unit cube, and gradients `d_out [n, channels]` in the results of
    /// `operators [n]` on their encodings.
    pub fn of_operators(points: &'a [f32], operators: &'a [Operator<f32>], d_out: &'a [f32]) -> Cotangents<'a> {
        Cotangents { points, d_out, operators: Some(operators) }
    }
}

/// A block's operators, coefficient by coefficient. Missing ones in the last group are 0.
struct Operators {
    groups: [Operator<Lanes>; BLOCK / LANES],
}

impl Operators {
    fn empty() -> Operators {
        Operators { groups: [[[0.0; LANES]; 10]; BLOCK / LANES] }
    }

    /// Replaces the operators by those of at most [`BLOCK`] points.
    #[inline(always)]
    fn fill(&mut self, operators: &[Operator<f32>]) {
        for (group, operators) in self.groups.iter_mut().zip(operators.chunks(LANES)) {
            *group = [[0.0; LANES]; 10];
            for (i, operator) in operators.iter().enumerate() {
                for (lanes, number) in group.iter_mut().zip(operator) {
                    lanes[i] = *number;
                }
            }
        }
    }
}

/// Returns the weight of each corner's feature in an operator's value.
#[inline(always)]
fn weights<S: Simd>(
    simd: S,
    grid: &HashGrid,
    level: &Level,
    cells: &Cells<S>,
    operator: &Operator<Lanes>,
) -> [S::Floats; 8] {
    let along = along(simd, grid, level, cells);
    let mut c = [simd.splat(0.0); 10];
    for (c, lanes) in c.iter_mut().zip(operator) {
        *c = simd.load(lanes);
    }
    let mut weights = [simd.splat(0.0); 8];
    for k in 0..4 {
        let ([x, x1, x2], [y, y1, y2]) = (along[0][k & 1], along[1][k >> 1]);
        let (xy, x1y, xy1) = (simd.mul(x, y), simd.mul(x1, y), simd.mul(x, y1));
        // The terms for z itself, for its first derivative, and for its second derivative.
        let mut flat = simd.mul(c[0], xy);
        flat = simd.mul_add(c[1], x1y, flat);
        flat = simd.mul_add(c[2], xy1, flat);
        flat = simd.mul_add(c[4], simd.mul(x2, y), flat);
        flat = simd.mul_add(c[5], simd.mul(x, y2), flat);
        flat = simd.mul_add(c[7], simd.mul(x1, y1), flat);
        let slope = simd.mul_add(c[9], xy1, simd.mul_add(c[8], x1y, simd.mul(c[3], xy)));
        let bend = simd.mul(c[6], xy);
        for (up, [z, z1, z2]) in along[2].into_iter().enumerate() {
            weights[k + 4 * up] = simd.mul_add(bend, z2, simd.mul_add(slope, z1, simd.mul(flat, z)));
        }
    }
    weights
}

/// Returns the weights of the lower and the upper vertex along each axis, with first and second derivative in the unit
/// cube.
#[inline(always)]
fn along<S: Simd>(simd: S, grid: &HashGrid, level: &Level, cells: &Cells<S>) -> [[[S::Floats; 3]; 2]; 3] {
    let zero = simd.splat(0.0);
    let resolution = simd.splat(level.resolution as f32);
    let shares = grid.interpolation.shares(simd, cells.position);
    let slopes = grid.interpolation.slopes(simd, cells.position);
    let bends = grid.interpolation.bends(simd, cells.position);
    let mut along = [[[zero; 3]; 2]; 3];
    for axis in 0..3 {
        let slope = simd.mul(slopes[axis], resolution);
        let bend = simd.mul(simd.mul(bends[axis], resolution), resolution);
        along[axis][0] = [simd.sub(simd.splat(1.0), shares[axis]), simd.sub(zero, slope), simd.sub(zero, bend)];
        along[axis][1] = [shares[axis], slope, bend];
    }
    along
}
