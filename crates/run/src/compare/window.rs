//! Boxes of pixels to zoom into, and the box in which runs differ most.

use rayon::prelude::*;
use serde::Serialize;

use crate::base::{Error, Image, Result};
use crate::draw::quantise;

/// A rectangle of pixels; `x` counts from the left, `y` from the top.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Window {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
}

impl Window {
    /// Returns an error if the window is empty or reaches beyond an image of `width` x `height`.
    pub fn check(self, width: usize, height: usize) -> Result<Window> {
        let fits = |start: usize, length: usize, all: usize| {
            length > 0 && start.checked_add(length).is_some_and(|end| end <= all)
        };
        if fits(self.x, self.width, width) && fits(self.y, self.height, height) {
            return Ok(self);
        }
        let Window { x, y, width: w, height: h } = self;
        Err(Error::Config(format!(
            "--zoom: a box of {w} x {h} pixels at ({x}, {y}) does not fit into the view of {width} x {height}; \
             give x,y,width,height with x + width at most {width} and y + height at most {height}"
        )))
    }
}

/// Returns a rectangle of an image.
pub fn crop(image: &Image, window: Window) -> Image {
    let Window { x, y, width, height } = window;
    let row = |line: usize| &image.pixels[(line * image.width + x) * image.channels..][..width * image.channels];
    let pixels = (y..y + height).flat_map(|line| row(line).to_vec()).collect();
    Image { width, height, channels: image.channels, pixels }
}

/// Returns the same of a mask of an image with `columns` columns.
pub fn crop_mask(mask: &[bool], columns: usize, window: Window) -> Vec<bool> {
    let Window { x, y, width, height } = window;
    (y..y + height).flat_map(|line| mask[line * columns + x..][..width].to_vec()).collect()
}

/// Sums of squared differences over all rectangles from the upper left corner, `[height + 1, width + 1]`, in units of
/// (1/255)^2. Those of 8-bit values are integers, so the sums are exact.
struct Sums {
    stride: usize,
    sums: Vec<u64>,
}

impl Sums {
    fn new(rendered: &Image, truth: &Image) -> Sums {
        let (a, b) = (quantise(&rendered.pixels), quantise(&truth.pixels));
        let stride = truth.width + 1;
        let mut sums = vec![0u64; stride * (truth.height + 1)];
        for y in 0..truth.height {
            let mut row = 0;
            for x in 0..truth.width {
                let at = (y * truth.width + x) * 3;
                row += (at..at + 3).map(|i| u64::from(a[i].abs_diff(b[i])).pow(2)).sum::<u64>();
                sums[(y + 1) * stride + x + 1] = sums[y * stride + x + 1] + row;
            }
        }
        Sums { stride, sums }
    }

    fn over(&self, Window { x, y, width, height }: Window) -> u64 {
        let at = |x: usize, y: usize| self.sums[y * self.stride + x];
        at(x + width, y + height) + at(x, y) - at(x + width, y) - at(x, y + height)
    }
}

/// Returns the window of `width` x `height` over which the squared errors of the best and worst rendering differ most.
/// For a single rendering, it is where the error is largest. Ties go to the first from above, then from the left. The
/// images are RGB of one size, at least as large as the window.
pub fn most_different(rendered: &[&Image], truth: &Image, (width, height): (usize, usize)) -> Window {
    let sums: Vec<Sums> = rendered.par_iter().map(|image| Sums::new(image, truth)).collect();
    let apart = |window: Window| {
        let errors = || sums.iter().map(|sums| sums.over(window));
        let best = if sums.len() > 1 { errors().min() } else { None };
        errors().max().unwrap_or(0) - best.unwrap_or(0)
    };
    let mut found = (0, Window { x: 0, y: 0, width, height });
    for y in 0..=truth.height - height {
        for x in 0..=truth.width - width {
            let window = Window { x, y, width, height };
            let difference = apart(window);
            if difference > found.0 {
                found = (difference, window);
            }
        }
    }
    found.1
}
