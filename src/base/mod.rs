//! What everything else stands on: errors, images, progress, random numbers, files, the code's revision.

mod error;
pub mod files;
mod image;
mod progress;
pub mod revision;
pub mod rng;
pub mod tensors;

pub use error::{Error, Result};
pub use image::Image;
pub use progress::Progress;
pub use revision::{revision, version};
