//! augnerf trains neural radiance fields and Aug-NeRF.

#![warn(missing_docs)]

pub mod allocator;
pub mod config;
pub mod data;
pub mod error;
pub mod evaluate;
pub mod field;
pub mod metrics;
pub mod model;
pub mod output;
pub mod perturbations;
pub mod render;
pub mod rng;
pub mod sampling;
pub mod train;
