//! Gradients in the points.

use super::cell::{BLOCK, Block, Cells, gather_corners, mix, mix_edges};
use super::{HashGrid, by_features};
use crate::simd::{Kernel, LANES, Lanes, Processor, Simd};

impl HashGrid {
    /// Computes the gradient in the points, `d_points [n, 3]`, from that in the encodings, `d_out [n, channels]`. It is
    /// the cell's own, which jumps at its faces if the interpolation is linear.
    ///
    /// # Panics
    /// If the sizes do not fit.
    pub fn point_gradient(&self, tables: &[f32], points: &[f32], d_out: &[f32], d_points: &mut [f32]) {
        self.check(tables.len(), points.len(), d_out.len());
        assert_eq!(points.len(), d_points.len(), "one gradient a point");
        by_features!(self.features, W => {
            let (tables, d_out) = (tables.as_chunks().0, d_out.as_chunks().0);
            PointGradient::<W> { grid: self, tables, points, d_out, d_points }
        });
    }
}

/// Sizes were checked.
struct PointGradient<'a, const W: usize> {
    grid: &'a HashGrid,
    tables: &'a [[f32; W]],
    points: &'a [f32],
    d_out: &'a [[f32; W]],
    d_points: &'a mut [f32],
}

impl<const W: usize> Kernel for PointGradient<'_, W> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let parts = self.grid.parts::<W>();
        let length = self.grid.levels.len() * parts;
        let mut block = Block::empty();
        let blocks = self.points.chunks(3 * BLOCK).zip(self.d_out.chunks(length * BLOCK));
        for ((points, d_out), d_points) in blocks.zip(self.d_points.chunks_mut(3 * BLOCK)) {
            block.fill(points);
            let mut sums = [[[0.0; LANES]; 3]; BLOCK / LANES];
            for (l, level) in self.grid.levels.iter().enumerate() {
                let table = level.table(self.tables, parts);
                let resolution = simd.splat(level.resolution as f32);
                for ((start, count, points), sums) in block.groups().zip(&mut sums) {
                    let cells = Cells::of(simd, level, points);
                    let entries = cells.corners(simd, level);
                    let shares = self.grid.interpolation.shares(simd, cells.position);
                    let slopes = self.grid.interpolation.slopes(simd, cells.position);
                    let mut along = [simd.splat(0.0); 3];
                    for part in 0..parts {
                        let mut d_features = [[0.0; W]; LANES];
                        let rows = d_out[start * length..][..count * length].chunks_exact(length);
                        for (d_features, row) in d_features.iter_mut().zip(rows) {
                            *d_features = row[l * parts + part];
                        }
                        let d_features = columns(simd, &d_features);
                        let corners = gather_corners(simd, level, table, entries, (part, parts));
                        for feature in 0..W {
                            let slope = differences(simd, shares, &corners[feature]);
                            for axis in 0..3 {
                                along[axis] = simd.mul_add(d_features[feature], slope[axis], along[axis]);
                            }
                        }
                    }
                    for axis in 0..3 {
                        let factor = simd.mul(slopes[axis], resolution);
                        let sum = simd.mul_add(along[axis], factor, simd.load(&sums[axis]));
                        sums[axis] = simd.store(sum);
                    }
                }
            }
            write(&sums, d_points);
        }
    }
}

/// Separates the features of all lanes.
#[inline(always)]
fn columns<const W: usize, S: Simd>(simd: S, rows: &[[f32; W]; LANES]) -> [S::Floats; W] {
    let mut features = [[0.0; LANES]; W];
    for (i, row) in rows.iter().enumerate() {
        for (values, value) in features.iter_mut().zip(row) {
            values[i] = *value;
        }
    }
    let mut loaded = [simd.splat(0.0); W];
    for (loaded, values) in loaded.iter_mut().zip(&features) {
        *loaded = simd.load(values);
    }
    loaded
}

/// Writes numbers of groups, axis by axis, as points.
#[inline(always)]
fn write(groups: &[[Lanes; 3]], points: &mut [f32]) {
    for (group, points) in groups.iter().zip(points.chunks_mut(3 * LANES)) {
        for (i, point) in points.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            *point = [group[0][i], group[1][i], group[2][i]];
        }
    }
}

/// Returns the derivative of the interpolation between eight corners in the weight of each axis.
#[inline(always)]
fn differences<S: Simd>(simd: S, [x, y, z]: [S::Floats; 3], corners: &[S::Floats; 8]) -> [S::Floats; 3] {
    let edges = mix_edges(simd, x, corners);
    let mut slopes = [x; 4];
    for (slope, [a, b]) in slopes.iter_mut().zip(corners.as_chunks::<2>().0) {
        *slope = simd.sub(*b, *a);
    }
    let along_x = mix(simd, z, mix(simd, y, slopes[0], slopes[1]), mix(simd, y, slopes[2], slopes[3]));
    let along_y = mix(simd, z, simd.sub(edges[1], edges[0]), simd.sub(edges[3], edges[2]));
    let along_z = simd.sub(mix(simd, y, edges[2], edges[3]), mix(simd, y, edges[0], edges[1]));
    [along_x, along_y, along_z]
}
