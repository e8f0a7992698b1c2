//! Output for readers: tables, statistics, figures, pages, images and videos.

#![warn(missing_docs)]

pub(crate) use augnerf_core::{base, data, metrics, perturb, settings};

pub mod draw;
pub mod report;
