//! Gradients of weights and biases.

use crate::runtime::count_multiply_adds;

use super::finish::{given, put};
use super::panels::{Form, PANEL, Panels, padded};
use super::product::multiply_add;
use super::simd::{LANES, Simd};
use super::{Kernel, launch};

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
    launch(dz.shape.form == Form::Down, Weights { dz, x, rows, sum, stride });
}

struct Weights<'a> {
    dz: Panels<'a>,
    x: Panels<'a>,
    rows: usize,
    sum: &'a mut [f32],
    stride: usize,
}

impl Kernel for Weights<'_> {
    #[inline(always)]
    unsafe fn run<S: Simd>(mut self) {
        // SAFETY: as the caller promises; `weight_gradient` has checked the slices.
        unsafe {
            for column in (0..padded(self.x.shape.columns)).step_by(PANEL) {
                let width = self.x.shape.width(column);
                for output in (0..self.dz.shape.columns).step_by(PANEL) {
                    match width == PANEL {
                        true if S::WIDE => self.panel::<S, 6, 4>(output, column),
                        false if S::WIDE => self.panel::<S, 12, 2>(output, column),
                        _ => {
                            for column in (column..column + width).step_by(LANES) {
                                self.panel::<S, 6, 1>(output, column);
                            }
                        }
                    }
                }
            }
        }
    }
}

impl Weights<'_> {
    /// Adds the outputs of a panel of `dz`.
    #[inline(always)]
    unsafe fn panel<S: Simd, const MR: usize, const NV: usize>(&mut self, output: usize, column: usize) {
        let end = self.dz.shape.columns.min(output + PANEL);
        let mut n = output;
        // SAFETY: as in `run`.
        unsafe {
            while n + MR <= end {
                self.block::<S, MR, NV>(n, column);
                n += MR;
            }
            while n + 4 <= end {
                self.block::<S, 4, NV>(n, column);
                n += 4;
            }
            while n < end {
                self.block::<S, 1, NV>(n, column);
                n += 1;
            }
        }
    }

    #[inline(always)]
    unsafe fn block<S: Simd, const MR: usize, const NV: usize>(&mut self, output: usize, column: usize) {
        // SAFETY: as in `run`.
        unsafe {
            let a = (self.dz.at(0, output), 1, self.dz.shape.step(output));
            let b = (self.x.at(0, column), self.x.shape.step(column));
            let at = (column, self.x.shape.columns);
            let to = self.sum.as_mut_ptr().add(output * self.stride);
            let pairs = S::PAIRS && self.dz.shape.form == Form::Down;
            if self.rows <= 2 && !pairs {
                return add_rows::<S, MR, NV>((to, self.stride), at, a, b, self.rows);
            }
            let mut sums = [[S::splat(0.0); NV]; MR];
            if pairs {
                multiply_add::<S, true, MR, NV>(&mut sums, a, b, self.rows.div_ceil(2));
            } else {
                multiply_add::<S, false, MR, NV>(&mut sums, a, b, self.rows);
            }
            for r in 0..MR {
                put::<S, NV>(to.add(r * self.stride), &sums[r], at, true);
            }
        }
    }
}

/// Adds one or two rows' products to the sums in memory, one after the other.
#[inline(always)]
unsafe fn add_rows<S: Simd, const MR: usize, const NV: usize>(
    (to, stride): (*mut f32, usize),
    at: (usize, usize),
    (a, a_row, a_step): (*const f32, usize, usize),
    (b, b_step): (*const f32, usize),
    rows: usize,
) {
    for (step, r) in (0..rows * MR).map(|i| (i / MR, i % MR)) {
        // SAFETY: both sides and the sums have these numbers.
        unsafe {
            let scale = S::splat(*a.add(step * a_step + r * a_row));
            let mut products = [scale; NV];
            for (v, product) in products.iter_mut().enumerate() {
                *product = S::mul(scale, S::load(b.add(step * b_step + LANES * v)));
            }
            put::<S, NV>(to.add(r * stride), &products, at, true);
        }
    }
}

/// Adds every row to `sum [columns]`, one after the other. In bf16 it adds pair after pair, in each the second row
/// first.
pub fn bias_gradient(dz: Panels, rows: usize, sum: &mut [f32]) {
    let fits = dz.fits(rows, sum.len()) && dz.shape.form != Form::Across;
    assert!(fits, "the gradient does not fit");
    launch(dz.shape.form == Form::Down, Columns { dz, rows, sum });
}

struct Columns<'a> {
    dz: Panels<'a>,
    rows: usize,
    sum: &'a mut [f32],
}

impl Kernel for Columns<'_> {
    #[inline(always)]
    unsafe fn run<S: Simd>(mut self) {
        for panel in (0..self.sum.len()).step_by(PANEL) {
            // SAFETY: as the caller promises; `bias_gradient` has checked the slices.
            unsafe {
                match self.dz.shape.width(panel) {
                    PANEL => self.panel::<S, { PANEL / LANES }>(panel),
                    _ => self.panel::<S, { PANEL / LANES / 2 }>(panel),
                }
            }
        }
    }
}

impl Columns<'_> {
    #[inline(always)]
    unsafe fn panel<S: Simd, const NV: usize>(&mut self, panel: usize) {
        let (columns, pairs) = (self.sum.len(), S::PAIRS && self.dz.shape.form == Form::Down);
        // SAFETY: as in `run`.
        unsafe {
            // 1 and 1 as bf16.
            let ones = S::splat(f32::from_bits(0x3f80_3f80));
            let mut sums = given::<S, NV>(self.sum.as_ptr(), panel, columns);
            let (mut from, step) = (self.dz.at(0, panel), self.dz.shape.step(panel));
            for _ in 0..if pairs { self.rows.div_ceil(2) } else { self.rows } {
                for v in 0..NV {
                    let row = S::load(from.add(LANES * v));
                    sums[v] = if pairs { S::dot_pairs(row, ones, sums[v]) } else { S::add(sums[v], row) };
                }
                from = from.wrapping_add(step);
            }
            put::<S, NV>(self.sum.as_mut_ptr(), &sums, (panel, columns), false);
        }
    }
}
