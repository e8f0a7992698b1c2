//! Products of the layers, forward and back.

use std::num::NonZeroU64;
use std::ops::Range;

use wgpu::{Buffer, BufferBinding};

use crate::device::{Gpu, groups};
use crate::kernels::{Kernel, Tile};
use crate::network::{FieldBuffers, Layer};
use crate::params::Params;

use super::Recorder;
use super::scratch::Layers;

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

/// Numbers in a buffer or in a part of one, in f32 or in f16.
#[derive(Clone, Copy)]
pub(super) struct Numbers<'a> {
    buffer: &'a Buffer,
    /// The first byte, and their number.
    part: Option<(u64, u64)>,
    in_f16: bool,
}

impl<'a> From<&'a Buffer> for Numbers<'a> {
    fn from(buffer: &'a Buffer) -> Numbers<'a> {
        Numbers { buffer, part: None, in_f16: false }
    }
}

impl<'a> Layers {
    /// Returns what layer `i` leaves. Two buffers are used in turn.
    fn at(&'a self, i: usize) -> Numbers<'a> {
        match &self.buffers[..] {
            [all] => Numbers { part: Some((i as u64 * self.bytes, self.bytes)), ..all.into() },
            each => (&each[i % each.len()]).into(),
        }
    }
}

impl<'a> Numbers<'a> {
    fn bound(self) -> BufferBinding<'a> {
        let (offset, size) = self.part.unzip();
        BufferBinding { buffer: self.buffer, offset: offset.unwrap_or(0), size: size.and_then(NonZeroU64::new) }
    }

    fn bytes(self) -> u64 {
        if self.in_f16 { 2 } else { 4 }
    }
}

/// A matrix in a buffer: numbers between rows, columns that are read.
#[derive(Clone, Copy)]
pub(super) struct Matrix<'a> {
    pub(super) numbers: Numbers<'a>,
    pub(super) stride: usize,
    pub(super) columns: usize,
    /// Rows that share one of its rows.
    pub(super) every: usize,
}

impl<'a> Matrix<'a> {
    pub(super) fn new(numbers: impl Into<Numbers<'a>>, stride: usize) -> Matrix<'a> {
        Matrix { numbers: numbers.into(), stride, columns: stride, every: 1 }
    }
}

/// What a product leaves: where, numbers between rows, the first column.
pub(super) struct Output<'a> {
    pub(super) numbers: Numbers<'a>,
    pub(super) stride: usize,
    pub(super) first: usize,
}

/// What a product multiplies, A = [A1 | A2] by W, and what it leaves.
struct Operands<'a> {
    a: Matrix<'a>,
    second: Option<Matrix<'a>>,
    w: Numbers<'a>,
    c: Numbers<'a>,
}

/// How the way back goes on from a layer's inputs.
#[derive(Clone, Copy, Default)]
pub(super) struct Through<'a> {
    /// The ReLU's outputs that let gradients pass.
    pub(super) mask: Option<Numbers<'a>>,
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

    /// Returns what a layer leaves for the next. Derivatives stay in f32.
    pub(super) fn hidden(&self, buffer: &'a Buffer, rows: Rows) -> Numbers<'a> {
        Numbers { in_f16: self.is_f16(rows), ..buffer.into() }
    }

    /// Returns what a layer of the trunk leaves, or the gradient of that.
    pub(super) fn of_layer(&self, layers: &'a Layers, i: usize, rows: Rows) -> Numbers<'a> {
        Numbers { in_f16: self.is_f16(rows), ..layers.at(i) }
    }

    fn is_f16(&self, rows: Rows) -> bool {
        self.form.in_f16 && !rows.are_jets()
    }

    /// Returns the weights that products read.
    fn weights_of<'b>(&self, field: &'b FieldBuffers, rows: Rows) -> Numbers<'b> {
        match &field.halves {
            Some(halves) if self.is_f16(rows) => Numbers { in_f16: true, ..halves.into() },
            _ => (&field.weights.values).into(),
        }
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
        delta: Option<(&Buffer, Numbers)>,
    ) {
        let n = columns.len();
        let (tile, kernel) = self.tiled("product", n, rows);
        let kernel = kernel.with("DELTA", delta.is_some());
        let params = Recorder::product_params(rows, n, a, second);
        let w_from = layer.offset + columns.start;
        let params = params.and(params! { ldw: layer.outputs, w_from, ldc: c.stride, c_from: c.first, relu, ldx: n });
        let operands = Operands { a, second, w: self.weights_of(field, rows), c: c.numbers };
        let delta = delta.map(|(delta, moved)| (delta.into(), moved)).unzip();
        let size = [rows.count(), a.columns + second.map_or(0, |second| second.columns), n];
        self.product(kernel, params, operands, delta, None, tile.groups(rows.count(), n, 1), size);
    }

    /// Records a product of two matrices, `size` = rows, depth and columns, and counts its work.
    #[expect(clippy::too_many_arguments, reason = "the operands of a product")]
    fn product(
        &mut self,
        kernel: Kernel,
        params: Params,
        Operands { a, second, w, c }: Operands,
        (x, y): (Option<Numbers>, Option<Numbers>),
        live: Option<&Buffer>,
        groups: [u32; 3],
        size: [usize; 3],
    ) {
        let kernel = kernel.with("SECOND", second.is_some());
        let mut bound = vec![(1, "A1_IN_F16", a.numbers), (3, "W_IN_F16", w), (4, "C_IN_F16", c)];
        bound.extend(second.map(|second| (2, "A2_IN_F16", second.numbers)));
        bound.extend(x.map(|x| (5, "X_IN_F16", x)));
        bound.extend(y.map(|y| (6, "Y_IN_F16", y)));
        let kernel = bound.iter().fold(kernel, |kernel, (_, flag, numbers)| kernel.with(flag, numbers.in_f16));
        let parts = bound.iter().map(|(at, _, numbers)| (*at, numbers.bound()));
        let parts: Vec<_> = parts.chain(live.map(|live| (7, live.as_entire_buffer_binding()))).collect();
        self.dispatches.push(self.gpu.dispatch_parts(&kernel, &params, &parts, groups));
        let [rows, depth, columns] = size.map(|size| size as u64);
        let work = &mut self.dispatches.last_mut().expect("just recorded").work;
        work.multiply_adds = rows * depth * columns;
        let bytes_of_a = second.map_or(a.numbers.bytes(), |second| a.numbers.bytes().max(second.numbers.bytes()));
        work.product_bytes = bytes_of_a * rows * depth + w.bytes() * depth * columns + c.bytes() * rows * columns;
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
        c: (Numbers, usize),
        Through { mask, adds, open }: Through,
    ) {
        let n = inputs.len();
        let (tile, kernel) = self.tiled("product_back", n, rows);
        let kernel = kernel.with("ADD", adds).with("MASK", mask.is_some());
        let kernel = kernel.with("OPEN", open.is_some());
        let w_from = layer.offset + inputs.start * layer.outputs;
        let params = Recorder::product_params(rows, n, d, None);
        let params = params.and(params! { ldw: layer.outputs, w_from, ldc: c.1, ldx: n });
        let operands = Operands { a: d, second: None, w: self.weights_of(field, rows), c: c.0 };
        let (live, size) = (self.live(rows), [rows.count(), d.columns, n]);
        self.product(kernel, params, operands, (mask, open.map(Numbers::from)), live, tile.groups(size[0], n, 1), size);
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
        let (parameters, to) = (self.shape.weights(), layer.offset + columns.start);
        let params = Recorder::product_params(rows, n, a, second);
        let params = params.and(params! { ldw: d.stride, w_from: columns.start, ldc: layer.outputs });
        let params = params.and(params! { part_rows, parts, parameters, to });
        let operands = Operands { a, second, w: d.numbers, c: (&self.scratch.parts).into() };
        let (live, size) = (self.live(rows), [layer.inputs, rows.count(), n]);
        self.product(kernel, params, operands, (None, None), live, tile.groups(size[0], n, parts), size);
    }

    /// Returns the list of rows that count, where others are left out.
    pub(super) fn live(&self, rows: Rows) -> Option<&'a Buffer> {
        rows.are_live().then_some(&self.scratch.live)
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
