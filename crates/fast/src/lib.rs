//! Kernels for CPUs, in place of candle's operations. `augnerf-nerf` has each in candle's own operations, to which its tests
//! compare them, and which compute f64 and other devices. Callers ask [`augnerf_base::place`] first. Operations of the hash
//! grid's points are in `augnerf-nerf`.
//!
//! | kernel | in place of |
//! |---|---|
//! | [`encoding`] | `encode`, `encode_integrated` |
//! | [`fused`] | a field's layers, forward and backward, and the slope of its density |
//! | [`hash`] | the hash grid, its derivatives and its tables' Adam |
//! | [`inside`] | the density of empty space around a grid |
//! | [`scan`] | `composite` |
//! | [`adam`] | `Adam::update` |
//! | [`simd`] | what all of them compute with |

#![warn(missing_docs)]

pub mod adam;
pub mod encoding;
pub mod fused;
pub mod hash;
pub mod inside;
mod peak;
pub mod scan;
pub mod simd;

pub use peak::peak_gflops;
