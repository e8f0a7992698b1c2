//! Devices by their names. This is the one module that knows the crate behind `--device gpu`.

use std::sync::Arc;

use serde::Serialize;

use crate::base::{Error, Result};
use crate::data::Scene;
use crate::field::{Density, Field, FieldDensity};
use crate::methods::{Fields, Renderer, Stepper};
use crate::model::Model;
use crate::optimizer::Moments;
use crate::runtime::{Accelerator, Runtime, instructions};
use crate::settings::{Config, Precision, Resolved};

/// Opens `device` (`cpu`, `gpu`, `gpu:N`, `cuda`, `cuda:N`, `cuda-tf32` or `metal`) with this many threads. `None` is one
/// thread per CPU of the process.
///
/// # Errors
/// Those of [`Runtime::new`]. [`Error::Config`] if this program was built without `gpu`, or there is no such GPU.
///
/// ```
/// assert_eq!(augnerf_run::open_runtime("cpu", Some(2))?.threads(), 2);
/// assert!(augnerf_run::open_runtime("gpu:x", None).is_err());
/// # Ok::<(), augnerf_core::base::Error>(())
/// ```
pub fn open_runtime(device: &str, threads: Option<usize>) -> Result<Runtime> {
    match Runtime::accelerator_index(device)? {
        None => Runtime::new(device, threads),
        Some(index) => Runtime::with_accelerator(gpu::open(device, index)?, device.to_string(), threads),
    }
}

/// A device that `--device` can name.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ListedDevice {
    /// Its name for `--device`.
    pub device: String,
    /// The hardware.
    pub name: String,
    /// Interface and driver; empty for the processor.
    pub driver: String,
    /// A processor plays the device: for tests, far slower than `cpu`.
    pub is_software: bool,
    /// The largest buffer that a kernel reads, in bytes.
    pub largest_buffer: Option<u64>,
    /// Whether it trains with `field.precision = "f16"`.
    pub has_f16: bool,
    /// What the kernels need and it lacks.
    pub lacks: Vec<String>,
}

/// Lists the processor and the adapters for `--device gpu:N`. Devices of candle (`cuda`, `metal`) are not listed.
pub fn list_devices() -> Vec<ListedDevice> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let processor = ListedDevice {
        device: "cpu".into(),
        name: format!("{threads} threads, {}", instructions()),
        driver: String::new(),
        is_software: false,
        largest_buffer: None,
        has_f16: false,
        lacks: Vec::new(),
    };
    std::iter::once(processor).chain(gpu::list()).collect()
}

/// What a step does on an accelerator.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct DeviceWork {
    /// Dispatches of kernels.
    pub dispatches: usize,
    /// Multiply-adds of matrix products.
    pub multiply_adds: f64,
    /// Bytes sent to the device.
    pub bytes_sent: usize,
    /// The tiles in which wide layers are multiplied.
    pub tiles: String,
    /// Each kind of kernel, the longest first, measured one after another. Empty if the device has no timestamps.
    pub kernels: Vec<KernelTime>,
}

/// The dispatches of a kernel in a step.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct KernelTime {
    /// The kernel.
    pub kernel: String,
    /// Their number.
    pub dispatches: usize,
    /// Their time together.
    pub milliseconds: f64,
}

/// Counts and measures what a step does on the runtime's accelerator. `None` without one.
pub(crate) fn work(runtime: &Runtime, config: &Resolved, scene: &Scene, model: &Model) -> Result<Option<DeviceWork>> {
    let of = |accelerator: &Arc<dyn Accelerator>| gpu::work(&**accelerator, config, scene, fields(model, config)?);
    runtime.accelerator().map(of).transpose()
}

/// Returns an error for what no accelerator trains.
pub(crate) fn check(config: &Resolved, runtime: &Runtime) -> Result<()> {
    match runtime.accelerator() {
        None if config.field.precision == Precision::F16 => Err(Error::Config(
            "field.precision = \"f16\" needs --device gpu with matrix units; on other devices choose \"f32\" or, with --device \
             cpu, \"bf16\""
                .into(),
        )),
        None => Ok(()),
        Some(_) if !config.representation().is_field() => Err(refused(config)),
        Some(_) => gpu::check(config),
    }
}

/// Returns what trains `model` on an accelerator, with the moments of its parameters, or with 0.
pub(crate) fn stepper(
    accelerator: &dyn Accelerator,
    config: &Resolved,
    scene: &Scene,
    model: &Model,
    moments: Option<Vec<Moments>>,
) -> Result<Box<dyn Stepper>> {
    gpu::stepper(accelerator, config, scene, fields(model, config)?, moments)
}

/// Returns what renders `model` on an accelerator.
pub(crate) fn renderer(
    accelerator: &dyn Accelerator,
    config: &Config,
    scene: &Scene,
    model: &Model,
) -> Result<Box<dyn Renderer>> {
    gpu::renderer(accelerator, fields(model, config)?, config, scene)
}

/// Returns the density of a field, on the runtime's accelerator where it has one.
pub(crate) fn density(runtime: &Runtime, field: &Field) -> Result<Box<dyn Density>> {
    match runtime.accelerator() {
        Some(accelerator) => gpu::density(&**accelerator, field),
        None => Ok(Box::new(FieldDensity::new(field)?)),
    }
}

fn fields<'a>(model: &'a Model, config: &Config) -> Result<&'a Fields> {
    match model {
        Model::Fields(fields) => Ok(fields),
        Model::Baseline(..) => Err(refused(config)),
    }
}

fn refused(config: &Config) -> Error {
    let method = config.method.name();
    Error::Config(format!("method {method}: device gpu does not train or render it; use --device cpu"))
}

/// Returns the error for an accelerator of another crate.
fn unknown(accelerator: &dyn Accelerator) -> Error {
    let description = accelerator.description();
    Error::Config(format!("device gpu: this program cannot train or render on {description}; use --device cpu"))
}

/// WGSL kernels on any GPU.
#[cfg(feature = "gpu")]
mod gpu {
    use super::*;

    pub(super) fn open(_device: &str, index: usize) -> Result<Arc<dyn Accelerator>> {
        Ok(Arc::new(augnerf_gpu::Gpu::open(index)?))
    }

    pub(super) fn list() -> Vec<ListedDevice> {
        let listed = |adapter: augnerf_gpu::Adapter| ListedDevice {
            device: format!("gpu:{}", adapter.index),
            name: adapter.name,
            driver: [adapter.backend, adapter.driver].join(", "),
            is_software: adapter.is_software,
            largest_buffer: Some(adapter.largest_buffer),
            has_f16: adapter.has_matrices,
            lacks: adapter.lacks,
        };
        augnerf_gpu::adapters().into_iter().map(listed).collect()
    }

    pub(super) fn check(config: &Resolved) -> Result<()> {
        augnerf_gpu::check(config)
    }

    pub(super) fn work(
        accelerator: &dyn Accelerator,
        config: &Resolved,
        scene: &Scene,
        fields: &Fields,
    ) -> Result<DeviceWork> {
        let mut steps = augnerf_gpu::Steps::new(own(accelerator)?, config, scene, fields, None)?;
        steps.try_step(0, false)?;
        let (dispatches, multiply_adds, bytes_sent) = steps.work();
        let tiles = steps.tiles().into();
        let times = if steps.has_timestamps() { steps.profile(0)? } else { Vec::new() };
        let of_kernel = |(kernel, milliseconds, dispatches): (&str, f64, usize)| KernelTime {
            kernel: kernel.into(),
            dispatches,
            milliseconds,
        };
        Ok(DeviceWork {
            dispatches,
            multiply_adds,
            bytes_sent,
            tiles,
            kernels: times.into_iter().map(of_kernel).collect(),
        })
    }

    pub(super) fn stepper(
        accelerator: &dyn Accelerator,
        config: &Resolved,
        scene: &Scene,
        fields: &Fields,
        moments: Option<Vec<Moments>>,
    ) -> Result<Box<dyn Stepper>> {
        augnerf_gpu::stepper(own(accelerator)?, config, scene, fields, moments)
    }

    pub(super) fn renderer(
        accelerator: &dyn Accelerator,
        fields: &Fields,
        config: &Config,
        scene: &Scene,
    ) -> Result<Box<dyn Renderer>> {
        augnerf_gpu::renderer(own(accelerator)?, fields, config, scene)
    }

    pub(super) fn density(accelerator: &dyn Accelerator, field: &Field) -> Result<Box<dyn Density>> {
        augnerf_gpu::density(own(accelerator)?, field)
    }

    fn own(accelerator: &dyn Accelerator) -> Result<&augnerf_gpu::Gpu> {
        accelerator.as_any().downcast_ref().ok_or_else(|| unknown(accelerator))
    }
}

/// A program without GPUs.
#[cfg(not(feature = "gpu"))]
mod gpu {
    use super::*;

    pub(super) fn open(device: &str, _index: usize) -> Result<Arc<dyn Accelerator>> {
        let built = "this program was built without gpu; build it with --features gpu";
        Err(Error::Config(format!("device {device}: {built}")))
    }

    pub(super) fn list() -> Vec<ListedDevice> {
        Vec::new()
    }

    pub(super) fn check(_config: &Resolved) -> Result<()> {
        Ok(())
    }

    pub(super) fn work(
        accelerator: &dyn Accelerator,
        _config: &Resolved,
        _scene: &Scene,
        _fields: &Fields,
    ) -> Result<DeviceWork> {
        Err(unknown(accelerator))
    }

    pub(super) fn stepper(
        accelerator: &dyn Accelerator,
        _config: &Resolved,
        _scene: &Scene,
        _fields: &Fields,
        _moments: Option<Vec<Moments>>,
    ) -> Result<Box<dyn Stepper>> {
        Err(unknown(accelerator))
    }

    pub(super) fn renderer(
        accelerator: &dyn Accelerator,
        _fields: &Fields,
        _config: &Config,
        _scene: &Scene,
    ) -> Result<Box<dyn Renderer>> {
        Err(unknown(accelerator))
    }
    pub(super) fn density(accelerator: &dyn Accelerator, _field: &Field) -> Result<Box<dyn Density>> {
        Err(unknown(accelerator))
    }
}
