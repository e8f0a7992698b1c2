//! The values of the encoding.

use super::cell::{BLOCK, Block, Cells, gather_corners, interleaved, mix, mix_edges};
use super::operator::{Operators, weights};
use super::{HashGrid, Operator, by_features};
use crate::simd::{Kernel, Processor, Simd};

/// Reads one number of each cache line, in order. Once per step, this costs a tenth of the time that encoding loses
/// otherwise, if other work has displaced the tables from the caches.
pub fn fetch_tables(tables: &[f32]) {
    std::hint::black_box(tables.iter().step_by(16).sum::<f32>());
}

impl HashGrid {
    /// Encodes points in the unit cube, `points [n, 3]` to `out [n, channels]`, and applies `operators [n]` to the encodings
    /// if there are some. Derivatives are the cell's own. With linear interpolation, first derivatives jump at its faces,
    /// and second derivatives along an axis are 0 within it.
    ///
    /// # Panics
    /// If the sizes do not fit.
    pub fn encode(&self, tables: &[f32], points: &[f32], operators: Option<&[Operator<f32>]>, out: &mut [f32]) {
        let count = self.check(tables.len(), points.len(), out.len());
        assert!(operators.is_none_or(|operators| operators.len() == count), "one operator a point");
        by_features!(self.features, W => {
            let (tables, out) = (tables.as_chunks().0, out.as_chunks_mut().0);
            Encode::<W> { grid: self, tables, points, operators, out }
        });
    }
}

/// Sizes were checked.
struct Encode<'a, const W: usize> {
    grid: &'a HashGrid,
    tables: &'a [[f32; W]],
    points: &'a [f32],
    operators: Option<&'a [Operator<f32>]>,
    out: &'a mut [[f32; W]],
}

impl<const W: usize> Kernel for Encode<'_, W> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let parts = self.grid.parts::<W>();
        let length = self.grid.levels.len() * parts;
        let (mut block, mut operators) = (Block::empty(), Operators::new(self.operators));
        for (points, out) in self.points.chunks(3 * BLOCK).zip(self.out.chunks_mut(length * BLOCK)) {
            block.fill(points);
            operators.advance();
            for (l, level) in self.grid.levels.iter().enumerate() {
                let table = level.table(self.tables, parts);
                for (start, count, points) in block.groups() {
                    let cells = Cells::of(simd, level, points);
                    let entries = cells.corners(simd, level);
                    let shares = self.grid.interpolation.shares(simd, cells.position);
                    let weights = match operators.group(start) {
                        None => None,
                        Some(operator) => Some(weights(simd, self.grid, level, &cells, operator)),
                    };
                    for part in 0..parts {
                        let corners = gather_corners(simd, level, table, entries, (part, parts));
                        let mut features = [simd.splat(0.0); W];
                        for (feature, corners) in features.iter_mut().zip(&corners) {
                            *feature = match &weights {
                                None => interpolate(simd, shares, corners),
                                Some(weights) => weighted(simd, weights, corners),
                            };
                        }
                        let rows = out[start * length..][..count * length].chunks_exact_mut(length);
                        for (row, features) in rows.zip(interleaved(simd, features)) {
                            row[l * parts + part] = features;
                        }
                    }
                }
            }
        }
    }
}

/// Returns the weighted sum of eight corners.
#[inline(always)]
fn weighted<S: Simd>(simd: S, weights: &[S::Floats; 8], corners: &[S::Floats; 8]) -> S::Floats {
    let mut sum = simd.splat(0.0);
    for (weight, corner) in weights.iter().zip(corners) {
        sum = simd.mul_add(*weight, *corner, sum);
    }
    sum
}

/// Interpolates between eight corners: along x, then y, then z.
#[inline(always)]
fn interpolate<S: Simd>(simd: S, [x, y, z]: [S::Floats; 3], corners: &[S::Floats; 8]) -> S::Floats {
    let edges = mix_edges(simd, x, corners);
    mix(simd, z, mix(simd, y, edges[0], edges[1]), mix(simd, y, edges[2], edges[3]))
}
