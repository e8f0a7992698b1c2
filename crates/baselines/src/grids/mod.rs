//! Operations on lattices: products over neighbouring cells, values between cells, images of volumes.
//!
//! Lattices are tensors with channels last, `[z, y, x, channels]`. Each operation has a fast path on processors, with a
//! backward pass of its own whose sums have a fixed order, and a plain one in candle's terms for other devices, which tests
//! hold it to.

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
