//! What everything else stands on: errors, events, images, random numbers, files, the code's revision.

pub mod csv;
mod error;
mod events;
pub mod files;
mod image;
mod revision;
pub mod rng;
mod temporaries;
pub(crate) mod tensors;

pub use error::{Class, Error, Result, SettingError};
pub use events::{Event, Listener};
pub use image::Image;
pub use revision::{revision, version};
