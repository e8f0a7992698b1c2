//! Output for readers: tables, statistics, figures, pages, images and videos.

#![warn(missing_docs)]

pub(crate) use augnerf_core::{augment, base, data, metrics, settings};

pub mod draw;
pub mod report;
