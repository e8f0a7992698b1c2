//! What is trained: representation and augmentation of each method, and how each learns.

mod batches;
mod fields;
mod gradients;

pub use batches::{Batch, Batches};
pub use fields::{AttackSummary, Balance, FieldLearner, Learned, LevelDiagnostics, Model, Volume, diagnostic_columns};
pub use gradients::Gradients;
