//! Products of the layers, forward and back.

use std::ops::Range;

use wgpu::Buffer;

use crate::device::{Gpu, groups};
use crate::kernels::{Kernel, Tile};
use crate::network::{FieldBuffers, Layer};
use crate::params::Params;

use super::Recorder;

/// Parts of a gradient of weights, at most.
const MOST_PARTS: usize = 128;
/// Fewest rows of a part.
const PART: usize = 512;

/// The rows of products.
#[derive(Clone, Copy)]
pub(crate) enum Rows {
    /// A row a sample.
    Samples(usize),
    /// The same on the way back, which leaves out those without a gradient.
    Live(usize),
    /// Four rows a point: its value, and its derivatives along x, y and z. Layers are linear in derivatives, without
    /// biases, and the value's ReLU is that of its derivatives.
    Jets(usize),
    /// The jets of all points, and then a second one of each: its value again, its Laplacian, and two rows of 0. A ReLU has no
    /// second derivative, so that layers treat a Laplacian as a derivative.
    JetsWithLaplacians(usize),
}

impl Rows {
    /// Returns the number of rows.
    pub(super) fn count(self) -> usize {
        match self {
            Rows::Samples(samples) | Rows::Live(samples) => samples,
            Rows::Jets(points) => 4 * points,
            Rows::JetsWithLaplacians(points) => 8 * points,
        }
    }

    /// Returns the number of samples or points.
    pub(super) fn points(self) -> usize {
        match self {
            Rows::Samples(points) | Rows::Live(points) | Rows::Jets(points) | Rows::JetsWithLaplacians(points) => {
                points
            }
        }
    }

    pub(super) fn are_jets(self) -> bool {
        matches!(self, Rows::Jets(_) | Rows::JetsWithLaplacians(_))
    }

    fn are_live(self) -> bool {
        matches!(self, Rows::Live(_))
    }

    /// Switches on what a kernel does with such rows.
    pub(super) fn chosen(self, kernel: Kernel) -> Kernel {
        let with_laplacians = matches!(self, Rows::JetsWithLaplacians(_));
        kernel.with("JETS", self.are_jets()).with("LAPLACIAN", with_laplacians)
    }
}

/// A matrix in a buffer: numbers between rows, columns that are read.
#[derive(Clone, Copy)]
pub(super) struct Matrix<'a> {
    pub(super) buffer: &'a Buffer,
    pub(super) stride: usize,
    pub(super) columns: usize,
    /// Rows that share one of its rows.
    pub(super) every: usize,
}

impl<'a> Matrix<'a> {
    pub(super) fn new(buffer: &'a Buffer, stride: usize) -> Matrix<'a> {
        Matrix { buffer, stride, columns: stride, every: 1 }
    }
}

/// What a product leaves: the buffer, numbers between rows, the first column.
pub(super) struct Output<'a> {
    pub(super) buffer: &'a Buffer,
    pub(super) stride: usize,
    pub(super) first: usize,
}

/// How the way back goes on from a layer's inputs.
#[derive(Clone, Copy, Default)]
pub(super) struct Through<'a> {
    /// The ReLU's outputs that let gradients pass.
    pub(super) mask: Option<&'a Buffer>,
    /// The product is added to what is there.
    pub(super) adds: bool,
    /// Gets the gradient before the mask.
    pub(super) open: Option<&'a Buffer>,
}

/// Returns the rows of a part of a gradient of weights over `rows` rows, and the number of parts, at most `most`.
fn parts(rows: usize, most: usize) -> (usize, usize) {
    let of_part = rows.div_ceil(most).max(PART).next_multiple_of(16);
    (of_part, rows.div_ceil(of_part))
}

/// Returns the most parts of a gradient of so many weights: in one buffer, and in an eighth of a step's memory.
pub(crate) fn most_parts(gpu: &Gpu, weights: usize) -> usize {
    (gpu.largest_buffer().min(gpu.budget() / 8) / (4 * weights)).clamp(1, MOST_PARTS)
}

/// Returns the most parts of up to `rows` rows, at most `most`. Fewer rows may have more parts than `rows` have.
pub(super) fn parts_of(rows: usize, most: usize) -> usize {
    rows.div_ceil(PART).min(most)
}

impl<'a> Recorder<'a> {
    /// Returns the tile and the kernel of a product with so many columns. Derivatives are computed in f32.
    fn tiled(&self, name: &'static str, columns: usize, rows: Rows) -> (Tile, Kernel) {
        let tiles = if rows.are_jets() { self.jet_tiles } else { self.tiles };
        let tile = Tile::of(columns, tiles);
        let kernel = tile.kernel(name).with("F16", tile.in_f16).with("JETS", rows.are_jets());
        (tile, kernel.with("LIVE", rows.are_live()))
    }

    fn product_params(rows: Rows, n: usize, a: Matrix, second: Option<Matrix>) -> Params {
        let b = second.unwrap_or(Matrix { columns: 0, stride: 1, every: 1, ..a });
        let (m, k1, k2, every2) = (rows.count(), a.columns, b.columns, b.every);
        params! { m, n, k1, k2, lda1: a.stride, lda2: b.stride, every2 }.rest_is_zero()
    }

    /// Records C = [A1 | A2] W + b over some columns of a layer, by ReLU if asked. A delta is added to what the next layer
    /// reads.
    #[expect(clippy::too_many_arguments, reason = "the operands of a product")]
    pub(super) fn dense(
        &mut self,
        rows: Rows,
        field: &FieldBuffers,
        layer: Layer,
        columns: Range<usize>,
        (a, second): (Matrix, Option<Matrix>),
        c: Output,
        relu: bool,
        delta: Option<(&Buffer, &Buffer)>,
    ) {
        let n = columns.len();
        let (tile, kernel) = self.tiled("product", n, rows);
        let kernel = kernel.with("SECOND", second.is_some()).with("DELTA", delta.is_some());
        let params = Recorder::product_params(rows, n, a, second);
        let w_from = layer.offset + columns.start;
        let params = params.and(params! { ldw: layer.outputs, w_from, ldc: c.stride, c_from: c.first, relu, ldx: n });
        let mut buffers = vec![(1, a.buffer), (3, &field.weights.values), (4, c.buffer)];
        buffers.extend(second.map(|second| (2, second.buffer)));
        if let Some((delta, moved)) = delta {
            buffers.extend([(5, delta), (6, moved)]);
        }
        let size = [rows.count(), a.columns + second.map_or(0, |second| second.columns), n];
        self.product(kernel, params, &buffers, tile.groups(rows.count(), n, 1), size);
    }

    /// Records a product of two matrices, `size` = rows, depth and columns, and counts its work.
    fn product(
        &mut self,
        kernel: Kernel,
        params: Params,
        buffers: &[(u32, &Buffer)],
        groups: [u32; 3],
        size: [usize; 3],
    ) {
        self.run(kernel, params, buffers, groups);
        let [rows, depth, columns] = size.map(|size| size as u64);
        let work = &mut self.dispatches.last_mut().expect("just recorded").work;
        work.multiply_adds = rows * depth * columns;
        work.product_bytes = 4 * (rows * depth + depth * columns + rows * columns);
    }

    /// Records C = D W^T over some of a layer's inputs.
    #[expect(clippy::too_many_arguments, reason = "the operands of a product")]
    pub(super) fn dense_back(
        &mut self,
        rows: Rows,
        field: &FieldBuffers,
        layer: Layer,
        inputs: Range<usize>,
        d: Matrix,
        c: (&Buffer, usize),
        Through { mask, adds, open }: Through,
    ) {
        let n = inputs.len();
        let (tile, kernel) = self.tiled("product_back", n, rows);
        let kernel = kernel.with("ADD", adds).with("MASK", mask.is_some());
        let kernel = kernel.with("OPEN", open.is_some());
        let w_from = layer.offset + inputs.start * layer.outputs;
        let params = Recorder::product_params(rows, n, d, None);
        let params = params.and(params! { ldw: layer.outputs, w_from, ldc: c.1, ldx: n });
        let mut buffers = vec![(1, d.buffer), (3, &field.weights.values), (4, c.0)];
        buffers.extend(mask.map(|mask| (5, mask)));
        buffers.extend(open.map(|open| (6, open)));
        buffers.extend(rows.are_live().then_some((7, &self.scratch.live)));
        self.product(kernel, params, &buffers, tile.groups(rows.count(), n, 1), [rows.count(), d.columns, n]);
    }

    /// Records the parts of a layer's gradient.
    pub(super) fn dense_weights(&mut self, rows: Rows, layer: Layer, (a, second): (Matrix, Option<Matrix>), d: Matrix) {
        for columns in layer.products() {
            self.dense_weights_of(columns, rows, layer, (a, second), d);
        }
    }

    /// Records the parts of the gradient of some of a layer's columns.
    fn dense_weights_of(
        &mut self,
        columns: Range<usize>,
        rows: Rows,
        layer: Layer,
        (a, second): (Matrix, Option<Matrix>),
        d: Matrix,
    ) {
        let n = columns.len();
        let (tile, kernel) = self.tiled("weights", n, rows);
        let (part_rows, parts) = parts(rows.count(), self.scratch.most_parts);
        let kernel = kernel.with("SECOND", second.is_some());
        let (parameters, to) = (self.shape.weights(), layer.offset + columns.start);
        let params = Recorder::product_params(rows, n, a, second);
        let params = params.and(params! { ldw: d.stride, w_from: columns.start, ldc: layer.outputs });
        let params = params.and(params! { part_rows, parts, parameters, to });
        let mut buffers = vec![(1, a.buffer), (3, d.buffer), (4, &self.scratch.parts)];
        buffers.extend(second.map(|second| (2, second.buffer)));
        buffers.extend(rows.are_live().then_some((7, &self.scratch.live)));
        self.product(kernel, params, &buffers, tile.groups(layer.inputs, n, parts), [layer.inputs, rows.count(), n]);
    }

    /// Records the sum of the parts of a field's gradient, up to this number of weights.
    pub(super) fn reduce(&mut self, rows: Rows, field: &FieldBuffers, weights: usize) {
        let (_, parts) = parts(rows.count(), self.scratch.most_parts);
        let params = params! { numbers: weights, parts, of_part: self.shape.weights() };
        let buffers = [(1, &self.scratch.parts), (2, &field.weights.gradient)];
        self.run(Kernel::new("reduce"), params, &buffers, groups(weights));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_of_fewer_rows_have_room() {
        for most in [4, 600, 65_536, 76_800, 131_840, 1_000_000] {
            for rows in (1..=most).step_by(most / 500 + 1).chain([most, most.min(65_536)]) {
                for at_most in [MOST_PARTS, 3, 1] {
                    let (of_part, count) = parts(rows, at_most);
                    let fits = count <= parts_of(most, at_most);
                    assert!(fits && of_part * count >= rows && of_part % 16 == 0, "{rows} of {most}");
                }
            }
        }
    }
}
