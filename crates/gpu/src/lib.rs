//! Training and rendering of NeRF and Aug-NeRF on any GPU, by WGSL kernels through wgpu.
//!
//! A run's parameters, moments, samples and gradients stay on the device. A step sends its rays and reads its losses.

#![warn(missing_docs)]

use augnerf_core::base::Result;
use augnerf_core::data::Scene;
use augnerf_core::field::{Density, Field};
use augnerf_core::methods::{Fields, Renderer, Stepper};
use augnerf_core::optimizer::Moments;
use augnerf_core::settings::{Config, Resolved};

mod density;
mod device;
mod kernels;
mod limits;
mod network;
mod rays;
mod record;
mod renderer;
mod sets;
mod step;
mod stepper;
mod tune;

pub use device::{Adapter, Gpu, adapters};
pub use limits::check;
pub use step::Steps;

/// Returns what trains fields on a device, with the moments of their parameters, or with 0.
///
/// # Errors
/// [`augnerf_core::base::Error::Config`]: the device does not train what the configuration asks for, or has too little memory.
pub fn stepper(
    gpu: &Gpu,
    config: &Resolved,
    scene: &Scene,
    fields: &Fields,
    moments: Option<Vec<Moments>>,
) -> Result<Box<dyn Stepper>> {
    Ok(Box::new(stepper::GpuStepper::new(gpu, config, scene, fields, moments)?))
}

/// Returns what renders fields with their current weights on a device.
///
/// # Errors
/// [`augnerf_core::base::Error::Config`]: the device does not render such fields, or has too little memory.
pub fn renderer(gpu: &Gpu, fields: &Fields, config: &Config, scene: &Scene) -> Result<Box<dyn Renderer>> {
    Ok(Box::new(renderer::GpuRenderer::new(gpu, fields, config, scene)?))
}

/// Returns the density of a field with its current weights on a device.
///
/// # Errors
/// [`augnerf_core::base::Error::Config`]: the device does not query such a field, or has too little memory.
pub fn density(gpu: &Gpu, field: &Field) -> Result<Box<dyn Density>> {
    Ok(Box::new(density::GpuDensity::new(gpu, field)?))
}
