//! All integration tests in one program: it links the library once.

mod common;

mod attack_geometry;
mod bad_data;
mod cli;
mod corruption;
mod device;
mod docs;
mod fused;
mod geometry;
mod interruption;
mod layering;
mod loaders;
mod metrics;
mod output;
mod perturbations;
mod pictures;
mod reference;
mod regularizers;
mod runtime;
mod settings;
mod sweep_cli;
mod sweep_folder;
mod sweep_plots;
mod sweep_run;
mod sweep_tables;
mod training;
mod views;
