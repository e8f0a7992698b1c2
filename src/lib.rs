//! augnerf trains neural radiance fields and Aug-NeRF.

#![warn(missing_docs)]

pub mod config;
pub mod data;
pub mod error;
pub mod metrics;
pub mod rng;
