//! Trains neural radiance fields with and without worst-case augmentation (Aug-NeRF and NeRF), and compares them with SRN,
//! Neural Volumes and LLFF under one protocol.
//!
//! # Where to start
//!
//! | to | use |
//! |---|---|
//! | choose device and threads | [`runtime::Runtime`] |
//! | combine preset, file and settings | [`settings::build`] |
//! | load a scene | [`run::load_scene`]; your own: [`data::Scene`] |
//! | take training steps, add your own loss term | [`train::Trainer`], [`losses::LossTerm`] |
//! | train in a run folder, with logs, checkpoints and metrics | [`run::Job`] |
//! | open a run, measure it again, extract a mesh | [`run::Trained`] |
//! | render a view | [`run::Viewer`] |
//! | compare images or meshes | [`metrics::measure`], [`mesh::chamfer`], [`mesh::read_mesh`] |
//! | run many trainings as one table | [`sweep::expand`], [`report::tables::Table`] |
//! | receive notes and progress | [`base::Listener`] |
//!
//! The folder `examples` shows a training, a view of an opened run, your own regularizer and your own data format. The folder
//! `docs` has a page for each task.
//!
//! # The source in eleven files
//!
//! A candle NeRF, a module of perturbations for each level, one training step, and the points of a sweep. In this order:
//!
//! | file in `crates` | what it has |
//! |---|---|
//! | `nerf/src/field/encoding.rs` | sines and cosines of positions |
//! | `nerf/src/field/nerf.rs` | the network, of `candle_nn::Linear` |
//! | `nerf/src/render/volume.rs` | the rendering equation |
//! | `nerf/src/perturb/site.rs` | what a site of perturbation is |
//! | `nerf/src/perturb/input.rs` | the sites of coordinates: `t`, `xyz`, `view`. `feature.rs` and `output.rs` beside it have the other levels |
//! | `nerf/src/perturb/set.rs` | constraint sets, and projection onto them |
//! | `nerf/src/perturb/pgd.rs` | the search for the worst case |
//! | `nerf/src/render/pass.rs` | a pass of rays, and where each delta enters it |
//! | `nerf/src/losses/mod.rs` | the table of loss terms; each has a file beside it, such as `tv.rs` |
//! | `nerf/src/methods/fields/plan.rs` | the passes of a step with their weights, such as lambda |
//! | `nerf/src/methods/fields/step.rs` | a training step, as the Aug-NeRF paper's Algorithm 1 |
//!
//! Then `sweep/src/layout.rs` combines a sweep's rows, axes and seeds into planned trainings, and `sweep/src/points.rs` makes points
//! of them. A hash grid, which preset `fast` trains, is `nerf/src/field/grid.rs`. `docs/adding.md` says where a new encoding, term,
//! site or format goes.
//!
//! These files are the reference: candle's operations, for f64 and for any device. In f32 on a CPU the crate `augnerf-fast`
//! computes in their place, and tests compare the two. The choices are made here:
//!
//! | what | chosen in |
//! |---|---|
//! | network, hash grid with its gradient, derivatives of density | `Field::prepared` copies the weights for `nerf/src/field/fast`; a field that has the copy uses it |
//! | compositing | `volume::composite`; `composite_reference` beside it is the equation |
//! | Adam | `Adam::update` of `nerf/src/optimizer.rs` |
//! | a whole step on a GPU (`--device gpu`) | `train::Inputs::steps`; `crates/gpu/src/step.rs` executes the same plan |
//!
//! `field.core = "plain"` takes candle's operations for the first. In f64, fields, compositing and Adam have no kernels.
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
//!         └──────►│ perturb: deltas, sets ─► PGD on the loss    │◄── gradients ─────┤
//!                 └─────────────────────────────────────────────┘                   ▼
//!                          perturbed pass, lambda ──────────────────► train: Adam, checkpoint
//!  losses: on rays, on tables ──────────────────────────────────────────────────────▲
//!          in a box: density, its gradient, its Laplacian (l1, tv, ...) ────────────┘
//!
//!  checkpoint ─► run::Trained ─► methods: a Renderer ─► views ─► metrics ─► metrics.json, CSV, images
//!                            └─► mesh: density on a grid ─► level set ─► mesh ─► Chamfer distance to a reference
//!
//!  sweep: definition ─► points ─► one run each ─► report: records ─► tables, figures
//!  compare: runs ─► one view or ray side by side
//! ```
//!
//! Training and evaluation use a method only through its learner and its renderer. Some methods also have a [`field::Density`].
//!
//! # Symbols
//!
//! | name | shape | unit | meaning |
//! |---|---|---|---|
//! | `origins`, `directions` | `[rays, 3]` | scene units (NDC where used) | a point is origin + t * direction |
//! | `viewdirs` | `[rays, 3]` | 1 | unit direction of the world ray |
//! | `near`, `far` | scalars | as `t_vals` | ends of a ray's interval |
//! | `t_vals` | `[rays, samples]` | lengths of `directions` | sorted sample positions; MipNeRF: edges of intervals, `[rays, samples + 1]` |
//! | `points` | `[rays, samples, 3]` | scene units | queries of the field; MipNeRF: Gaussians, `[rays, samples, 6]` |
//! | `rgb` | `[rays, samples, 3]` or `[rays, 3]` | 0..1 | colour of samples, of rays |
//! | `density` | `[rays, samples]` | 1 / scene unit | extinction, not negative |
//! | `alpha` | `[rays, samples]` | 0..1 | 1 - exp(-density * interval) |
//! | `weights` | `[rays, samples]` | 0..1 | transmittance * alpha |
//! | `acc` | `[rays]` | 0..1 | sum of weights |
//! | `depth` | `[rays]` | as `t_vals` | sum of weights * t |
//! | `delta` | see [`perturb::Site`] and what implements it | the site's own | perturbation added at a site of the perturbed pass |
//! | `epsilon` | scalar | see [`settings::PerturbConfig`] | size of a delta's constraint set |
//! | `step_size` | scalar | the delta's unit, or radii | length of one PGD step |
//! | `lambda` | scalar | 1 | weight of the perturbed loss |
//! | `laplacian` | `[n]` | 1 / scene unit^3 | divergence of density's gradient |
//! | `threshold` | scalar | as `density` | its level set is the surface |
//! | `gradient` | `[n, 3]` | 1 / scene unit^2 | gradient of density |
//! | `pose` | `[3, 4]` | scene units | columns: the camera's right, up and backward axes, its position |
//! | `lattice`, `side` | scalar | cells | a sampling grid divides a box into `side`^3 cells |
//!
//! # Crates
//!
//! Each crate uses the crates of lower rows only, which the compiler checks. This crate re-exports the modules of all but
//! `augnerf-baselines`, `augnerf-fast` and `augnerf-gpu`.
//!
//! | crate | modules |
//! |---|---|
//! | `augnerf` | [`cli`], and everything below |
//! | `augnerf-sweep` | [`sweep`] |
//! | `augnerf-view` | [`view`] |
//! | `augnerf-run` | [`train`], [`run`], [`compare`], [`mesh`], [`mod@bench`] |
//! | `augnerf-gpu` | training and rendering on any GPU, with the feature `gpu` |
//! | `augnerf-baselines` | the [`methods`] SRN, Neural Volumes and LLFF |
//! | `augnerf-nerf` | [`runtime`], [`settings`], [`field`], [`perturb`], [`render`], [`losses`], [`space`], [`methods`] NeRF and Aug-NeRF |
//! | `augnerf-report` | [`report`] |
//! | `augnerf-measure` | [`metrics`] |
//! | `augnerf-scenes` | [`data`] |
//! | `augnerf-fast` | kernels for CPUs, which `augnerf-nerf` runs in place of candle's operations |
//! | `augnerf-draw` | [`draw`] |
//! | `augnerf-base` | [`base`] |
//!
//! All random numbers come from [`base::rng`], as a function of seed, stream and step. `augnerf-nerf` is generic over f32 and f64:
//! training uses f32, and tests compare with f64.

#![warn(missing_docs)]

/// The tensor library, in the version of this crate's types.
pub use candle_core;

pub use augnerf_draw as draw;
pub use augnerf_measure::metrics;
pub use augnerf_nerf::{field, losses, perturb, render, settings, space};
pub use augnerf_report::report;
pub use augnerf_run::{bench, compare, mesh, run, train};
pub use augnerf_scenes as data;
pub use augnerf_sweep as sweep;
pub use augnerf_view as view;

pub mod cli;

/// Errors, events, files and random numbers, which all other modules use.
pub mod base {
    pub use augnerf_base::*;
    pub use augnerf_run::revision::{features, revision, version};
}

/// The machine of a run: device, threads, memory, host, clocks.
pub mod runtime {
    pub use augnerf_nerf::runtime::*;
    pub use augnerf_run::{list_devices, open_runtime};
}

/// The model of each method, with its training and its rendering.
pub mod methods {
    pub use augnerf_nerf::methods::*;
    pub use augnerf_run::model::*;
}

/// Runs the code of the page about the library.
#[cfg(doctest)]
#[doc = include_str!("../docs/library.md")]
mod library_page {}
