//! The numeric core of augnerf: fields, perturbations, rendering, losses and the training step.
//!
//! The crate `augnerf` re-exports these modules and describes the pipeline.

#![warn(missing_docs)]

pub(crate) use {augnerf_base as base, augnerf_scenes as data};

pub mod field;
pub mod losses;
pub mod methods;
pub mod optimizer;
pub mod perturb;
pub mod render;
pub mod runtime;
mod schedule;
pub mod settings;
pub mod space;
