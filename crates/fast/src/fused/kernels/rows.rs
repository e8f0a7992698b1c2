//! Products of small row-major matrices, and passes over their elements. Each uses one thread. The CPU's widest
//! instructions are chosen at run time.

use gemm::Parallelism;

use crate::simd::{LANES, vectorized};
use augnerf_base::machine::count_multiply_adds;

/// A read-only matrix inside a slice.
#[derive(Clone, Copy)]
pub struct Matrix<'a> {
    values: &'a [f32],
    rows: usize,
    columns: usize,
    row_stride: usize,
    column_stride: usize,
}

impl<'a> Matrix<'a> {
    /// Creates a matrix of `rows x columns`, row by row, `stride` apart.
    pub fn new(values: &'a [f32], rows: usize, columns: usize, stride: usize) -> Matrix<'a> {
        Matrix { values, rows, columns, row_stride: stride, column_stride: 1 }
    }

    /// Returns the transposed matrix over the same values.
    pub fn transposed(self) -> Matrix<'a> {
        Matrix {
            rows: self.columns,
            columns: self.rows,
            row_stride: self.column_stride,
            column_stride: self.row_stride,
            ..self
        }
    }

    /// Returns whether the last element is within the slice.
    fn fits(&self) -> bool {
        self.rows == 0
            || self.columns == 0
            || (self.rows - 1) * self.row_stride + (self.columns - 1) * self.column_stride < self.values.len()
    }
}

/// Computes `out = a b`, or `out += a b`, where `out` is row-major with rows `stride` apart.
pub fn multiply(out: &mut [f32], stride: usize, a: Matrix, b: Matrix, accumulate: bool) {
    let (m, n, k) = (a.rows, b.columns, a.columns);
    assert!(a.columns == b.rows && a.fits() && b.fits(), "matrices do not fit");
    assert!(m == 0 || n == 0 || (n <= stride && (m - 1) * stride + n <= out.len()), "the product does not fit");
    count_multiply_adds(m * n * k);
    // SAFETY: every index that the product reads or writes was checked to lie within its slice; `out` is borrowed
    // mutably, so that it overlaps neither operand.
    unsafe {
        gemm::gemm(
            m,
            n,
            k,
            out.as_mut_ptr(),
            1,
            stride as isize,
            accumulate,
            a.values.as_ptr(),
            a.column_stride as isize,
            a.row_stride as isize,
            b.values.as_ptr(),
            b.column_stride as isize,
            b.row_stride as isize,
            1.0,
            1.0,
            false,
            false,
            false,
            Parallelism::None,
        );
    }
}

/// Computes `y [rows, outputs] = x W^T` for few outputs, with `weight [outputs, columns]`: a dot product for each
/// number.
pub fn few_forward(x: &[f32], weight: &[f32], outputs: usize, y: &mut [f32]) {
    let columns = weight.len() / outputs;
    count_multiply_adds(y.len() * columns);
    vectorized(
        #[inline(always)]
        || {
            for (x, y) in x.chunks_exact(columns).zip(y.chunks_exact_mut(outputs)) {
                for (y, weight) in y.iter_mut().zip(weight.chunks_exact(columns)) {
                    *y = dot(x, weight);
                }
            }
        },
    );
}

/// Returns a dot product in [`LANES`] parallel sums.
#[inline(always)]
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0f32; LANES];
    let (a_blocks, a_rest) = a.as_chunks::<LANES>();
    let (b_blocks, b_rest) = b.as_chunks::<LANES>();
    for (a, b) in a_blocks.iter().zip(b_blocks) {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum += a * b;
        }
    }
    let rest: f32 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f32>() + rest
}

/// Computes `dx [rows, columns] = dz W`, or `dx += dz W`, for few outputs, `dz [rows, outputs]`.
pub fn few_input_gradient(dz: &[f32], weight: &[f32], outputs: usize, dx: &mut [f32], accumulate: bool) {
    let columns = weight.len() / outputs;
    count_multiply_adds(dz.len() * columns);
    vectorized(
        #[inline(always)]
        || {
            for (dz, dx) in dz.chunks_exact(outputs).zip(dx.chunks_exact_mut(columns)) {
                if !accumulate {
                    dx.fill(0.0);
                }
                for (dz, weight) in dz.iter().zip(weight.chunks_exact(columns)) {
                    add_scaled(dx, *dz, weight);
                }
            }
        },
    );
}

/// Adds `dz^T x` to `sum [outputs, columns]`, for few outputs.
pub fn few_weight_gradient(dz: &[f32], x: &[f32], outputs: usize, sum: &mut [f32]) {
    let columns = sum.len() / outputs;
    count_multiply_adds(dz.len() * columns);
    vectorized(
        #[inline(always)]
        || {
            for (dz, x) in dz.chunks_exact(outputs).zip(x.chunks_exact(columns)) {
                for (dz, sum) in dz.iter().zip(sum.chunks_exact_mut(columns)) {
                    add_scaled(sum, *dz, x);
                }
            }
        },
    );
}

#[inline(always)]
fn add_scaled(sum: &mut [f32], scale: f32, values: &[f32]) {
    for (sum, value) in sum.iter_mut().zip(values) {
        *sum += scale * value;
    }
}

/// Adds `bias` to every row.
pub fn add_bias(rows: &mut [f32], bias: &[f32]) {
    vectorized(
        #[inline(always)]
        || {
            for row in rows.chunks_exact_mut(bias.len()) {
                for (value, b) in row.iter_mut().zip(bias) {
                    *value += b;
                }
            }
        },
    );
}

/// Adds `bias` to every row, then applies ReLU. NaN stays NaN, to be found and reported.
pub fn add_bias_relu(rows: &mut [f32], bias: &[f32]) {
    vectorized(
        #[inline(always)]
        || {
            for row in rows.chunks_exact_mut(bias.len()) {
                for (value, b) in row.iter_mut().zip(bias) {
                    let sum = *value + b;
                    *value = if sum < 0.0 { 0.0 } else { sum };
                }
            }
        },
    );
}

/// Sets values to 0 where the other value is 0.
pub fn mask_where_zero(values: &mut [f32], others: &[f32]) {
    vectorized(
        #[inline(always)]
        || {
            for (value, &other) in values.iter_mut().zip(others) {
                *value = if other == 0.0 { 0.0 } else { *value };
            }
        },
    );
}

/// Computes `out = rows`, with each row times its number in `scales`.
pub fn scale_rows(rows: &[f32], scales: &[f32], out: &mut [f32]) {
    let columns = rows.len() / scales.len();
    vectorized(
        #[inline(always)]
        || {
            for ((row, out), scale) in rows.chunks_exact(columns).zip(out.chunks_exact_mut(columns)).zip(scales) {
                for (value, out) in row.iter().zip(out) {
                    *out = value * scale;
                }
            }
        },
    );
}

/// Adds every row to `sum`.
pub fn add_rows(sum: &mut [f32], rows: &[f32]) {
    vectorized(
        #[inline(always)]
        || {
            for row in rows.chunks_exact(sum.len()) {
                for (sum, value) in sum.iter_mut().zip(row) {
                    *sum += value;
                }
            }
        },
    );
}
