//! What tiles are made of: products of small row-major matrices and passes over their elements.
//! One thread each; the processor's widest instructions are chosen at run time.

use gemm::Parallelism;
use pulp::Arch;

use crate::field::work::count_multiply_adds;

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
    /// `rows x columns`, row after row, `stride` apart.
    pub fn new(values: &'a [f32], rows: usize, columns: usize, stride: usize) -> Matrix<'a> {
        Matrix { values, rows, columns, row_stride: stride, column_stride: 1 }
    }

    /// The same values with rows for columns.
    pub fn transposed(self) -> Matrix<'a> {
        Matrix {
            rows: self.columns,
            columns: self.rows,
            row_stride: self.column_stride,
            column_stride: self.row_stride,
            ..self
        }
    }

    /// Whether the last element lies within the slice.
    fn fits(&self) -> bool {
        self.rows == 0
            || self.columns == 0
            || (self.rows - 1) * self.row_stride + (self.columns - 1) * self.column_stride < self.values.len()
    }
}

/// `out = a b`, or `out += a b`, where `out` is row-major with rows `stride` apart.
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

/// Adds `bias` to every row.
pub fn add_bias(rows: &mut [f32], bias: &[f32]) {
    Arch::new().dispatch(|| {
        for row in rows.chunks_exact_mut(bias.len()) {
            for (value, b) in row.iter_mut().zip(bias) {
                *value += b;
            }
        }
    });
}

/// Adds `bias` to every row, then ReLU; `mask` is 1 where the sum was positive. NaN stays NaN, to be found and
/// reported.
pub fn add_bias_relu(rows: &mut [f32], bias: &[f32], mask: Option<&mut [u8]>) {
    let relu = |sum: f32| if sum < 0.0 { 0.0 } else { sum };
    Arch::new().dispatch(|| match mask {
        Some(mask) => {
            for (row, mask) in rows.chunks_exact_mut(bias.len()).zip(mask.chunks_exact_mut(bias.len())) {
                for ((value, b), mask) in row.iter_mut().zip(bias).zip(mask) {
                    let sum = *value + b;
                    *value = relu(sum);
                    *mask = u8::from(sum > 0.0);
                }
            }
        }
        None => {
            for row in rows.chunks_exact_mut(bias.len()) {
                for (value, b) in row.iter_mut().zip(bias) {
                    *value = relu(*value + b);
                }
            }
        }
    });
}

/// Puts 0 where the mask is 0.
pub fn apply_mask(values: &mut [f32], mask: &[u8]) {
    Arch::new().dispatch(|| {
        for (value, &mask) in values.iter_mut().zip(mask) {
            *value = if mask == 0 { 0.0 } else { *value };
        }
    });
}

/// `sum += values`, element by element.
pub fn add(sum: &mut [f32], values: &[f32]) {
    Arch::new().dispatch(|| {
        for (sum, value) in sum.iter_mut().zip(values) {
            *sum += value;
        }
    });
}

/// Adds every row to `sum`.
pub fn add_rows(sum: &mut [f32], rows: &[f32]) {
    Arch::new().dispatch(|| {
        for row in rows.chunks_exact(sum.len()) {
            for (sum, value) in sum.iter_mut().zip(row) {
                *sum += value;
            }
        }
    });
}
