//! The numeric core of augnerf: scenes, fields, augmentation, rendering, losses and metrics.
//!
//! The crate `augnerf` re-exports everything here and describes the pipeline.

#![warn(missing_docs)]

pub mod base;
pub mod data;
pub mod field;
pub mod losses;
pub mod methods;
pub mod metrics;
pub mod optimizer;
pub mod perturb;
pub mod render;
pub mod runtime;
pub mod settings;
pub mod space;
