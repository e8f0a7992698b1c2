//! Runs in their folders: training, checkpoints, evaluation, rendering, meshes and comparisons.

#![warn(missing_docs)]

pub(crate) use augnerf_core::{
    base, data, field, losses, methods, metrics, optimizer, perturb, render, runtime, settings, space,
};
pub(crate) use augnerf_report::{draw, report};

mod accelerator;
pub mod bench;
pub mod compare;
pub mod model;
pub mod revision;
pub mod run;
pub mod train;

pub use accelerator::{ListedDevice, list_devices, open_runtime};
