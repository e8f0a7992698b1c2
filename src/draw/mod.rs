//! Pictures: figures in SVG and PNG, images, depth maps, animations.

pub(crate) mod canvas;
pub(crate) mod pictures;
mod raster;

pub use canvas::Figure;
pub use pictures::{
    SOLID, beside, depth_colour, depth_range, encode_jpeg, quantise, scale_colour, write_depth16, write_gif,
    write_png8, write_timed_gif,
};
pub(crate) use raster::SVG_ALONE;
