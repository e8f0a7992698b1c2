//! The methods: models, learners and renderers.
//!
//! A method has parameters, a [`Learner`] that turns a step's rays into gradients, and a [`Renderer`] that turns rays
//! into colours. Some methods have a density. A training updates the parameters with Adam, unless an accelerator takes whole
//! steps ([`DeviceSteps`]). To add a method, implement [`Network`] and write its [`Family`] in a crate of its own,
//! as `augnerf-baselines` does, and add it to the [`crate::settings::Method`]s.

mod batches;
mod device_steps;
mod diagnostics;
mod extremes;
mod fields;
mod gradients;
mod learner;
mod network;
mod renderer;

pub use batches::{Batch, Batches};
pub use device_steps::{DeviceSteps, StepAt};
pub use diagnostics::{SiteDiagnostics, SiteSummary, colour_shift, logged_sites, site_columns};
pub use extremes::Extremes;
pub use fields::{
    Balance, CountedTerms, DeltaPlan, FieldLearner, FieldRenderer, Fields, OCCUPANCY, PassPlan, Plan, SampleSource,
    StepLosses, is_regularized, log_columns, parts, step_over_radius,
};
pub use gradients::Gradients;
pub use learner::{Learner, LogColumns, StepReport, StepResult, StopCheck, Term, no_sites, not_finite};
pub use network::{Family, Network};
pub use renderer::{RenderedRays, Renderer};
