//! Pictures: figures in SVG and PNG, images, depth maps, animations.

pub(crate) mod canvas;
mod film;
pub(crate) mod pictures;
mod raster;

pub use canvas::Figure;
pub(crate) use film::GIF_ALONE;
pub use film::write_mp4;
pub use pictures::{
    SOLID, beside, depth_colour, depth_range, encode_jpeg, pixel_errors, quantise, scale_colour, write_depth16,
    write_gif, write_png8, write_timed_gif,
};
pub(crate) use raster::SVG_ALONE;
