//! Devices by their names. This is the one module that knows the crate behind `--device gpu`.

use std::sync::Arc;

use serde::Serialize;

use crate::base::{Error, Result};
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
/// # Ok::<(), augnerf_base::Error>(())
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
        Some(accelerator) => accelerator.check(config),
    }
}

/// Returns the error for a method that no accelerator trains or renders.
pub(crate) fn refused(config: &Config) -> Error {
    let method = config.method.name();
    Error::Config(format!("method {method}: device gpu does not train or render it; use --device cpu"))
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
}
