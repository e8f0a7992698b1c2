//! What is trained: the model of each method, how it learns and how it shows its scene.
//!
//! A method is its [`Model`], a [`Learner`] that draws a step's work and turns it into gradients, and a [`Painter`] that
//! turns rays into colours; some have fields, some have a density. To add one, write its file beside `fields` and name it
//! in [`Model`] and among the methods of [`crate::settings`].

mod batches;
mod fields;
mod gradients;
mod learner;
mod model;
mod painter;

pub use batches::{Batch, Batches};
pub use fields::{AttackSummary, Balance, FieldLearner, FieldPainter, Fields, LevelDiagnostics};
pub use gradients::Gradients;
pub use learner::{Learned, Learner, LogColumns, Term};
pub use model::{Model, Start};
pub use painter::{Painted, Painter};
