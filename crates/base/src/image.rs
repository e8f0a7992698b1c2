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
    /// # mod augnerf { pub use augnerf_base as base; }
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

/// Returns the colours of the pixels that count: those for which the mask, `[height width]`, is true, or all.
pub fn counting<'a>(image: &'a Image, mask: Option<&'a [bool]>) -> impl Iterator<Item = &'a [f32]> {
    let texels = image.pixels.chunks_exact(image.channels).enumerate();
    texels.filter(move |(pixel, _)| mask.is_none_or(|mask| mask[*pixel])).map(|(_, texel)| texel)
}

/// Returns the largest difference of a channel between two pixels that count, of all images.
pub fn colour_spread<'a>(images: impl IntoIterator<Item = (&'a Image, Option<&'a [bool]>)>) -> f32 {
    let mut ranges = [[f32::INFINITY, f32::NEG_INFINITY]; 3];
    for texel in images.into_iter().flat_map(|(image, mask)| counting(image, mask)) {
        ranges
            .iter_mut()
            .zip(texel)
            .for_each(|([low, high], value)| (*low, *high) = (low.min(*value), high.max(*value)));
    }
    ranges.iter().map(|[low, high]| high - low).fold(0.0, f32::max)
}
