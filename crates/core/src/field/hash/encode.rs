//! The values of the encoding.

use super::cell::{BLOCK, Block, Cells, gather_corners, mix};
use super::simd::{Kernel, Processor, Simd};
use super::{HashGrid, by_features, count_corners};

/// Reads one number of each cache line, in order. Once per step, this costs a tenth of the time that encoding loses
/// otherwise, if other work has displaced the tables from the caches.
pub fn fetch_tables(tables: &[f32]) {
    std::hint::black_box(tables.iter().step_by(16).sum::<f32>());
}

impl HashGrid {
    /// Encodes points in the unit cube: `points [n, 3]` to `out [n, channels]`.
    ///
    /// # Panics
    /// If the sizes do not fit.
    pub fn encode(&self, tables: &[f32], points: &[f32], out: &mut [f32]) {
        self.encode_on(Processor::here(), tables, points, out);
    }

    pub(super) fn encode_on(&self, processor: Processor, tables: &[f32], points: &[f32], out: &mut [f32]) {
        self.check(tables.len(), points.len(), out.len());
        count_corners(out.len());
        by_features!(processor, self.features, W => {
            Encode::<W> { grid: self, tables: tables.as_chunks().0, points, out: out.as_chunks_mut().0 }
        });
    }
}

/// Sizes were checked.
struct Encode<'a, const W: usize> {
    grid: &'a HashGrid,
    tables: &'a [[f32; W]],
    points: &'a [f32],
    out: &'a mut [[f32; W]],
}

impl<const W: usize> Kernel for Encode<'_, W> {
    #[inline(always)]
    fn run(self, simd: impl Simd) {
        let parts = self.grid.parts::<W>();
        let length = self.grid.levels.len() * parts;
        let mut block = Block::empty();
        for (points, out) in self.points.chunks(3 * BLOCK).zip(self.out.chunks_mut(length * BLOCK)) {
            block.fill(points);
            for (l, level) in self.grid.levels.iter().enumerate() {
                let table = level.table(self.tables, parts);
                for (start, count, points) in block.groups() {
                    let cells = Cells::of(simd, level, points);
                    let entries = cells.corners(simd, level);
                    let shares = self.grid.interpolation.shares(simd, cells.position);
                    for part in 0..parts {
                        let corners = gather_corners(simd, level, table, entries, (part, parts));
                        let mut features = [simd.splat(0.0); W];
                        for (feature, values) in features.iter_mut().enumerate() {
                            *values = interpolate(simd, shares, |k| corners[k][feature]);
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

/// Interpolates between eight corners: along x, then y, then z.
#[inline(always)]
fn interpolate<S: Simd>(simd: S, [x, y, z]: [S::Floats; 3], corner: impl Fn(usize) -> S::Floats) -> S::Floats {
    let edge = |k| mix(simd, x, corner(k), corner(k + 1));
    mix(simd, z, mix(simd, y, edge(0), edge(2)), mix(simd, y, edge(4), edge(6)))
}
