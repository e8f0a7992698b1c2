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

impl Image {
    /// Returns every `stride`-th pixel in both directions, starting with the first one.
    ///
    /// ```
    /// # use augnerf_core as augnerf;
    /// use augnerf::base::Image;
    ///
    /// let image = Image { width: 3, height: 2, channels: 1, pixels: vec![0.0, 0.1, 0.2, 0.3, 0.4, 0.5] };
    /// assert_eq!(image.every(2), Image { width: 2, height: 1, channels: 1, pixels: vec![0.0, 0.2] });
    /// ```
    pub fn every(&self, stride: usize) -> Image {
        let (columns, rows) = ((0..self.width).step_by(stride), (0..self.height).step_by(stride));
        let at = |x: usize, y: usize| &self.pixels[(y * self.width + x) * self.channels..][..self.channels];
        let pixels = rows.clone().flat_map(|y| columns.clone().flat_map(move |x| at(x, y).iter().copied()));
        Image { width: columns.len(), height: rows.len(), channels: self.channels, pixels: pixels.collect() }
    }
}
