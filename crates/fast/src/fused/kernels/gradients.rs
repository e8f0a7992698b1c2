//! Gradients of weights and biases.

use augnerf_base::machine::count_multiply_adds;

use super::finish::{given, put};
use super::panels::{Form, PANEL, Panels, padded};
use super::product::multiply_add;
use super::{launch, load};
use crate::simd::{Kernel, LANES, Simd};

/// Adds `dz^T x` of `rows` rows, summed separately, to a gradient `[outputs, columns]` whose rows are `stride` apart.
pub fn weight_gradient(dz: Panels, x: Panels, rows: usize, sum: &mut [f32], stride: usize) {
    let (outputs, columns) = (dz.shape.columns, x.shape.columns);
    let fits = dz.fits(rows, outputs)
        && x.fits(rows, columns)
        && dz.shape.form == x.shape.form
        && dz.shape.form != Form::Across
        && columns <= stride
        && (outputs == 0 || (outputs - 1) * stride + columns <= sum.len());
    assert!(fits, "the gradient does not fit");
    count_multiply_adds(rows * outputs * columns);
    match dz.shape.form {
        Form::Down => launch(Weights::<true> { dz, x, rows, sum, stride }),
        _ => launch(Weights::<false> { dz, x, rows, sum, stride }),
    }
}

struct Weights<'a, const PAIRS: bool> {
    dz: Panels<'a>,
    x: Panels<'a>,
    rows: usize,
    sum: &'a mut [f32],
    stride: usize,
}

impl<const PAIRS: bool> Kernel for Weights<'_, PAIRS> {
    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) {
        // SAFETY: `weight_gradient` has checked the slices.
        unsafe {
            for column in (0..padded(self.x.shape.columns)).step_by(PANEL) {
                let width = self.x.shape.width(column);
                for output in (0..self.dz.shape.columns).step_by(PANEL) {
                    match width == PANEL {
                        true if S::WIDE => self.panel::<S, 6, 4>(simd, output, column),
                        false if S::WIDE => self.panel::<S, 12, 2>(simd, output, column),
                        _ => {
                            for column in (column..column + width).step_by(LANES) {
                                self.panel::<S, 4, 1>(simd, output, column);
                            }
                        }
                    }
                }
            }
        }
    }
}

impl<const PAIRS: bool> Weights<'_, PAIRS> {
    /// Adds the outputs of a panel of `dz`.
    #[inline(always)]
    unsafe fn panel<S: Simd, const MR: usize, const NV: usize>(&mut self, simd: S, output: usize, column: usize) {
        let end = self.dz.shape.columns.min(output + PANEL);
        let mut n = output;
        // SAFETY: as in `run`.
        unsafe {
            while n + MR <= end {
                self.block::<S, MR, NV>(simd, n, column);
                n += MR;
            }
            while n + 4 <= end {
                self.block::<S, 4, NV>(simd, n, column);
                n += 4;
            }
            while n < end {
                self.block::<S, 1, NV>(simd, n, column);
                n += 1;
            }
        }
    }

    #[inline(always)]
    unsafe fn block<S: Simd, const MR: usize, const NV: usize>(&mut self, simd: S, output: usize, column: usize) {
        // SAFETY: as in `run`.
        unsafe {
            let a = (self.dz.at(0, output), 1, self.dz.shape.step(output));
            let b = (self.x.at(0, column), self.x.shape.step(column));
            let (columns, stride) = (self.x.shape.columns, self.stride);
            let to = &mut self.sum[output * stride..];
            if self.rows <= 2 && !PAIRS {
                return add_rows::<S, MR, NV>(simd, (to, stride), (column, columns), a, b, self.rows);
            }
            let mut sums = [[simd.splat(0.0); NV]; MR];
            let steps = if PAIRS { self.rows.div_ceil(2) } else { self.rows };
            multiply_add::<S, PAIRS, MR, NV>(simd, &mut sums, a, b, steps);
            for r in 0..MR {
                put(simd, &mut to[r * stride..][..columns], &sums[r], column, true);
            }
        }
    }
}

/// Adds one or two rows' products to the sums in memory, one after the other.
#[inline(always)]
unsafe fn add_rows<S: Simd, const MR: usize, const NV: usize>(
    simd: S,
    (to, stride): (&mut [f32], usize),
    (column, columns): (usize, usize),
    (a, a_row, a_step): (*const f32, usize, usize),
    (b, b_step): (*const f32, usize),
    rows: usize,
) {
    for (step, r) in (0..rows * MR).map(|i| (i / MR, i % MR)) {
        // SAFETY: both sides have these numbers.
        let products: [S::Floats; NV] = unsafe {
            let scale = simd.splat(*a.add(step * a_step + r * a_row));
            let mut products = [scale; NV];
            for (v, product) in products.iter_mut().enumerate() {
                *product = simd.mul(scale, load(simd, b.add(step * b_step + LANES * v)));
            }
            products
        };
        put(simd, &mut to[r * stride..][..columns], &products, column, true);
    }
}

/// Adds every row to `sum [columns]`, one after the other. In bf16 it adds pair after pair, in each the second row
/// first.
pub fn bias_gradient(dz: Panels, rows: usize, sum: &mut [f32]) {
    let fits = dz.fits(rows, sum.len()) && dz.shape.form != Form::Across;
    assert!(fits, "the gradient does not fit");
    launch(Columns { dz, rows, sum });
}

struct Columns<'a> {
    dz: Panels<'a>,
    rows: usize,
    sum: &'a mut [f32],
}

impl Kernel for Columns<'_> {
    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) {
        for panel in (0..self.sum.len()).step_by(PANEL) {
            // SAFETY: `bias_gradient` has checked the slices.
            unsafe {
                match self.dz.shape.width(panel) {
                    PANEL => self.panel::<S, { PANEL / LANES }>(simd, panel),
                    _ => self.panel::<S, { PANEL / LANES / 2 }>(simd, panel),
                }
            }
        }
    }
}

impl Columns<'_> {
    #[inline(always)]
    unsafe fn panel<S: Simd, const NV: usize>(&mut self, simd: S, panel: usize) {
        let pairs = self.dz.shape.form == Form::Down;
        // SAFETY: as in `run`.
        unsafe {
            // 1 and 1 as bf16.
            let ones = simd.splat(f32::from_bits(0x3f80_3f80));
            let mut sums = given::<S, NV>(simd, self.sum, panel);
            let (mut from, step) = (self.dz.at(0, panel), self.dz.shape.step(panel));
            for _ in 0..if pairs { self.rows.div_ceil(2) } else { self.rows } {
                for v in 0..NV {
                    let row = load(simd, from.add(LANES * v));
                    sums[v] = if pairs { simd.dot_pairs(row, ones, sums[v]) } else { simd.add(sums[v], row) };
                }
                from = from.wrapping_add(step);
            }
            put(simd, self.sum, &sums, panel, false);
        }
    }
}
