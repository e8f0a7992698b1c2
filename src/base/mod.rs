//! What everything else stands on: errors, events, images, random numbers, files, the code's revision.

pub mod csv;
mod error;
mod events;
pub mod files;
mod image;
pub mod input;
mod revision;
pub mod rng;
pub(crate) mod simd;
mod temporaries;
pub(crate) mod tensors;
mod text;

pub(crate) use error::tensor_sentence;
pub use error::{Class, Error, Result, SettingError};
pub use events::{Event, Listener};
pub use image::Image;
pub use revision::{features, revision, version};
pub use text::{line, shown};
