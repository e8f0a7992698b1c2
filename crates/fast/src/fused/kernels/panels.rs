//! The memory layout of a layer's rows: panels of 64 columns, each row by row. The last panel has 32 columns if that is
//! enough. A product then reads its left side and writes its result without packing. The weight gradient finds 64
//! neighbours of every row in one stream.

use std::ops::{Deref, DerefMut};

use crate::fused::pool::{Buffer, Pooled};
use crate::simd::{vectorized, word};

/// Columns of a panel.
pub const PANEL: usize = 64;
/// Columns are padded to a multiple of this.
const STEP: usize = 32;

/// Returns the number of columns, padded to full panels.
pub fn padded(columns: usize) -> usize {
    columns.next_multiple_of(STEP)
}

/// The content of a word.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Form {
    /// An f32.
    #[default]
    Single,
    /// bf16 of two neighbours in a row: for the left side of a product.
    Across,
    /// bf16 of two neighbours in a column: for both sides of a weight gradient.
    Down,
}

/// Form and size of rows in panels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
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

/// The content of a buffer.
pub trait Word: Pooled {
    /// Numbers of a row that share a word, for [`Form::Single`].
    const NUMBERS: usize;
}

impl Word for f32 {
    const NUMBERS: usize = 1;
}

impl Word for u16 {
    const NUMBERS: usize = 16;
}

/// A table in panels.
#[derive(Default)]
pub struct Table<W: Word> {
    words: Buffer<W>,
    shape: Shape,
}

/// Rows in panels.
pub type Slab = Table<f32>;
/// A bit for each number of rows in panels.
pub type Masks = Table<u16>;

impl<W: Word> Table<W> {
    /// Allocates rows with arbitrary content.
    pub fn new(form: Form, rows: usize, columns: usize) -> Table<W> {
        let shape = Shape { form, rows, columns };
        Table { words: Buffer::new(shape.words() / W::NUMBERS), shape }
    }

    /// Returns the content of its words.
    pub fn form(&self) -> Form {
        self.shape.form
    }

    /// Returns whether it has no rows.
    pub fn is_empty(&self) -> bool {
        self.words.is_empty()
    }

    /// Returns the rows from `start` on.
    pub fn rows(&self, start: usize) -> View<&[W]> {
        View { words: &self.words, shape: self.shape, start }
    }

    /// Returns the rows from `start` on, mutably.
    pub fn rows_mut(&mut self, start: usize) -> View<&mut [W]> {
        View { words: &mut self.words, shape: self.shape, start }
    }
}

/// A table from row `start` on.
#[derive(Clone, Copy)]
pub struct View<T> {
    /// The words of all rows.
    pub words: T,
    /// The shape of all rows.
    pub shape: Shape,
    /// The first row.
    pub start: usize,
}

/// Rows in panels, from row `start` on.
pub type Panels<'a> = View<&'a [f32]>;
/// Mutable rows in panels, from row `start` on.
pub type PanelsMut<'a> = View<&'a mut [f32]>;

impl<W: Word, T: Deref<Target = [W]>> View<T> {
    /// Returns whether there are `rows` rows that begin with a complete word.
    pub fn fits(&self, rows: usize, columns: usize) -> bool {
        let (shape, start) = (self.shape, self.start);
        let whole = shape.form != Form::Down || start.is_multiple_of(2);
        let words = W::NUMBERS * self.words.len();
        whole && shape.columns == columns && start + rows <= shape.rows && shape.words() <= words
    }

    /// Returns the address of the word with a row's number at `column`.
    #[inline(always)]
    pub fn at(&self, row: usize, column: usize) -> *const W {
        self.words.as_ptr().wrapping_add(self.shape.offset(self.start + row, column) / W::NUMBERS)
    }

    /// Returns the address of the word with a row's number at `column`.
    #[inline(always)]
    pub fn at_mut(&mut self, row: usize, column: usize) -> *mut W
    where
        T: DerefMut,
    {
        self.words.as_mut_ptr().wrapping_add(self.shape.offset(self.start + row, column) / W::NUMBERS)
    }
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
        match all.shape.form {
            Form::Down => gathered(&mut self.slab, all, rows, pair_rows),
            Form::Single | Form::Across => gathered(&mut self.slab, all, rows, copy_rows),
        }
    }

    /// Returns the same rows of masks.
    pub fn masks<'a>(&'a mut self, all: &'a Masks, rows: &[usize]) -> View<&'a [u16]> {
        gathered(&mut self.masks, all, rows, copy_rows)
    }
}

/// Returns rows of `all`, in place if they are neighbours, or in `room` where `fill` writes those of a panel.
fn gathered<'a, W: Word>(
    room: &'a mut Table<W>,
    all: &'a Table<W>,
    rows: &[usize],
    fill: impl Fn(&Table<W>, &[usize], usize, &mut [W]),
) -> View<&'a [W]> {
    let (first, last, shape) = (rows[0], rows[rows.len() - 1], all.shape);
    let whole = shape.form != Form::Down || first.is_multiple_of(2);
    if all.is_empty() || (whole && last - first + 1 == rows.len()) {
        return all.rows(first);
    }
    let to = Shape { rows: rows.len().next_multiple_of(2), ..shape };
    if room.shape != to {
        *room = Table::new(to.form, to.rows, to.columns);
    }
    for column in (0..padded(shape.columns)).step_by(PANEL) {
        fill(all, rows, column, &mut room.words[to.offset(0, column) / W::NUMBERS..]);
    }
    room.rows(0)
}

fn copy_rows<W: Word>(all: &Table<W>, rows: &[usize], column: usize, out: &mut [W]) {
    let step = all.shape.step(column) / W::NUMBERS;
    for (row, out) in rows.iter().zip(out.chunks_exact_mut(step)) {
        out.copy_from_slice(&all.words[all.shape.offset(*row, column) / W::NUMBERS..][..step]);
    }
}

fn pair_rows(all: &Slab, rows: &[usize], column: usize, out: &mut [f32]) {
    let width = all.shape.width(column);
    for (pair, out) in rows.chunks(2).zip(out.chunks_exact_mut(width)) {
        let of = |row: usize| (&all.words[all.shape.offset(row, column)..][..width], row % 2 == 1);
        pair_up(of(pair[0]), pair.get(1).map(|row| of(*row)), out);
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
                        true => {
                            let second = if 2 * step + 1 < inputs { at(2 * step + 1) } else { 0.0 };
                            word(at(2 * step), second)
                        }
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
