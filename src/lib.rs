//! augnerf trains neural radiance fields, plain (NeRF) and with worst-case augmentation
//! (Aug-NeRF), SRN, Neural Volumes and LLFF beside them, and measures all under one protocol.
//!
//! # Where to start
//!
//! | to | start at |
//! |---|---|
//! | say where numbers are computed | [`runtime::Runtime`] |
//! | lay settings over one another | [`settings::build`] |
//! | load a scene | [`run::load_scene`]; one of your own: [`data::Scene`] |
//! | take training steps, add a term of your own to the loss | [`train::Trainer`], [`losses::LossTerm`] |
//! | train in a run folder, with logs, checkpoints and metrics | [`run::Job`] |
//! | open a run, measure it again, draw its surface | [`run::Trained`] |
//! | render a view | [`run::Viewer`] |
//! | compare pictures, meshes | [`metrics::measure`], [`space::chamfer`], [`space::read_mesh`] |
//! | run many trainings as one table | [`sweep::expand`], [`report::tables::Table`] |
//! | hear what goes on | [`base::Listener`] |
//!
//! The folder `examples` has a training, a view of an opened run, a regularizer and a data format of one's own; `docs` has a page
//! for each thing that the program does.
//!
//! # The pipeline
//!
//! ```text
//!  settings: preset, file, --set ─► Config ──── data: format ─► Scene ─────► Resolved
//!                                                  │ views
//!  one step (methods: a Learner)                   ▼
//!                              Batches ─ rays, target colours ───────────────────┐
//!                                  │                                             ▼
//!  ┌─ clean pass (render) ─────────▼────────────────────────────────────────────────────────┐
//!  │ sampling ─► points ─► field: encoding ─► trunk ─► density, rgb ─► volume ─► rgb, weights │
//!  └──────┬──────────▲────────────────────────▲──────────────▲──────────────────────┬─────────┘
//!         │ t_vals   │ t, xyz, view           │ feature      │ rgb, density         │ loss
//!         │       ┌──┴────────────────────────┴──────────────┴──┐                   │
//!         └──────►│ augment: deltas, sets ─► ascent of the loss │◄── gradients ─────┤
//!                 └─────────────────────────────────────────────┘                   ▼
//!                          perturbed pass, lambda ──────────────────► train: Adam, checkpoint
//!  losses: on rays (distortion) ────────────────────────────────────────────────────▲
//!          in a box: density, its gradient, its Laplacian (l1, tv, laplacian) ──────┘
//!
//!  checkpoint ─► run::Trained ─► methods: a Renderer ─► views ─► metrics ─► metrics.json, CSV, pictures
//!                            └─► space: density on a lattice ─► level set ─► mesh ─► Chamfer distance to a reference
//!
//!  sweep: definition ─► points ─► one run each ─► report: records ─► tables, figures
//!  compare: runs ─► one view or ray side by side
//! ```
//!
//! A learner and a renderer are all that training and evaluation know of a method; a [`field::Density`] is there or not.
//!
//! # Symbols
//!
//! | name | shape | unit | what |
//! |---|---|---|---|
//! | `origins`, `directions` | `[rays, 3]` | scene units (NDC where used) | a point is origin + t * direction |
//! | `viewdirs` | `[rays, 3]` | 1 | unit direction of the world ray |
//! | `near`, `far` | scalars | as `t_vals` | ends of a ray's interval |
//! | `t_vals` | `[rays, samples]` | lengths of `directions` | sorted sample positions; MipNeRF: edges of intervals, `[rays, samples + 1]` |
//! | `points` | `[rays, samples, 3]` | scene units | what the field is queried at; MipNeRF: Gaussians, `[rays, samples, 6]` |
//! | `rgb` | `[rays, samples, 3]` or `[rays, 3]` | 0..1 | colour of samples, of rays |
//! | `density` | `[rays, samples]` | 1 / scene unit | extinction, not negative |
//! | `alpha` | `[rays, samples]` | 0..1 | 1 - exp(-density * interval) |
//! | `weights` | `[rays, samples]` | 0..1 | transmittance * alpha |
//! | `acc` | `[rays]` | 0..1 | sum of weights |
//! | `depth` | `[rays]` | as `t_vals` | sum of weights * t |
//! | `delta` | see [`augment::Site`] | the site's own | what is added at a site of the perturbed pass |
//! | `epsilon` | scalar | see [`augment::SiteSpec`] | size of a delta's set |
//! | `step_size` | scalar | the delta's unit, or radii | length of one ascent step |
//! | `lambda` | scalar | 1 | weight of the perturbed loss |
//! | `laplacian` | `[n]` | 1 / scene unit^3 | divergence of density's gradient |
//! | `threshold` | scalar | as `density` | its level set is the surface |
//! | `gradient` | `[n, 3]` | 1 / scene unit^2 | slope of density |
//! | `pose` | `[3, 4]` | scene units | columns: the camera's right, up and backward axes, its place |
//! | `lattice`, `side` | scalar | cells | a box is cut into `side`^3 of them |
//!
//! # Layers
//!
//! Each module uses those of lower rows only; `tests/it/layering.rs` holds this table.
//!
//! | tier | modules |
//! |---|---|
//! | 12 | `cli` |
//! | 11 | `sweep` |
//! | 10 | `compare`, `bench` |
//! | 9 | `run` |
//! | 8 | `train` |
//! | 7 | `methods` |
//! | 6 | `losses` |
//! | 5 | `render`, `space`, `report` |
//! | 4 | `field`, `metrics` |
//! | 3 | `data`, `draw`, `grids` |
//! | 2 | `settings` |
//! | 1 | `augment`, `runtime` |
//! | 0 | `base` |
//!
//! Randomness comes from [`base::rng`] alone, a function of seed, stream and step. The numeric core is
//! generic over f32 and f64; training runs in f32, the tests' oracles in f64.

#![warn(missing_docs)]

/// The tensor library, in the version that this crate's types are made of.
pub use candle_core;

#[cfg(feature = "baselines")]
pub use augnerf_baselines::grids;
pub use augnerf_core::{augment, data, field, losses, metrics, render, runtime, settings, space};
pub use augnerf_report::{draw, report};
pub use augnerf_run::{bench, compare, run, train};
pub use augnerf_sweep as sweep;

pub mod cli;

/// Errors, events, files, random numbers and other ground that everything stands on.
pub mod base {
    pub use augnerf_core::base::*;
    pub use augnerf_run::revision::{features, revision, version};
}

/// What is trained: the model of each method, how it learns and how it shows its scene.
pub mod methods {
    #[cfg(feature = "baselines")]
    pub use augnerf_baselines::{
        MpiNetwork, NeuralVolume, PlanesLearner, PlanesRenderer, Srn, SrnLearner, SrnMarch, SrnRenderer, VolumeDensity,
        VolumeLearner, VolumeRenderer,
    };
    pub use augnerf_core::methods::*;
    pub use augnerf_run::model::*;
}

/// Runs the code of the page on the library.
#[cfg(doctest)]
#[doc = include_str!("../docs/library.md")]
mod library_page {}
