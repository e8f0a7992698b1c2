//! Gradients in the tables.

use rayon::prelude::*;

use super::Interpolation;

use super::cell::{BLOCK, Block, Cells, of_part};
use super::operator::{self, Operators};
use super::{HashGrid, Operator, by_features};
use crate::simd::{Kernel, LANES, Lanes, Processor, Simd};

/// Points, and the gradients in their encodings or in the results of operators on those.
#[derive(Clone, Copy)]
pub struct EncodingGradients<'a> {
    /// `[n, 3]`, in the unit cube.
    pub points: &'a [f32],
    /// `[n, channels]`.
    pub d_out: &'a [f32],
    /// `[n]`. `None` if the gradients are in the encodings themselves.
    pub operators: Option<&'a [Operator<f32>]>,
}

impl HashGrid {
    /// Computes the tables' gradient of all records, and overwrites `sum [entries, features]`. One thread processes
    /// each level, in the order of records and points. The bytes do not depend on the number of threads.
    ///
    /// # Panics
    /// If the sizes do not fit.
    pub fn table_gradient(&self, records: &[EncodingGradients], sum: &mut [f32]) {
        assert_eq!(sum.len(), self.entries() * self.features, "the gradient is of another grid's tables");
        let mut rest = sum;
        let mut parts = Vec::with_capacity(self.levels.len());
        for level in &self.levels {
            let (part, behind) = rest.split_at_mut(level.entries * self.features);
            parts.push(part);
            rest = behind;
        }
        parts.into_par_iter().enumerate().for_each(|(level, sum)| {
            // Cleared here, the table is in a near cache for the additions.
            sum.fill(0.0);
            for record in records {
                self.scatter(level, *record, sum);
            }
        });
    }

    /// Adds one level's part of a record to that level's `sum [level's entries, features]`, in the order of the points.
    ///
    /// # Panics
    /// If the sizes do not fit.
    pub fn scatter(&self, level: usize, record: EncodingGradients, sum: &mut [f32]) {
        let EncodingGradients { points, d_out, operators } = record;
        let count = self.check(self.entries() * self.features, points.len(), d_out.len());
        assert!(operators.is_none_or(|operators| operators.len() == count), "one operator a point");
        assert_eq!(sum.len(), self.levels[level].entries * self.features, "the gradient is of another level's table");
        by_features!(self.features, W => {
            let (d_out, sum) = (d_out.as_chunks().0, sum.as_chunks_mut().0);
            Scatter::<W> { grid: self, level, points, operators, d_out, sum }
        });
    }
}

/// Sizes were checked.
struct Scatter<'a, const W: usize> {
    grid: &'a HashGrid,
    level: usize,
    points: &'a [f32],
    operators: Option<&'a [Operator<f32>]>,
    d_out: &'a [[f32; W]],
    sum: &'a mut [[f32; W]],
}

impl<const W: usize> Kernel for Scatter<'_, W> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let parts = self.grid.parts::<W>();
        let length = self.grid.levels.len() * parts;
        let level = &self.grid.levels[self.level];
        let (mut block, mut operators) = (Block::empty(), Operators::new(self.operators));
        let mut d_block = [[0.0; W]; BLOCK];
        for (points, d_out) in self.points.chunks(3 * BLOCK).zip(self.d_out.chunks(length * BLOCK)) {
            block.fill(points);
            operators.advance();
            for part in 0..parts {
                // All at once, because each waits for memory, and many can wait together.
                for (d_features, row) in d_block.iter_mut().zip(d_out.chunks_exact(length)) {
                    *d_features = row[self.level * parts + part];
                }
                for (start, count, points) in block.groups() {
                    let cells = Cells::of(simd, level, points);
                    let corners = of_part::<W, _>(simd, cells.corners(simd, level), (part, parts));
                    let weights = match operators.group(start) {
                        None => weights(simd, self.grid.interpolation, &cells),
                        Some(operator) => operator::weights(simd, self.grid, level, &cells, operator),
                    };
                    let mut stored = [([0; LANES], [0.0; LANES]); 8];
                    for (stored, (corner, weight)) in stored.iter_mut().zip(corners.into_iter().zip(weights)) {
                        *stored = (simd.store_ints(corner), simd.store(weight));
                    }
                    add_weighted(self.sum, &stored, &d_block[start..][..count]);
                }
            }
        }
    }
}

/// Adds each row's features, times its weight at each corner, to the corner's entry: row after row, corner after
/// corner.
#[inline(always)]
fn add_weighted<const W: usize>(table: &mut [[f32; W]], corners: &[([u32; LANES], Lanes); 8], rows: &[[f32; W]]) {
    for (i, row) in rows.iter().enumerate().take(LANES) {
        for (entries, weights) in corners {
            for (sum, feature) in table[entries[i] as usize].iter_mut().zip(row) {
                *sum = weights[i].mul_add(*feature, *sum);
            }
        }
    }
}

/// Returns the weight of each corner's features in the interpolation.
#[inline(always)]
fn weights<S: Simd>(simd: S, interpolation: Interpolation, cells: &Cells<S>) -> [S::Floats; 8] {
    let [x1, y1, z1] = interpolation.shares(simd, cells.position);
    let one = simd.splat(1.0);
    let [x0, y0, z0] = [simd.sub(one, x1), simd.sub(one, y1), simd.sub(one, z1)];
    let edges = [simd.mul(y0, z0), simd.mul(y1, z0), simd.mul(y0, z1), simd.mul(y1, z1)];
    let mut weights = [x0; 8];
    for (weights, edge) in weights.as_chunks_mut::<2>().0.iter_mut().zip(edges) {
        *weights = [simd.mul(x0, edge), simd.mul(x1, edge)];
    }
    weights
}
