//! All integration tests in one program: it links the library once.

mod common;

mod answers;
mod attack_geometry;
mod attacks;
mod bad_data;
#[cfg(feature = "baselines")]
mod baselines;
mod browser;
mod captures;
mod cli;
mod colmap;
mod controls;
mod corruption;
mod device;
mod docs;
mod exchange;
mod fused;
mod fuzz;
mod geometry;
#[cfg(feature = "gpu")]
mod gpu;
mod hash_runs;
mod hostile;
#[cfg(target_os = "linux")]
mod hostile_memory;
mod hostile_results;
mod idle;
mod interruption;
mod loaders;
mod methods;
mod metrics;
mod occupancy;
mod openings;
mod output;
mod own_sites;
mod page;
mod pages;
mod paths;
mod perturbations;
mod photos;
mod pictures;
mod plain;
mod reference;
mod regularizers;
mod repairs;
mod run_scenes;
mod runtime;
mod score;
mod served;
mod settings;
mod sharpness;
#[cfg(unix)]
mod slurm;
#[cfg(unix)]
mod slurm_jobs;
mod strangers;
mod sweep_cli;
mod sweep_controls;
mod sweep_folder;
mod sweep_plots;
mod sweep_run;
mod sweep_tables;
mod sweep_views;
mod sweep_words;
mod tips;
mod training;
mod typeset;
mod verify;
mod view;
mod view_browser;
mod view_program;
mod views;

/// Counts what is taken, for the tests that bound it.
#[global_allocator]
static ALLOCATOR: fuzz::memory::Counting = fuzz::memory::Counting;
