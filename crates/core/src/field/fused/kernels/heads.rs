//! Layers of few outputs, which would waste most of a vector in a matrix product. Their weights and sums are f32.

use crate::runtime::count_multiply_adds;

use super::finish::{given, put};
use super::panels::{Form, PANEL, Panels, padded};
use super::simd::{LANES, Simd};
use super::{Kernel, launch};

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
    launch(form == Form::Across, Forward { head, x, y });
}

struct Forward<'a> {
    head: &'a Head,
    x: &'a [Panels<'a>],
    y: &'a mut [f32],
}

impl Kernel for Forward<'_> {
    #[inline(always)]
    unsafe fn run<S: Simd>(self) {
        let Forward { head, x, y } = self;
        let (outputs, rows) = (head.outputs, y.len() / head.outputs);
        for o in 0..outputs {
            for first in (0..rows).step_by(LANES) {
                let count = LANES.min(rows - first);
                let mut totals = [0f32; LANES];
                // SAFETY: as the caller promises; `head_forward` has checked the slices.
                unsafe {
                    let mut sums = [S::splat(0.0); LANES];
                    for x in x {
                        head.dots::<S>(&mut sums, x, (first, count), o);
                    }
                    S::store(totals.as_mut_ptr(), S::add(S::sums(&sums), S::splat(head.bias[o])));
                }
                for (i, total) in totals[..count].iter().enumerate() {
                    y[(first + i) * outputs + o] = *total;
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
        sums: &mut [S::V; LANES],
        x: &Panels,
        (first, count): (usize, usize),
        output: usize,
    ) {
        let whole = padded(self.inputs);
        let across = S::PAIRS && x.shape.form == Form::Across;
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
                        (S::load(weights), if across { S::load(weights.add(LANES)) } else { S::splat(0.0) });
                    for (i, sum) in block.iter_mut().enumerate() {
                        let words = S::load(rows.add(i.min(count - 1) * step + column));
                        if across {
                            *sum = S::add(*sum, S::mul(S::first(words), even));
                            *sum = S::add(*sum, S::mul(S::second(words), odd));
                        } else {
                            *sum = S::add(*sum, S::mul(words, even));
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
    launch(x.shape.form == Form::Down, Gradient { dz, outputs, x, sum });
}

struct Gradient<'a> {
    dz: &'a [f32],
    outputs: usize,
    x: Panels<'a>,
    sum: &'a mut [f32],
}

impl Kernel for Gradient<'_> {
    #[inline(always)]
    unsafe fn run<S: Simd>(mut self) {
        let (outputs, columns) = (self.outputs, self.x.shape.columns);
        for (output, panel) in (0..outputs).flat_map(|output| (0..columns).step_by(PANEL).map(move |at| (output, at))) {
            // SAFETY: as the caller promises; `head_gradient` has checked the slices.
            unsafe {
                match self.x.shape.width(panel) {
                    PANEL => self.panel::<S, { PANEL / LANES }>(output, panel),
                    _ => self.panel::<S, { PANEL / LANES / 2 }>(output, panel),
                }
            }
        }
    }
}

impl Gradient<'_> {
    /// Adds an output's gradients of the weights for a panel.
    #[inline(always)]
    unsafe fn panel<S: Simd, const NV: usize>(&mut self, output: usize, panel: usize) {
        let (columns, down) = (self.x.shape.columns, S::PAIRS && self.x.shape.form == Form::Down);
        let to = self.sum[output * columns..][..columns].as_mut_ptr();
        let (start, step) = (self.x.at(0, panel), self.x.shape.step(panel));
        // SAFETY: as in `run`.
        unsafe {
            let mut sums = given::<S, NV>(to, panel, columns);
            for row in 0..self.dz.len() / self.outputs {
                let scale = S::splat(*self.dz.as_ptr().add(row * self.outputs + output));
                let from = start.wrapping_add(step * if down { row / 2 } else { row });
                for v in 0..NV {
                    let words = S::load(from.add(LANES * v));
                    let numbers = match down {
                        true if row % 2 == 0 => S::first(words),
                        true => S::second(words),
                        false => words,
                    };
                    sums[v] = S::add(sums[v], S::mul(scale, numbers));
                }
            }
            put::<S, NV>(to, &sums, (panel, columns), false);
        }
    }
}
