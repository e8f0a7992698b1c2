//! Layer normalization with ReLU of rows in panels, over the channels of each.

use crate::srn::network::EPSILON;
use augnerf_fast::fused::kernels::panels::{PANEL, Shape, Slab};
use augnerf_fast::simd::{LANES, vectorized};

use super::weights::Block;

/// Returns the range of a row's numbers from `column` to the end of its panel.
#[inline(always)]
fn piece(shape: Shape, row: usize, column: usize) -> std::ops::Range<usize> {
    let start = shape.offset(row, column);
    start..start + PANEL.min(shape.columns - column)
}

/// Adds `term` of two rows' numbers.
#[inline(always)]
fn accumulate(lanes: &mut [f32; LANES], a: &[f32], b: &[f32], term: impl Fn(f32, f32) -> f32) {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    for (a, b) in a.iter().zip(b) {
        for ((lane, a), b) in lanes.iter_mut().zip(a).zip(b) {
            *lane += term(*a, *b);
        }
    }
    for ((lane, a), b) in lanes.iter_mut().zip(a_rest).zip(b_rest) {
        *lane += term(*a, *b);
    }
}

#[inline(always)]
fn total(lanes: [f32; LANES]) -> f32 {
    let mut sums = lanes;
    for half in [8, 4, 2, 1] {
        for i in 0..half {
            sums[i] += sums[i + half];
        }
    }
    sums[0]
}

#[inline(always)]
fn row_sum(words: &[f32], shape: Shape, row: usize, term: impl Fn(f32) -> f32) -> f32 {
    let mut lanes = [0f32; LANES];
    for column in (0..shape.columns).step_by(PANEL) {
        let values = &words[piece(shape, row, column)];
        accumulate(&mut lanes, values, values, |value, _| term(value));
    }
    total(lanes)
}

/// Normalizes `rows` rows of `x` in place, and leaves the layer's output in `y`. `inverse` receives 1 over each row's
/// deviation.
pub(super) fn forward(block: &Block, rows: usize, x: &mut Slab, inverse: &mut [f32], y: &mut Slab) {
    let (x, y) = (x.rows_mut(0), y.rows_mut(0));
    let (shape, y_shape) = (x.shape, y.shape);
    let (x, y) = (x.words, y.words);
    let share = 1.0 / shape.columns as f32;
    vectorized(
        #[inline(always)]
        || {
            for (row, inverse) in inverse[..rows].iter_mut().enumerate() {
                let mean = row_sum(x, shape, row, |value| value) * share;
                let variance = row_sum(x, shape, row, |value| (value - mean) * (value - mean)) * share;
                *inverse = 1.0 / (variance + EPSILON as f32).sqrt();
                for column in (0..shape.columns).step_by(PANEL) {
                    let x = &mut x[piece(shape, row, column)];
                    let y = &mut y[piece(y_shape, row, column)];
                    x.iter_mut().for_each(|value| *value = (*value - mean) * *inverse);
                    activate(block, column, x, y);
                }
            }
        },
    );
}

/// Computes a layer's output from the normalized numbers, from `column` on. NaN stays NaN, to be found and reported.
#[inline(always)]
fn activate(block: &Block, column: usize, normal: &[f32], y: &mut [f32]) {
    for ((y, normal), (scale, shift)) in
        y.iter_mut().zip(normal).zip(block.scale[column..].iter().zip(&block.shift[column..]))
    {
        let value = normal * scale + shift;
        *y = if value < 0.0 { 0.0 } else { value };
    }
}

/// Recomputes the output of a layer.
pub(super) fn again(block: &Block, rows: usize, normal: &Slab, y: &mut Slab) {
    let (normal, y) = (normal.rows(0), y.rows_mut(0));
    let (shape, y_shape, y) = (normal.shape, y.shape, y.words);
    vectorized(
        #[inline(always)]
        || {
            for row in 0..rows {
                for column in (0..shape.columns).step_by(PANEL) {
                    activate(
                        block,
                        column,
                        &normal.words[piece(shape, row, column)],
                        &mut y[piece(y_shape, row, column)],
                    );
                }
            }
        },
    );
}

/// Replaces the gradient of a layer's output in `gradient` by that of its product, and adds those of scale and shift.
pub(super) fn backward(
    block: &Block,
    rows: usize,
    (normal, inverse): (&Slab, &[f32]),
    gradient: &mut Slab,
    (d_scale, d_shift): (&mut [f32], &mut [f32]),
) {
    let (normal, gradient) = (normal.rows(0), gradient.rows_mut(0));
    let (shape, gradient_shape, gradient) = (normal.shape, gradient.shape, gradient.words);
    let share = 1.0 / shape.columns as f32;
    vectorized(
        #[inline(always)]
        || {
            for (row, inverse) in inverse[..rows].iter().enumerate() {
                let (mut of_e, mut of_e_n) = ([0f32; LANES], [0f32; LANES]);
                for column in (0..shape.columns).step_by(PANEL) {
                    let (n, e) =
                        (&normal.words[piece(shape, row, column)], &mut gradient[piece(gradient_shape, row, column)]);
                    let numbers = e.iter_mut().zip(n).zip(block.scale[column..].iter().zip(&block.shift[column..]));
                    let sums = d_scale[column..].iter_mut().zip(&mut d_shift[column..]);
                    for (((e, n), (scale, shift)), (d_scale, d_shift)) in numbers.zip(sums) {
                        let masked = if n * scale + shift > 0.0 { *e } else { 0.0 };
                        *d_shift += masked;
                        *d_scale += masked * n;
                        *e = masked * scale;
                    }
                    accumulate(&mut of_e, e, n, |e, _| e);
                    accumulate(&mut of_e_n, e, n, |e, n| e * n);
                }
                let (of_e, of_e_n) = (total(of_e) * share, total(of_e_n) * share);
                for column in (0..shape.columns).step_by(PANEL) {
                    let (n, e) =
                        (&normal.words[piece(shape, row, column)], &mut gradient[piece(gradient_shape, row, column)]);
                    e.iter_mut().zip(n).for_each(|(e, n)| *e = (*e - of_e - n * of_e_n) * inverse);
                }
            }
        },
    );
}
