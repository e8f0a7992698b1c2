//! Kernels on tiles: products with their finishing operations, weight gradients, heads, and passes over rows. Each uses
//! one thread. The CPU's widest instructions are chosen at run time, and change no bit.

#![allow(
    clippy::needless_range_loop,
    reason = "rows and vectors of a block are counted: several blocks, and addresses, go by them"
)]

mod finish;
mod gradients;
mod heads;
pub mod panels;
pub mod product;
mod rows;
#[cfg(test)]
mod tests;

pub use gradients::{bias_gradient, weight_gradient};
pub use heads::{Head, head_forward, head_gradient};
pub use rows::{
    Matrix, add_bias, add_bias_relu, add_rows, few_forward, few_input_gradient, few_weight_gradient, mask_where_zero,
    multiply, scale_rows,
};

use crate::simd::{Kernel, Lanes, Processor, Simd};

/// Runs a kernel in the widest instructions.
fn launch(kernel: impl Kernel) {
    Processor::here().run_pairs(kernel);
}

/// # Safety
/// There must be a vector's numbers.
#[inline(always)]
unsafe fn load<S: Simd>(simd: S, from: *const f32) -> S::Floats {
    // SAFETY: as the caller promises.
    simd.load(unsafe { &*from.cast::<Lanes>() })
}

/// # Safety
/// There must be room for a vector's numbers.
#[inline(always)]
unsafe fn store<S: Simd>(simd: S, to: *mut f32, v: S::Floats) {
    // SAFETY: as the caller promises.
    unsafe { to.cast::<Lanes>().write(simd.store(v)) }
}
