//! Output for readers: tables, statistics, figures, pages.

#![warn(missing_docs)]

pub(crate) use augnerf_measure::metrics;
pub(crate) use {augnerf_base as base, augnerf_draw as draw, augnerf_scenes as data};

pub mod report;
