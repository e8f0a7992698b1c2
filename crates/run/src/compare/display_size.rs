//! The size of a view in a figure.

use crate::base::{Image, Result};
use crate::data::resample;
use crate::draw::canvas::{Canvas, PAGE};

/// Least and most columns of a view in the figure, as far as whole factors allow.
const DISPLAY_COLUMNS: (usize, usize) = (400, 1024);
/// Pixels of a figure's margin and of the gap between two views of 400 pixels.
const MARGIN: f64 = 40.0;
const GAP: f64 = 20.0;

/// The display size of a view. It is enlarged or reduced by a whole factor, so that its pixels keep their values.
pub struct DisplaySize {
    /// Pixels of the view along each side that become one.
    pub shrink: usize,
    /// Size in the canvas's units.
    pub width: f64,
    pub height: f64,
    /// Margin of the figure, and gap between two views, in units.
    pub margin: f64,
    pub gap: f64,
}

impl DisplaySize {
    /// Returns the size of each of `columns` views side by side on a page.
    pub fn on_page(image: &Image, columns: usize) -> DisplaySize {
        let times = DISPLAY_COLUMNS.0.div_ceil(image.width) as f64;
        let shrink = image.width.div_ceil(DISPLAY_COLUMNS.1);
        let pixels = |length: usize| (length / shrink).max(1) as f64 * times;
        let (width, height) = (pixels(image.width), pixels(image.height));
        let k = width / DISPLAY_COLUMNS.0 as f64;
        let (margin, gap) = ((MARGIN * k).round(), (GAP * k).round());
        let all = columns as f64 * width + (columns - 1) as f64 * gap + 2.0 * margin;
        let units = |pixels: f64| pixels / (all / PAGE);
        DisplaySize { shrink, width: units(width), height: units(height), margin: units(margin), gap: units(gap) }
    }

    /// Returns the left edge of a column.
    pub fn left(&self, column: usize) -> f64 {
        self.margin + column as f64 * (self.width + self.gap)
    }

    pub fn draw(&self, canvas: &mut Canvas, at: (f64, f64), image: &Image) -> Result<()> {
        if self.shrink == 1 {
            return canvas.picture(at, (self.width, self.height), image);
        }
        let (width, height) = self.shrunk(image);
        canvas.picture(at, (self.width, self.height), &resample::shrink(image, width, height))
    }

    /// Draws a coloured map. Takes single pixels at regular distances, since a mean of colours would not stand for a
    /// number.
    pub fn draw_map(&self, canvas: &mut Canvas, at: (f64, f64), map: &Image) -> Result<()> {
        let (width, height) = self.shrunk(map);
        let middle = |place: usize| self.shrink * place + self.shrink / 2;
        let pixel = |x: usize, y: usize| {
            let (x, y) = (middle(x).min(map.width - 1), middle(y).min(map.height - 1));
            map.pixels[(y * map.width + x) * map.channels..][..map.channels].to_vec()
        };
        let pixels = (0..height).flat_map(|y| (0..width).flat_map(move |x| pixel(x, y))).collect();
        canvas.picture(at, (self.width, self.height), &Image { width, height, channels: map.channels, pixels })
    }

    fn shrunk(&self, image: &Image) -> (usize, usize) {
        let side = |length: usize| (length / self.shrink).max(1);
        (side(image.width), side(image.height))
    }
}
