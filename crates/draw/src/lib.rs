//! Drawing: figures in SVG, images, depth maps, animations.

#![warn(missing_docs)]

pub(crate) use augnerf_base as base;

pub mod canvas;
mod mp4;
pub mod numbers;
mod panel;
pub mod pictures;
mod reel;
mod scripts;
mod words;

pub use canvas::Figure;
pub use mp4::write_mp4;
pub use pictures::{
    SOLID, beside, depth_colour, depth_range, depth_range_of, encode_jpeg, encode_png8, pixel_errors, quantise,
    scale_colour, stripe, write_depth16, write_png8,
};
pub use reel::Reel;
