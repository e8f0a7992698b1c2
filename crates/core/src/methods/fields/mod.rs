//! Radiance fields: NeRF, MipNeRF, and both with worst-case augmentation.
//!
//! A step is a clean pass, an optional search and perturbed pass, and regularizers in space. Rays are processed in
//! chunks whose gradients are added. The chunk bounds memory, and small chunks stay in a CPU's cache.

mod chunk;
mod entries;
mod geometry;
mod learner;
mod networks;
mod passes;
mod perturbed;
mod regularized;
mod renderer;
mod report;
mod results;
mod start;
mod step;
mod terms;
mod unseen;

pub use geometry::{AttackGeometry, step_over_radius};
pub use learner::FieldLearner;
pub use networks::Fields;
pub use passes::parts;
pub use regularized::{Balance, is_regularized, is_timed};
pub use renderer::FieldRenderer;
pub use report::{StepLosses, coarse_weight, log_columns, loss_weights};
