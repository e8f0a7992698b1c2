//! Layers of few outputs, which would waste most of a vector in a matrix product. Their weights and sums are f32.

use augnerf_base::machine::count_multiply_adds;

use super::finish::{given, put};
use super::panels::{Form, PANEL, Panels, padded};
use super::{launch, load};
use crate::simd::{Kernel, LANES, Simd};

/// Weights `[outputs, inputs]` for each form of rows.
pub struct Head {
    /// Number of outputs.
    pub outputs: usize,
    /// Number of inputs.
    pub inputs: usize,
    /// Each row padded to a panel.
    pub weights: Vec<f32>,
    /// The same, with the even ones of each 32 inputs first.
    halves: Vec<f32>,
    bias: Vec<f32>,
}

impl Head {
    /// Packs `weights [outputs, inputs]` and `bias [outputs]`.
    pub fn new(weights: &[f32], bias: &[f32]) -> Head {
        let (outputs, inputs) = (bias.len(), weights.len() / bias.len());
        let filled: Vec<f32> = weights.chunks_exact(inputs).flat_map(super::panels::filled_up).collect();
        let halves = filled.as_chunks::<{ 2 * LANES }>().0.iter();
        let halves =
            halves.flat_map(|block| [0, 1].into_iter().flat_map(|odd| block.iter().skip(odd).step_by(2))).copied();
        Head { outputs, inputs, halves: halves.collect(), weights: filled, bias: bias.to_vec() }
    }
}

/// Computes `y [rows, outputs] = x W^T + b`, where `x` is the sum of rows. Each number is a dot product in `LANES`
/// parallel sums.
pub fn head_forward(head: &Head, x: &[Panels], y: &mut [f32]) {
    let rows = y.len() / head.outputs;
    let form = x[0].shape.form;
    let fits = x.iter().all(|x| x.fits(rows, head.inputs) && x.shape.form == form) && form != Form::Down;
    assert!(fits, "rows of a head do not fit");
    count_multiply_adds(y.len() * head.inputs * x.len());
    launch(Forward { head, x, y });
}

struct Forward<'a> {
    head: &'a Head,
    x: &'a [Panels<'a>],
    y: &'a mut [f32],
}

impl Kernel for Forward<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Forward { head, x, y } = self;
        let (outputs, rows) = (head.outputs, y.len() / head.outputs);
        for o in 0..outputs {
            for first in (0..rows).step_by(LANES) {
                let count = LANES.min(rows - first);
                let mut sums = [simd.splat(0.0); LANES];
                for x in x {
                    // SAFETY: `head_forward` has checked the slices.
                    unsafe { head.dots::<S>(simd, &mut sums, x, (first, count), o) };
                }
                for (i, sum) in sums[..count].iter().enumerate() {
                    y[(first + i) * outputs + o] = simd.store(*sum).iter().sum::<f32>() + head.bias[o];
                }
            }
        }
    }
}

impl Head {
    /// Adds the products of rows with an output's weights, lane by lane, for `count` rows from `first` on. Beyond the
    /// end it repeats the last row.
    #[inline(always)]
    unsafe fn dots<S: Simd>(
        &self,
        simd: S,
        sums: &mut [S::Floats; LANES],
        x: &Panels,
        (first, count): (usize, usize),
        output: usize,
    ) {
        let whole = padded(self.inputs);
        let across = x.shape.form == Form::Across;
        let weights = if across { &self.halves } else { &self.weights };
        for panel in (0..whole).step_by(PANEL) {
            let weights = weights[output * whole + panel..][..x.shape.width(panel)].as_ptr();
            let (rows, step) = (x.at(first, panel), x.shape.step(panel));
            let mut block = *sums;
            // A row has as many words as steps to the next.
            for column in (0..step).step_by(LANES) {
                // SAFETY: rows and weights have these columns.
                unsafe {
                    let weights = weights.add(if across { 2 * column } else { column });
                    let (even, odd) =
                        (load(simd, weights), if across { load(simd, weights.add(LANES)) } else { simd.splat(0.0) });
                    for (i, sum) in block.iter_mut().enumerate() {
                        let words = load(simd, rows.add(i.min(count - 1) * step + column));
                        if across {
                            *sum = simd.add(*sum, simd.mul(simd.first(words), even));
                            *sum = simd.add(*sum, simd.mul(simd.second(words), odd));
                        } else {
                            *sum = simd.add(*sum, simd.mul(words, even));
                        }
                    }
                }
            }
            *sums = block;
        }
    }
}

/// Adds `dz^T x` to `sum [outputs, columns]`, row by row, for `dz [rows, outputs]`.
pub fn head_gradient(dz: &[f32], outputs: usize, x: Panels, sum: &mut [f32]) {
    let (rows, columns) = (dz.len() / outputs, x.shape.columns);
    let fits = x.fits(rows, columns) && x.shape.form != Form::Across && sum.len() == outputs * columns;
    assert!(fits, "the gradient of a head does not fit");
    count_multiply_adds(dz.len() * columns);
    launch(Gradient { dz, outputs, x, sum });
}

struct Gradient<'a> {
    dz: &'a [f32],
    outputs: usize,
    x: Panels<'a>,
    sum: &'a mut [f32],
}

impl Kernel for Gradient<'_> {
    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) {
        let (outputs, columns) = (self.outputs, self.x.shape.columns);
        for (output, panel) in (0..outputs).flat_map(|output| (0..columns).step_by(PANEL).map(move |at| (output, at))) {
            // SAFETY: `head_gradient` has checked the slices.
            unsafe {
                match self.x.shape.width(panel) {
                    PANEL => self.panel::<S, { PANEL / LANES }>(simd, output, panel),
                    _ => self.panel::<S, { PANEL / LANES / 2 }>(simd, output, panel),
                }
            }
        }
    }
}

impl Gradient<'_> {
    /// Adds an output's gradients of the weights for a panel.
    #[inline(always)]
    unsafe fn panel<S: Simd, const NV: usize>(&mut self, simd: S, output: usize, panel: usize) {
        let (columns, down) = (self.x.shape.columns, self.x.shape.form == Form::Down);
        let to = &mut self.sum[output * columns..][..columns];
        let (start, step) = (self.x.at(0, panel), self.x.shape.step(panel));
        // SAFETY: as in `run`.
        unsafe {
            let mut sums = given::<S, NV>(simd, to, panel);
            for row in 0..self.dz.len() / self.outputs {
                let scale = simd.splat(*self.dz.as_ptr().add(row * self.outputs + output));
                let from = start.wrapping_add(step * if down { row / 2 } else { row });
                for v in 0..NV {
                    let words = load(simd, from.add(LANES * v));
                    let numbers = match down {
                        true if row % 2 == 0 => simd.first(words),
                        true => simd.second(words),
                        false => words,
                    };
                    sums[v] = simd.add(sums[v], simd.mul(scale, numbers));
                }
            }
            put(simd, to, &sums, panel, false);
        }
    }
}
