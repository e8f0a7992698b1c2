//! Operations on grids: convolutions, interpolation between cells, ray marching, alpha compositing.
//!
//! Grids are tensors with channels last, `[z, y, x, channels]`. Operations consist of candle's own, except where a
//! training would become more than 1.5 times as long: convolutions, normalization and marching have a fast path on the
//! CPU, with its own backward pass whose sums have a fixed order. The plain path of the first two in candle's operations
//! serves other devices, and is the reference for tests.

pub mod alpha_over;
pub mod blend_views;
pub mod conv3d;
pub mod march;
pub mod norm;
pub mod planes;
#[cfg(test)]
pub(crate) mod reference;
pub mod softplus;
pub mod trilinear;
pub mod upsample;
mod values;
pub mod variation;
