//! Foundations of all other crates: errors, events, images, random numbers, files, the machine, and what sections of
//! settings are made of.

#![warn(missing_docs)]

pub mod columns;
pub mod csv;
mod error;
mod events;
pub mod files;
pub mod image;
pub mod input;
pub mod machine;
pub mod place;
pub mod rng;
pub mod settings;
pub mod tensors;
mod text;

pub use error::tensor_sentence;
pub use error::{BAD_CHECKPOINT, EXIT_CODES, Error, INTERNAL, Result, SettingError};
pub use events::{Event, Listener};
pub use image::Image;
pub use text::{distinct, first_names, line, number_text, quoted, short_hash, shown};
