//! Radiance fields: NeRF, MipNeRF, and both with worst-case augmentation.
//!
//! `step` is a training step from top to bottom; `plan` says what it consists of.

mod balance;
mod diagnosis;
mod entries;
mod geometry;
mod learner;
mod networks;
mod plan;
mod rays;
mod renderer;
mod report;
mod space;
mod start;
mod step;
mod sums;
mod terms;

pub use balance::Balance;
pub use geometry::step_over_radius;
pub use learner::FieldLearner;
pub use networks::{Fields, OCCUPANCY};
pub use plan::{CountedTerms, DeltaPlan, PassPlan, Plan, SampleSource};
pub use renderer::FieldRenderer;
pub use report::{StepLosses, log_columns};
pub use space::is_regularized;
pub use step::parts;
