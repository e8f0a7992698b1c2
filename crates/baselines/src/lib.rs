//! The baselines: Scene Representation Networks, Neural Volumes and the network of LLFF.
//!
//! Each has parameters, a learner and a renderer, as [`augnerf_nerf::methods`] requires.

#![warn(missing_docs)]

pub(crate) use augnerf_nerf::{field, methods, runtime, settings};
pub(crate) use {augnerf_base as base, augnerf_scenes as data};

mod families;
mod grids;
mod parameters;
mod planes;
mod srn;
mod volume;

pub use families::family;
