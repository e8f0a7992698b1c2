//! The methods: models, learners and renderers.
//!
//! A method has parameters, a [`Learner`] that turns a step's rays into gradients, and a [`Renderer`] that turns rays
//! into colours. Some methods have a density. A [`Stepper`] trains the parameters wherever they are kept: with a learner
//! and Adam ([`HostStepper`]), or on an accelerator. To add a method, implement [`Family`] and [`Network`] in a crate of its
//! own, as `augnerf-baselines` does, and add it to the [`crate::settings::Method`]s.

mod batches;
mod diagnostics;
mod extremes;
mod fields;
mod gradients;
mod host_stepper;
mod learner;
mod network;
mod renderer;
mod sharpness;
mod stepper;

pub use batches::{Batch, Batches};
pub use diagnostics::{SiteDiagnostics, SiteSummary, columns as site_columns, logged_sites};
pub use extremes::Extremes;
pub use fields::{
    AttackGeometry, Balance, CountedTerms, FieldLearner, FieldRenderer, Fields, PassPlan, Plan, SampleSource, Search,
    StepLosses, is_regularized, is_timed, log_columns, parts, step_over_radius,
};
pub use gradients::Gradients;
pub use host_stepper::HostStepper;
pub use learner::{Learner, LogColumns, StepResult, StopCheck, Term};
pub use network::{Family, Network};
pub use renderer::{RenderedRays, Renderer};
pub use stepper::{StepAt, StepReport, Stepper, not_finite};
