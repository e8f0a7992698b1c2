//! The encoding's values.

use super::cell::{BLOCK, Block, Cells, mix};
use super::simd::{Kernel, Processor, Simd};
use super::{HashGrid, by_features, count_corners};

/// Reads one number of each cache line: once a step, this costs a tenth of what encoding loses to tables that other
/// work has pushed out of the caches, as it reads them in order.
pub fn fetch_tables(tables: &[f32]) {
    std::hint::black_box(tables.iter().step_by(16).sum::<f32>());
}

impl HashGrid {
    /// The encodings of points in the unit cube: `points [n, 3]`, `out [n, channels]`.
    ///
    /// # Panics
    /// If the sizes do not go together.
    pub fn encode(&self, tables: &[f32], points: &[f32], out: &mut [f32]) {
        self.encode_on(Processor::here(), tables, points, out);
    }

    pub(super) fn encode_on(&self, processor: Processor, tables: &[f32], points: &[f32], out: &mut [f32]) {
        self.check(tables.len(), points.len(), out.len());
        count_corners(out.len());
        by_features!(self.features, F => {
            let (tables, out) = (tables.as_chunks().0, out.as_chunks_mut().0);
            processor.run(Encode::<F> { grid: self, tables, points, out });
        });
    }
}

/// Sizes were checked.
struct Encode<'a, const F: usize> {
    grid: &'a HashGrid,
    tables: &'a [[f32; F]],
    points: &'a [f32],
    out: &'a mut [[f32; F]],
}

impl<const F: usize> Kernel for Encode<'_, F> {
    #[inline(always)]
    fn run(self, simd: impl Simd) {
        let levels = self.grid.levels.len();
        let mut block = Block::empty();
        for (points, out) in self.points.chunks(3 * BLOCK).zip(self.out.chunks_mut(levels * BLOCK)) {
            block.fill(points);
            for (l, level) in self.grid.levels.iter().enumerate() {
                let table = &self.tables[level.offset..][..level.entries];
                for (start, count, points) in block.groups() {
                    let cells = Cells::of(simd, level, points);
                    let corners = cells.features(simd, level, table);
                    let shares = self.grid.interpolation.shares(simd, cells.position);
                    let mut features = [simd.splat(0.0); F];
                    for (feature, values) in features.iter_mut().enumerate() {
                        *values = interpolate(simd, shares, |k| corners[k][feature]);
                    }
                    let rows = out[start * levels..][..count * levels].chunks_exact_mut(levels);
                    for (row, features) in rows.zip(simd.rows(features)) {
                        row[l] = features;
                    }
                }
            }
        }
    }
}

/// Between eight corners: along x, then y, then z.
#[inline(always)]
fn interpolate<S: Simd>(simd: S, [x, y, z]: [S::Floats; 3], corner: impl Fn(usize) -> S::Floats) -> S::Floats {
    let edge = |k| mix(simd, x, corner(k), corner(k + 1));
    mix(simd, z, mix(simd, y, edge(0), edge(2)), mix(simd, y, edge(4), edge(6)))
}
