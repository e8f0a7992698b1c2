//! Foundations of all other modules: errors, events, images, random numbers, files.

pub mod csv;
mod error;
mod events;
pub mod files;
mod image;
pub mod input;
pub mod place;
pub mod rng;
pub mod simd;
pub mod tensors;
mod text;

pub use error::tensor_sentence;
pub use error::{Class, Error, Result, SettingError};
pub use events::{Event, Listener};
pub use image::Image;
pub use text::{first_names, line, quoted, short_hash, shown};
