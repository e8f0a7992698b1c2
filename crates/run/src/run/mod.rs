//! One experiment from its settings to its results: scene, run folder, training, evaluation and output files.
//!
//! Two rules hold throughout. A file is replaced by a rename, so that a reader sees the old content or the new one and
//! never a mixture, even after a kill. Everything written is a function of configuration and seed, with two
//! exceptions: `timing.json` and `run.lock` contain clock times, host names or process numbers.

mod balance;
mod columns;
mod corruption;
mod depth_errors;
mod evaluate;
mod first_view;
mod folder;
mod import;
mod inputs;
mod job;
mod lock;
mod mesh;
mod mesh_picture;
mod metrics;
mod pictures;
mod preview;
mod protocol;
mod scalars;
mod scene_file;
mod scene_picture;
mod score;
mod session;
mod smoothness;
mod surface;
mod trained;

pub use balance::{BalancedWeight, balance};
pub use columns::{cell, columns};
pub use corruption::write_corrupted;
pub use depth_errors::DepthErrors;
pub use evaluate::{EVALUATING, RenderedView, Viewer};
pub use first_view::{FirstView, read_picture};
pub use folder::{Existing, RunDir};
pub use import::Foreign;
pub use inputs::{check_spacing, load_lpips, load_scene, load_scene_of, load_scene_with, locate_scene};
pub use job::watch_memory;
pub use job::{Finished, Job, Setup};
pub use mesh::{MeshFormat, MeshOptions, MeshReport, MeshUnits};
pub use mesh_picture::{MeshPicture, Viewpoint, mesh_picture};
pub use metrics::Report;
pub use pictures::{PathPictures, Pictures};
pub use protocol::Protocol;
pub use protocol::split_name;
pub use scalars::Scalars;
pub use scene_file::WorldMatrix;
pub use scene_picture::scene_picture;
pub use score::{Matching, Picture, Score, Truth, pictures, score};
pub use smoothness::{FieldSmoothness, SMOOTHNESS_SIDE, SmoothnessReport, check_measurable, smoothness_box};
use surface::builtin_surface;
pub use surface::{Surface, most_memory_mib, surface_box, surface_reference, surface_threshold};
use trained::Measurement;
pub use trained::{OpenOptions, Split, Trained};
