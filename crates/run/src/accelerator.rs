//! Devices by their names. This is the one module that knows the crate behind `--device gpu`.

use crate::base::{Error, Result};
use crate::data::Scene;
use crate::methods::{Fields, Renderer, Stepper};
use crate::model::Model;
use crate::optimizer::Moments;
use crate::runtime::{Accelerator, Runtime};
use crate::settings::{Config, Resolved};

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

/// Returns an error for a method that no accelerator trains or renders.
pub(crate) fn check_method(config: &Config, runtime: &Runtime) -> Result<()> {
    match config.representation().is_field() || runtime.accelerator().is_none() {
        true => Ok(()),
        false => Err(refused(config)),
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
    use std::sync::Arc;

    use super::*;

    pub(super) fn open(_device: &str, index: usize) -> Result<Arc<dyn Accelerator>> {
        Ok(Arc::new(augnerf_gpu::Gpu::open(index)?))
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

    fn own(accelerator: &dyn Accelerator) -> Result<&augnerf_gpu::Gpu> {
        accelerator.as_any().downcast_ref().ok_or_else(|| unknown(accelerator))
    }
}

/// A program without GPUs.
#[cfg(not(feature = "gpu"))]
mod gpu {
    use std::sync::Arc;

    use super::*;

    pub(super) fn open(device: &str, _index: usize) -> Result<Arc<dyn Accelerator>> {
        let built = "this program was built without gpu; build it with --features gpu";
        Err(Error::Config(format!("device {device}: {built}")))
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
}
