//! Runs in their folders: training, checkpoints, evaluation, rendering, meshes and comparisons.

#![warn(missing_docs)]

pub(crate) use augnerf_measure::metrics;
pub(crate) use augnerf_nerf::{field, losses, methods, optimizer, perturb, render, runtime, settings, space};
pub(crate) use {augnerf_base as base, augnerf_draw as draw, augnerf_scenes as data};

mod accelerator;
pub mod bench;
pub mod compare;
pub mod mesh;
pub mod model;
pub mod revision;
pub mod run;
pub mod train;

pub use accelerator::{list_devices, open_runtime};
