//! The memory layout of a layer's rows: panels of 64 columns, each row by row. The last panel has 32 columns if that is
//! enough. A product then reads its left side and writes its result without packing. The weight gradient finds 64
//! neighbours of every row in one stream.

use super::simd::{round, word};
use crate::base::simd::vectorized;
use crate::field::fused::pool::Buffer;

/// Columns of a panel.
pub const PANEL: usize = 64;
/// Columns are padded to a multiple of this.
const STEP: usize = 32;

/// Returns the number of columns, padded to full panels.
pub fn padded(columns: usize) -> usize {
    columns.next_multiple_of(STEP)
}

/// The content of a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// An f32.
    Single,
    /// bf16 of two neighbours in a row: for the left side of a product.
    Across,
    /// bf16 of two neighbours in a column: for both sides of a weight gradient.
    Down,
}

/// Form and size of rows in panels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// The content of a word.
    pub form: Form,
    /// Number of rows.
    pub rows: usize,
    /// Number of columns, without padding.
    pub columns: usize,
}

impl Shape {
    /// Returns the number of words, including padding.
    pub fn words(self) -> usize {
        let columns = padded(self.columns);
        match self.form {
            Form::Single => columns * self.rows,
            Form::Across => columns * self.rows / 2,
            Form::Down => columns * self.rows.div_ceil(2),
        }
    }

    /// Returns the number of columns of the panel with `column`.
    #[inline(always)]
    pub fn width(self, column: usize) -> usize {
        (padded(self.columns) - column / PANEL * PANEL).min(PANEL)
    }

    /// Returns the words from a row, or pair of rows, to the next within the panel of `column`.
    #[inline(always)]
    pub fn step(self, column: usize) -> usize {
        if self.form == Form::Across { self.width(column) / 2 } else { self.width(column) }
    }

    /// Returns the offset of a row's words from `column` on. Both must be even if two numbers share a word.
    #[inline(always)]
    pub fn offset(self, row: usize, column: usize) -> usize {
        let (panel, inner) = (column / PANEL * PANEL, column % PANEL);
        match self.form {
            Form::Single => panel * self.rows + row * self.width(column) + inner,
            Form::Across => (panel * self.rows + row * self.width(column) + inner) / 2,
            Form::Down => panel * self.rows.div_ceil(2) + row / 2 * self.width(column) + inner,
        }
    }
}

/// Rows in panels.
#[derive(Default)]
pub struct Slab {
    words: Buffer<f32>,
    shape: Option<Shape>,
}

impl Slab {
    /// Allocates rows with arbitrary content.
    pub fn new(form: Form, rows: usize, columns: usize) -> Slab {
        let shape = Shape { form, rows, columns };
        Slab { words: Buffer::new(shape.words()), shape: Some(shape) }
    }

    /// Returns the content of its words.
    pub fn form(&self) -> Form {
        self.shape.unwrap_or(EMPTY).form
    }

    /// Returns whether it has no rows.
    pub fn is_empty(&self) -> bool {
        self.words.is_empty()
    }

    /// Returns the rows from `start` on.
    pub fn rows(&self, start: usize) -> Panels<'_> {
        Panels { words: &self.words, shape: self.shape.unwrap_or(EMPTY), start }
    }

    /// Returns the rows from `start` on, mutably.
    pub fn rows_mut(&mut self, start: usize) -> PanelsMut<'_> {
        PanelsMut { words: &mut self.words, shape: self.shape.unwrap_or(EMPTY), start }
    }
}

const EMPTY: Shape = Shape { form: Form::Single, rows: 0, columns: 0 };

/// Rows in panels, from row `start` on.
#[derive(Clone, Copy)]
pub struct Panels<'a> {
    /// The words of all rows.
    pub words: &'a [f32],
    /// The shape of all rows.
    pub shape: Shape,
    /// The first row.
    pub start: usize,
}

/// Mutable rows in panels, from row `start` on.
pub struct PanelsMut<'a> {
    /// The words of all rows.
    pub words: &'a mut [f32],
    /// The shape of all rows.
    pub shape: Shape,
    /// The first row.
    pub start: usize,
}

impl Panels<'_> {
    /// Returns whether there are `rows` rows that begin with a complete word.
    pub fn fits(&self, rows: usize, columns: usize) -> bool {
        fits(self.words.len(), self.shape, (self.start, rows), columns)
    }

    /// Returns the address of the word with a row's number at `column`.
    #[inline(always)]
    pub fn at(&self, row: usize, column: usize) -> *const f32 {
        self.words.as_ptr().wrapping_add(self.shape.offset(self.start + row, column))
    }
}

impl PanelsMut<'_> {
    /// Returns whether there are `rows` rows that begin with a complete word.
    pub fn fits(&self, rows: usize, columns: usize) -> bool {
        fits(self.words.len(), self.shape, (self.start, rows), columns)
    }

    /// Returns the address of the word with a row's number at `column`.
    #[inline(always)]
    pub fn at(&mut self, row: usize, column: usize) -> *mut f32 {
        self.words.as_mut_ptr().wrapping_add(self.shape.offset(self.start + row, column))
    }
}

fn fits(words: usize, shape: Shape, (start, rows): (usize, usize), columns: usize) -> bool {
    let whole = shape.form != Form::Down || start.is_multiple_of(2);
    whole && shape.columns == columns && start + rows <= shape.rows && shape.words() <= words
}

/// A bit for each number of rows in panels.
#[derive(Default)]
pub struct Masks {
    bits: Buffer<u16>,
    shape: Option<Shape>,
}

impl Masks {
    /// Allocates masks with arbitrary content.
    pub fn new(rows: usize, columns: usize) -> Masks {
        let shape = Shape { form: Form::Single, rows, columns };
        Masks { bits: Buffer::new(shape.words() / 16), shape: Some(shape) }
    }

    /// Returns the masks from row `start` on.
    pub fn rows(&self, start: usize) -> Bits<'_> {
        Bits { bits: &self.bits, shape: self.shape.unwrap_or(EMPTY), start }
    }

    /// Returns the masks from row `start` on, mutably.
    pub fn rows_mut(&mut self, start: usize) -> BitsMut<'_> {
        BitsMut { bits: &mut self.bits, shape: self.shape.unwrap_or(EMPTY), start }
    }
}

/// Masks from row `start` on.
#[derive(Clone, Copy)]
pub struct Bits<'a> {
    /// The bits of all rows.
    pub bits: &'a [u16],
    /// The shape of all rows.
    pub shape: Shape,
    /// The first row.
    pub start: usize,
}

/// Mutable masks from row `start` on.
pub struct BitsMut<'a> {
    /// The bits of all rows.
    pub bits: &'a mut [u16],
    /// The shape of all rows.
    pub shape: Shape,
    /// The first row.
    pub start: usize,
}

impl Bits<'_> {
    /// Returns whether there are bits for `rows` rows.
    pub fn fits(&self, rows: usize, columns: usize) -> bool {
        fits(16 * self.bits.len(), self.shape, (self.start, rows), columns)
    }

    /// Returns the address of a row's bits from `column` on.
    #[inline(always)]
    pub fn at(&self, row: usize, column: usize) -> *const u16 {
        self.bits.as_ptr().wrapping_add(self.shape.offset(self.start + row, column) / 16)
    }
}

impl BitsMut<'_> {
    /// Returns whether there are bits for `rows` rows.
    pub fn fits(&self, rows: usize, columns: usize) -> bool {
        fits(16 * self.bits.len(), self.shape, (self.start, rows), columns)
    }

    /// Returns the address of a row's bits from `column` on.
    #[inline(always)]
    pub fn at(&mut self, row: usize, column: usize) -> *mut u16 {
        self.bits.as_mut_ptr().wrapping_add(self.shape.offset(self.start + row, column) / 16)
    }
}

/// Returns whether rows are consecutive and can be read in place.
fn neighbours(rows: &[usize], form: Form) -> bool {
    let (first, last) = (rows[0], rows[rows.len() - 1]);
    last - first + 1 == rows.len() && (form != Form::Down || first.is_multiple_of(2))
}

/// Space for gathered rows.
#[derive(Default)]
pub struct Gathered {
    slab: Slab,
    masks: Masks,
}

impl Gathered {
    /// Returns the rows `rows` (ascending, at least one) of `all`, in place or gathered.
    pub fn rows<'a>(&'a mut self, all: &'a Slab, rows: &[usize]) -> Panels<'a> {
        let Some(shape) = all.shape else { return all.rows(0) };
        if neighbours(rows, shape.form) {
            return all.rows(rows[0]);
        }
        let to = Shape { rows: rows.len().next_multiple_of(2), ..shape };
        if self.slab.shape != Some(to) {
            self.slab = Slab::new(to.form, to.rows, to.columns);
        }
        for column in (0..padded(shape.columns)).step_by(PANEL) {
            let width = shape.width(column);
            let out = &mut self.slab.words[to.offset(0, column)..];
            match shape.form {
                Form::Down => {
                    for (pair, out) in rows.chunks(2).zip(out.chunks_exact_mut(width)) {
                        let of = |row: usize| (&all.words[shape.offset(row, column)..][..width], row % 2 == 1);
                        pair_up(of(pair[0]), pair.get(1).map(|row| of(*row)), out);
                    }
                }
                Form::Single | Form::Across => {
                    let step = shape.step(column);
                    for (row, out) in rows.iter().zip(out.chunks_exact_mut(step)) {
                        out.copy_from_slice(&all.words[shape.offset(*row, column)..][..step]);
                    }
                }
            }
        }
        self.slab.rows(0)
    }

    /// Returns the same rows of masks.
    pub fn masks<'a>(&'a mut self, all: &'a Masks, rows: &[usize]) -> Bits<'a> {
        let Some(shape) = all.shape else { return all.rows(0) };
        if neighbours(rows, Form::Single) {
            return all.rows(rows[0]);
        }
        let to = Shape { rows: rows.len(), ..shape };
        if self.masks.shape != Some(to) {
            self.masks = Masks::new(to.rows, to.columns);
        }
        for column in (0..padded(shape.columns)).step_by(PANEL) {
            let width = shape.width(column) / 16;
            let out = self.masks.bits[to.offset(0, column) / 16..].chunks_exact_mut(width);
            for (row, out) in rows.iter().zip(out) {
                out.copy_from_slice(&all.bits[shape.offset(*row, column) / 16..][..width]);
            }
        }
        self.masks.rows(0)
    }
}

/// Pairs one half of each word of `a` with one of `b`. The flags choose the second half.
fn pair_up((a, a_second): (&[f32], bool), b: Option<(&[f32], bool)>, out: &mut [f32]) {
    let half = |word: f32, second: bool| word.to_bits() >> (16 * u32::from(second)) & 0xffff;
    vectorized(
        #[inline(always)]
        || match b {
            Some((b, b_second)) => {
                for ((out, a), b) in out.iter_mut().zip(a).zip(b) {
                    *out = f32::from_bits(half(*a, a_second) | half(*b, b_second) << 16);
                }
            }
            None => out.iter_mut().zip(a).for_each(|(out, a)| *out = f32::from_bits(half(*a, a_second))),
        },
    );
}

/// Weights in the order of a product: for each panel of outputs, input after input.
#[derive(Default)]
pub struct Packed {
    /// The words, padded to full panels.
    pub words: Buffer<f32>,
    /// Whether two inputs share a word, as bf16.
    pub pairs: bool,
    /// Number of outputs.
    pub outputs: usize,
    /// Number of inputs.
    pub inputs: usize,
}

impl Packed {
    /// Packs weights whose number for output `o` and input `i` is `weights[o * output_stride + i * input_stride]`.
    pub fn new(
        pairs: bool,
        (outputs, output_stride): (usize, usize),
        (inputs, input_stride): (usize, usize),
        weights: &[f32],
    ) -> Packed {
        let steps = if pairs { inputs.div_ceil(2) } else { inputs };
        let shape = Shape { form: Form::Single, rows: steps, columns: outputs };
        let mut words = Buffer::new(shape.words());
        for panel in (0..padded(outputs)).step_by(PANEL) {
            let width = shape.width(panel);
            let rows = words[shape.offset(0, panel)..].chunks_exact_mut(width).take(steps);
            let given = width.min(outputs - panel);
            for (step, row) in rows.enumerate() {
                row[given..].fill(0.0);
                for (o, to) in row[..given].iter_mut().enumerate() {
                    let at = |i: usize| weights[(panel + o) * output_stride + i * input_stride];
                    *to = match pairs {
                        false => at(step),
                        true if 2 * step + 1 < inputs => word(at(2 * step), at(2 * step + 1)),
                        true => f32::from_bits(round(at(2 * step))),
                    };
                }
            }
        }
        Packed { words, pairs, outputs, inputs }
    }

    /// Returns the start of panel and input, and the words from one input of the panel to the next.
    #[inline(always)]
    pub fn at(&self, panel: usize, input: usize) -> (*const f32, usize) {
        let (steps, step) = if self.pairs { (self.inputs.div_ceil(2), input / 2) } else { (self.inputs, input) };
        let shape = Shape { form: Form::Single, rows: steps, columns: self.outputs };
        let panel_start = panel / PANEL * PANEL;
        (self.words.as_ptr().wrapping_add(shape.offset(step, panel_start) + panel % PANEL), shape.width(panel))
    }
}

/// Returns `values`, padded with zeros to full panels.
pub fn filled_up(values: &[f32]) -> Vec<f32> {
    let mut out = values.to_vec();
    out.resize(padded(values.len()), 0.0);
    out
}
