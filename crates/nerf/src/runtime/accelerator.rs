//! Accelerators that are no device of candle.

use std::fmt::Debug;

use serde::Serialize;

use crate::base::{Error, Result};
use crate::data::Scene;
use crate::field::{Density, Field};
use crate::methods::{DeviceSteps, Fields, Renderer};
use crate::optimizer::Moments;
use crate::settings::{Config, Resolved};

/// A device that `--device` can name.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ListedDevice {
    /// Its name for `--device`.
    pub device: String,
    /// The hardware.
    pub name: String,
    /// Interface and driver; empty for the CPU.
    pub driver: String,
    /// Whether the CPU emulates the device: for tests, far slower than `cpu`.
    pub is_software: bool,
    /// The largest buffer that a kernel reads, in bytes.
    pub largest_buffer: Option<u64>,
    /// Whether it has matrix units for `field.precision = "f16"`.
    pub has_f16: bool,
    /// What the kernels need and it lacks.
    pub lacks: Vec<String>,
}

/// What was counted of a device's work.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Work {
    /// Multiply-adds of matrix products.
    pub multiply_adds: u64,
    /// Bytes of these products' operands and results, each counted once a product.
    pub product_bytes: u64,
    /// Kernels that an accelerator ran.
    pub dispatches: u64,
}

impl Work {
    /// Adds more work to it.
    pub fn add(&mut self, more: Work) {
        self.multiply_adds += more.multiply_adds;
        self.product_bytes += more.product_bytes;
        self.dispatches += more.dispatches;
    }
}

/// A device that trains and renders fields with its own program, such as a GPU. candle computes on the CPU beside it. Methods that
/// it does not implement return an error that names the device.
pub trait Accelerator: Debug + Send + Sync {
    /// Returns adapter and driver, for a run's provenance: `NVIDIA H200, Vulkan, driver 580.159`.
    fn description(&self) -> String;

    /// Returns whether the CPU emulates it.
    fn is_software(&self) -> bool {
        false
    }

    /// Returns its work so far.
    fn work(&self) -> Work {
        Work::default()
    }

    /// Waits until its work is done.
    ///
    /// # Errors
    /// If the device is lost.
    fn synchronize(&self) -> Result<()>;

    /// Checks that it trains a configuration.
    ///
    /// # Errors
    /// [`Error::Config`] names what it does not train.
    fn check(&self, _config: &Resolved) -> Result<()> {
        Err(unsupported(self))
    }

    /// Returns what trains fields, with the moments of their parameters, or with 0.
    ///
    /// # Errors
    /// [`Error::Config`]: it does not train what the configuration asks for, or has too little memory.
    fn steps(
        &self,
        _config: &Resolved,
        _scene: &Scene,
        _fields: &Fields,
        _moments: Option<&[Moments]>,
    ) -> Result<Box<dyn DeviceSteps>> {
        Err(unsupported(self))
    }

    /// Returns what renders fields with their current weights.
    ///
    /// # Errors
    /// [`Error::Config`]: it does not render such fields, or has too little memory.
    fn renderer(&self, _fields: &Fields, _config: &Config, _scene: &Scene) -> Result<Box<dyn Renderer>> {
        Err(unsupported(self))
    }

    /// Returns the density of a field with its current weights.
    ///
    /// # Errors
    /// [`Error::Config`]: it does not query such a field, or has too little memory.
    fn density(&self, _field: &Field) -> Result<Box<dyn Density>> {
        Err(unsupported(self))
    }
}

fn unsupported<A: Accelerator + ?Sized>(accelerator: &A) -> Error {
    let description = accelerator.description();
    Error::Config(format!("device gpu: this program cannot train or render on {description}; use --device cpu"))
}
