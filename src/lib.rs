//! augnerf trains neural radiance fields, plain (NeRF) and with worst-case augmentation
//! (Aug-NeRF), and measures both under one protocol.
//!
//! # The pipeline
//!
//! ```text
//!  data ── views ──► methods::Batches ─ Rays, target ────────────────────────────┐
//!                                                                                │
//!  one step (methods)                                                            ▼
//!  ┌─ clean pass (render) ──────────────────────────────────────────────────────────────────┐
//!  │ sampling ─► points ─► field: encoding ─► trunk ─► density, rgb ─► volume ─► rgb, weights │
//!  └──────┬──────────▲────────────────────────▲──────────────▲──────────────────────┬─────────┘
//!         │ t_vals   │ t, xyz, view           │ feature      │ rgb, density         │ loss
//!         │       ┌──┴────────────────────────┴──────────────┴──┐                   │
//!         └──────►│ augment: sets of deltas ─► ascent of the loss │◄── gradients ─────┤
//!                 └─────────────────────────────────────────────┘                   ▼
//!                          perturbed pass, lambda ─────────────────────────► train::Adam
//!    box of points ─► field: density, gradient, Laplacian ─► regularizers ──────────▲
//!
//!  checkpoint ─► evaluate ─► metrics ─► output (metrics.json, CSV, pictures)
//!             └► geometry: density on a lattice ─► level set ─► mesh ─► Chamfer distance to a reference
//! ```
//!
//! # Symbols
//!
//! | name | shape | unit | what |
//! |---|---|---|---|
//! | `origins`, `directions` | `[rays, 3]` | scene units (NDC where used) | a point is origin + t * direction |
//! | `viewdirs` | `[rays, 3]` | 1 | unit direction of the world ray |
//! | `near`, `far` | scalars | as `t_vals` | ends of a ray's interval |
//! | `t_vals` | `[rays, samples]` | lengths of `directions` | sorted sample positions; MipNeRF: edges of intervals, `[rays, samples + 1]` |
//! | `points` | `[rays, samples, 3]` | scene units | what the field is asked at; MipNeRF: Gaussians, `[rays, samples, 6]` |
//! | `rgb` | `[rays, samples, 3]` or `[rays, 3]` | 0..1 | colour of samples, of rays |
//! | `density` | `[rays, samples]` | 1 / scene unit | extinction, not negative |
//! | `alpha` | `[rays, samples]` | 0..1 | 1 - exp(-density * interval) |
//! | `weights` | `[rays, samples]` | 0..1 | transmittance * alpha |
//! | `acc` | `[rays]` | 0..1 | sum of weights |
//! | `depth` | `[rays]` | as `t_vals` | sum of weights * t |
//! | `delta` | see [`augment::Site`] | the site's own | what is added at a site of the perturbed pass |
//! | `epsilon` | scalar | see [`augment::About`] | size of a delta's set |
//! | `step_size` | scalar | the delta's unit, or radii | length of one ascent step |
//! | `lambda` | scalar | 1 | weight of the perturbed loss |
//! | `laplacian` | `[n]` | 1 / scene unit^3 | divergence of density's gradient |
//! | `threshold` | scalar | as `density` | its level set is the surface |
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
//! | 3 | `data`, `draw` |
//! | 2 | `settings` |
//! | 1 | `augment`, `runtime` |
//! | 0 | `base` |
//!
//! Randomness comes from [`base::rng`] alone, a function of seed, stream and step. The numeric core is
//! generic over f32 and f64; training runs in f32, the tests' oracles in f64.

#![warn(missing_docs)]

pub mod augment;
pub mod base;
pub mod bench;
pub mod cli;
pub mod compare;
pub mod data;
pub mod draw;
pub mod field;
pub mod losses;
pub mod methods;
pub mod metrics;
pub mod render;
pub mod report;
pub mod run;
pub mod runtime;
pub mod settings;
pub mod space;
pub mod sweep;
pub mod train;
