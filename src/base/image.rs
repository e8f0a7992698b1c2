//! Images in memory.

/// An image in memory: row-major, `pixels[(y * width + x) * channels + c]`, values in 0..=1.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// 3 (RGB) or 4 (RGBA, straight alpha).
    pub channels: usize,
    /// `height * width * channels` values.
    pub pixels: Vec<f32>,
}
