//! Products of rows with packed weights, and finishing of other rows.

use std::mem::MaybeUninit;

use augnerf_base::machine::count_multiply_adds;

use super::finish::{Block, given};
use super::panels::{Form, PANEL, Packed, Panels, padded};
use super::{launch, load};
use crate::simd::{Kernel, LANES, Simd};

pub use super::finish::{Bias, ByRay, Finish, Out};

/// The left side of a product.
#[derive(Clone, Copy)]
pub enum Lhs<'a> {
    /// f32, row by row.
    Rows(&'a [f32]),
    /// Rows in panels.
    Panels(Panels<'a>),
}

/// A left side with its weights.
#[derive(Clone, Copy)]
pub struct Source<'a> {
    /// The left side.
    pub lhs: Lhs<'a>,
    /// Its weights.
    pub weights: &'a Packed,
}

/// The source of `rows` rows that are finished.
#[derive(Clone, Copy)]
pub enum Rows<'a> {
    /// The sum of products `x W^T`, each summed separately in the order of its inputs.
    Products(&'a [Source<'a>]),
    /// Of few outputs: sums of `weights` rows (each padded to a panel) times numbers of `dz [rows, outputs]`.
    Few {
        /// `[rows, outputs]`.
        dz: &'a [f32],
        /// `[outputs, columns]`, with padded columns.
        weights: &'a [f32],
        /// Number of outputs.
        outputs: usize,
    },
    /// f32, row by row.
    Given(&'a [f32]),
    /// Gathered rows of f32.
    Chosen(&'a [f32], &'a [usize]),
    /// f32 in panels.
    Panels(Panels<'a>),
}

impl Rows<'_> {
    /// Finishes `rows` rows of `columns` numbers.
    pub fn finish(self, rows: usize, columns: usize, mut to: Finish) {
        self.check(rows, columns);
        to.check(rows, columns);
        count_multiply_adds(rows * columns * self.terms());
        launch(Finished { from: self, rows, columns, to: &mut to });
    }

    /// Returns the number of products in a sum.
    fn terms(&self) -> usize {
        match self {
            Rows::Products(sources) => sources.iter().map(|source| source.weights.inputs).sum(),
            Rows::Few { outputs, .. } => *outputs,
            _ => 0,
        }
    }

    /// Checks the slices.
    fn check(&self, rows: usize, columns: usize) {
        let fits = match self {
            Rows::Products(sources) => sources.iter().all(|source| source.fits(rows, columns)),
            Rows::Few { dz, weights, outputs } => {
                dz.len() == rows * outputs && weights.len() == outputs * padded(columns)
            }
            Rows::Given(values) => values.len() == rows * columns,
            Rows::Chosen(values, chosen) => {
                chosen.len() == rows && chosen.iter().all(|row| (row + 1) * columns <= values.len())
            }
            Rows::Panels(panels) => panels.shape.form == Form::Single && panels.fits(rows, columns),
        };
        assert!(fits, "rows that are finished do not fit");
    }
}

impl Source<'_> {
    fn fits(&self, rows: usize, columns: usize) -> bool {
        let Packed { outputs, inputs, pairs, .. } = *self.weights;
        let left = match self.lhs {
            Lhs::Rows(values) => !pairs && values.len() == rows * inputs,
            Lhs::Panels(panels) => {
                let form = if pairs { Form::Across } else { Form::Single };
                panels.shape.form == form && panels.fits(rows, inputs)
            }
        };
        left && outputs == columns
    }
}

/// Rows with their finishing, checked.
struct Finished<'a, 'b> {
    from: Rows<'a>,
    rows: usize,
    columns: usize,
    to: &'a mut Finish<'b>,
}

impl Kernel for Finished<'_, '_> {
    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) {
        // SAFETY: `Rows::finish` has checked the slices.
        unsafe {
            for panel in (0..padded(self.columns)).step_by(PANEL) {
                let width = (padded(self.columns) - panel).min(PANEL);
                match width == PANEL {
                    true if S::WIDE => self.panel::<S, 6, 4>(simd, panel),
                    false if S::WIDE => self.panel::<S, 12, 2>(simd, panel),
                    _ => {
                        for column in (panel..panel + width).step_by(LANES) {
                            self.panel::<S, 4, 1>(simd, column);
                        }
                    }
                }
            }
        }
    }
}

impl Finished<'_, '_> {
    #[inline(always)]
    unsafe fn panel<S: Simd, const MR: usize, const NV: usize>(&mut self, simd: S, column: usize) {
        let mut row = 0;
        // SAFETY: as in `run`.
        unsafe {
            while row + MR <= self.rows {
                self.block::<S, MR, NV>(simd, row, column);
                row += MR;
            }
            while row + 4 <= self.rows {
                self.block::<S, 4, NV>(simd, row, column);
                row += 4;
            }
            while row + 2 <= self.rows {
                self.block::<S, 2, NV>(simd, row, column);
                row += 2;
            }
            if row < self.rows {
                self.block::<S, 1, NV>(simd, row, column);
            }
        }
    }

    #[inline(always)]
    unsafe fn block<S: Simd, const MR: usize, const NV: usize>(&mut self, simd: S, row: usize, column: usize) {
        // SAFETY: as in `run`.
        unsafe {
            let sums = self.sums::<S, MR, NV>(simd, row, column);
            let goes_on = self.rows == 1 && matches!(self.from, Rows::Products(_));
            // Two rows at a time, so that a row's numbers stay in registers.
            for r in (0..MR / 2 * 2).step_by(2) {
                let mut pair = [sums[r], sums[r + 1]];
                self.to.block::<S, 2, NV>(simd, &mut pair, (row + r, column), self.columns, goes_on);
            }
            if MR % 2 == 1 {
                self.to.block::<S, 1, NV>(simd, &mut [sums[MR - 1]], (row + MR - 1, column), self.columns, goes_on);
            }
        }
    }

    #[inline(always)]
    unsafe fn sums<S: Simd, const MR: usize, const NV: usize>(
        &self,
        simd: S,
        row: usize,
        column: usize,
    ) -> Block<S, MR, NV> {
        // SAFETY: as in `run`.
        unsafe {
            let mut sums = [[simd.splat(0.0); NV]; MR];
            match self.from {
                // A single row has a single sum, which starts from the content of `out`.
                Rows::Products(sources) if self.rows == 1 => {
                    if let Some(out) = self.to.out.as_ref().filter(|out| out.accumulate) {
                        sums[0] = given(simd, &out.values[..self.columns], column);
                    }
                    for source in sources {
                        source.multiply::<S, MR, NV>(simd, &mut sums, row, column);
                    }
                    sums
                }
                Rows::Products(sources) => {
                    let Some((last, others)) = sources.split_last() else { return sums };
                    // Sums of the other sources wait in memory: registers hold those of one source.
                    let mut room = MaybeUninit::<Block<S, MR, NV>>::uninit();
                    let waiting = std::hint::black_box(room.as_mut_ptr());
                    for (i, source) in others.iter().enumerate() {
                        let mut of_source = [[simd.splat(0.0); NV]; MR];
                        source.multiply::<S, MR, NV>(simd, &mut of_source, row, column);
                        if i > 0 {
                            add_block::<S, MR, NV>(simd, &mut of_source, &*waiting);
                        }
                        waiting.write(of_source);
                    }
                    last.multiply::<S, MR, NV>(simd, &mut sums, row, column);
                    if !others.is_empty() {
                        add_block::<S, MR, NV>(simd, &mut sums, &*waiting);
                    }
                    sums
                }
                from => from.rows::<S, MR, NV>(simd, row, column, self.columns),
            }
        }
    }
}

impl Rows<'_> {
    /// Finishes rows that are no products.
    #[inline(always)]
    unsafe fn rows<S: Simd, const MR: usize, const NV: usize>(
        self,
        simd: S,
        row: usize,
        column: usize,
        columns: usize,
    ) -> Block<S, MR, NV> {
        let mut sums = [[simd.splat(0.0); NV]; MR];
        for (r, sums) in sums.iter_mut().enumerate() {
            let row = row + r;
            // SAFETY: `check` has seen that the slices have these rows and columns.
            unsafe {
                match self {
                    Rows::Products(_) => {}
                    Rows::Few { dz, weights, outputs } => {
                        for o in 0..outputs {
                            let scale = simd.splat(*dz.as_ptr().add(row * outputs + o));
                            let weights = weights.as_ptr().add(o * padded(columns) + column);
                            for v in 0..NV {
                                sums[v] = simd.add(sums[v], simd.mul(scale, load(simd, weights.add(LANES * v))));
                            }
                        }
                    }
                    Rows::Given(values) => *sums = given(simd, &values[row * columns..][..columns], column),
                    Rows::Chosen(values, chosen) => {
                        *sums = given(simd, &values[chosen[row] * columns..][..columns], column);
                    }
                    Rows::Panels(panels) => {
                        let from = panels.at(row, column);
                        for v in 0..NV {
                            sums[v] = load(simd, from.add(LANES * v));
                        }
                    }
                }
            }
        }
        sums
    }
}

#[inline(always)]
pub(super) fn add_block<S: Simd, const MR: usize, const NV: usize>(
    simd: S,
    sums: &mut Block<S, MR, NV>,
    others: &Block<S, MR, NV>,
) {
    for r in 0..MR {
        for v in 0..NV {
            sums[r][v] = simd.add(sums[r][v], others[r][v]);
        }
    }
}

impl Source<'_> {
    #[inline(always)]
    unsafe fn multiply<S: Simd, const MR: usize, const NV: usize>(
        &self,
        simd: S,
        sums: &mut Block<S, MR, NV>,
        row: usize,
        column: usize,
    ) {
        let inputs = self.weights.inputs;
        // SAFETY: left side and weights have these rows, inputs and outputs.
        unsafe {
            match self.lhs {
                Lhs::Rows(values) => {
                    let left = (values.as_ptr().add(row * inputs), inputs, 1);
                    multiply_add::<S, false, MR, NV>(simd, sums, left, self.weights.at(column, 0), inputs);
                }
                Lhs::Panels(panels) => {
                    for input in (0..inputs).step_by(PANEL) {
                        let count = (inputs - input).min(PANEL);
                        let left = (panels.at(row, input), panels.shape.step(input), 1);
                        let weights = self.weights.at(column, input);
                        if self.weights.pairs {
                            multiply_add::<S, true, MR, NV>(simd, sums, left, weights, count.div_ceil(2));
                        } else {
                            multiply_add::<S, false, MR, NV>(simd, sums, left, weights, count);
                        }
                    }
                }
            }
        }
    }
}

/// Adds to `sums [MR, NV vectors]` the products of `steps` words of each row of `a` with vectors of `b`, step after
/// step. `a`: its start, and the words to the next row and step. `b`: its start, and the words to the next step.
#[inline(always)]
pub(super) unsafe fn multiply_add<S: Simd, const PAIRS: bool, const MR: usize, const NV: usize>(
    simd: S,
    sums: &mut Block<S, MR, NV>,
    (a, a_row, a_step): (*const f32, usize, usize),
    (b, b_step): (*const f32, usize),
    steps: usize,
) {
    let (mut a, mut b, mut block) = (a, b, *sums);
    // SAFETY: both sides have these words.
    unsafe {
        for _ in 0..steps {
            let mut right = [simd.splat(0.0); NV];
            for v in 0..NV {
                right[v] = load(simd, b.add(LANES * v));
            }
            for r in 0..MR {
                let left = simd.splat(*a.add(r * a_row));
                for v in 0..NV {
                    block[r][v] = match PAIRS {
                        true => simd.dot_pairs(left, right[v], block[r][v]),
                        false => simd.mul_add(left, right[v], block[r][v]),
                    };
                }
            }
            (a, b) = (a.wrapping_add(a_step), b.wrapping_add(b_step));
        }
    }
    *sums = block;
}
