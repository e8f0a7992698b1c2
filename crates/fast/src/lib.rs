//! Kernels for CPUs: encodings, the fused field, the hash grid, and vectors of sixteen numbers in the widest instructions of
//! the processor. They work on slices. `augnerf-nerf` has the same in candle's operations, to which tests compare them.

#![warn(missing_docs)]

pub mod encoding;
pub mod fused;
pub mod hash;
mod peak;
pub mod simd;

pub use peak::peak_gflops;
