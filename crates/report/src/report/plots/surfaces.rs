//! Surfaces of a sweep's rows, side by side.

use super::Figure;
use crate::base::{Image, Result};
use crate::draw::canvas::{Anchor, BLACK, Canvas, LINE_HEIGHT, TEXT};

/// Images in a row, and pixels of an image in the figure.
const ACROSS: usize = 4;
const WIDTH: f64 = 240.0;
const GAP: f64 = 14.0;
const MARGIN: f64 = 20.0;
const TOP: f64 = 48.0;

/// A row's surface: its label and its image.
pub type Surface = (String, Image);

/// Draws the images under their rows' names, or returns `None` without any.
pub fn surfaces_figure(title: &str, surfaces: &[Surface]) -> Result<Option<Figure>> {
    if surfaces.is_empty() {
        return Ok(None);
    }
    let height = |(_, picture): &Surface| WIDTH * picture.height as f64 / picture.width.max(1) as f64;
    let tallest = surfaces.iter().map(height).fold(0.0, f64::max);
    let (across, down) = (surfaces.len().min(ACROSS), surfaces.len().div_ceil(ACROSS));
    let (step, cell) = (WIDTH + GAP, tallest + LINE_HEIGHT + GAP);
    let width = 2.0 * MARGIN + across as f64 * step - GAP;
    let mut drawing = Canvas::titled(width, TOP + down as f64 * cell + MARGIN, title);
    for (index, surface) in surfaces.iter().enumerate() {
        let (x, y) = (MARGIN + (index % ACROSS) as f64 * step, TOP + (index / ACROSS) as f64 * cell);
        drawing.text((x, y), &surface.0, TEXT, Anchor::Left, BLACK);
        drawing.picture((x, y + LINE_HEIGHT * 0.7), (WIDTH, height(surface)), &surface.1)?;
    }
    drawing.caption(
        "Level sets of density, of each row's first seed, from the first held-out view's camera: triangles lit by smooth \
         normals, one grey for all. What faces away from the camera is darker.",
    );
    drawing.finish().map(Some)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_has_its_picture_and_name() {
        let picture = Image { width: 4, height: 3, channels: 3, pixels: vec![0.5; 36] };
        let surfaces: Vec<Surface> = (0..5).map(|i| (format!("row {i}"), picture.clone())).collect();
        let figure = surfaces_figure("Surfaces", &surfaces).unwrap().unwrap();
        let (_, svg) = figure.files("surfaces").next().unwrap();
        let svg = String::from_utf8(svg).unwrap();
        assert!((0..5).all(|i| svg.contains(&format!("row {i}"))), "{svg}");
        assert_eq!(svg.matches("<image").count(), 5);
        assert!(surfaces_figure("none", &[]).unwrap().is_none());
    }
}
