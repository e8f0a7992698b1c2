//! Devices by their names. This is the one module that knows the crate behind `--device gpu`.

use std::sync::Arc;

use crate::base::{Error, Result};
use crate::runtime::{Accelerator, ListedDevice, Runtime, instructions};
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
            "field.precision = \"f16\" needs --device gpu; on other devices choose \"f32\" or, with --device cpu, \"bf16\""
                .into(),
        )),
        None => Ok(()),
        Some(_) if !config.method.has_fields() => Err(refused(config)),
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
        augnerf_gpu::list()
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
