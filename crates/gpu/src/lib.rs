//! Training and rendering of NeRF and Aug-NeRF on any GPU, by WGSL kernels through wgpu.
//!
//! A run's parameters, moments, samples and gradients stay on the device. A step sends its rays and reads its losses.

#![warn(missing_docs)]

mod device;
mod kernels;
mod network;
mod record;
mod renderer;
mod sets;
mod step;

pub use device::{Adapter, Gpu, adapters};
pub use renderer::GpuRenderer;
pub use step::{Report, Steps, check};
