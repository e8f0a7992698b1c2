//! Training and rendering of NeRF, MipNeRF and their augmented forms on any GPU, by WGSL kernels through wgpu.
//!
//! A run's parameters, moments, samples and gradients stay on the device. A step sends its rays and reads its losses.

#![warn(missing_docs)]

use augnerf_base::Result;
use augnerf_nerf::field::{Density, Field};
use augnerf_nerf::methods::{DeviceSteps, Fields, Renderer};
use augnerf_nerf::optimizer::Moments;
use augnerf_nerf::runtime::{Accelerator, ListedDevice, Work};
use augnerf_nerf::settings::{Config, Resolved};
use augnerf_scenes::Scene;

#[cfg(test)]
extern crate self as augnerf_gpu;

#[macro_use]
mod params;
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

pub use device::{Gpu, list};
pub use limits::check;
pub use step::Steps;

impl Accelerator for Gpu {
    fn description(&self) -> String {
        let ListedDevice { name, driver, .. } = self.adapter();
        format!("{name}, {driver}")
    }

    fn is_software(&self) -> bool {
        self.adapter().is_software
    }

    fn work(&self) -> Work {
        *self.counted()
    }

    fn synchronize(&self) -> Result<()> {
        self.wait()
    }

    fn check(&self, config: &Resolved) -> Result<()> {
        limits::check_on(self, config)
    }

    fn steps(
        &self,
        config: &Resolved,
        scene: &Scene,
        fields: &Fields,
        moments: Option<&[Moments]>,
    ) -> Result<Box<dyn DeviceSteps>> {
        Ok(Box::new(Steps::new(self, config, scene, fields, moments)?))
    }

    fn renderer(&self, fields: &Fields, config: &Config, scene: &Scene) -> Result<Box<dyn Renderer>> {
        Ok(Box::new(renderer::GpuRenderer::new(self, fields, config, scene)?))
    }

    fn density(&self, field: &Field) -> Result<Box<dyn Density>> {
        Ok(Box::new(density::GpuDensity::new(self, field)?))
    }
}
