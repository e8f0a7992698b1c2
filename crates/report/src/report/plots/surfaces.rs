//! Surfaces of a sweep's rows, side by side.

use super::{Figure, Style, canvas};
use crate::base::{Image, Result};
use crate::data::resample::shrink;
use crate::draw::canvas::{BLACK, FINENESS, LINE_HEIGHT, SIDE, TEXT, wrapped};

/// Images in a row of a page and of a column.
const ACROSS: (usize, usize) = (4, 2);
const GAP: f64 = 14.0;

/// A row's surface: its label and its image.
pub type Surface = (String, Image);

/// Draws the images under their rows' names, or returns `None` without any.
pub fn surfaces_figure(style: Style, scene: &str, surfaces: &[Surface]) -> Result<Option<Figure>> {
    if surfaces.is_empty() {
        return Ok(None);
    }
    let mut drawing = canvas(style.width);
    let across = style.width.pick(ACROSS.0, ACROSS.1);
    let width = ((drawing.width - 2.0 * SIDE + GAP) / across as f64 - GAP).floor();
    let height = |picture: &Image| (width * picture.height as f64 / picture.width.max(1) as f64).round();
    for line in surfaces.chunks(across) {
        let names: Vec<Vec<String>> = line.iter().map(|(name, _)| wrapped(name, width, TEXT)).collect();
        let lines = names.iter().map(Vec::len).max().unwrap_or(1) as f64;
        let top = drawing.height + LINE_HEIGHT * (lines + 0.2);
        for (column, ((name, picture), wrapped)) in line.iter().zip(&names).enumerate() {
            let x = SIDE + column as f64 * (width + GAP);
            let first = top - LINE_HEIGHT * (wrapped.len() as f64 - 0.2);
            drawing.lines((x, first), width, name, BLACK);
            let pixels = |units: f64, most: usize| ((units * FINENESS) as usize).clamp(1, most.max(1));
            let small = shrink(picture, pixels(width, picture.width), pixels(height(picture), picture.height));
            drawing.picture((x, top), (width, height(picture)), &small)?;
        }
        drawing.height = top + line.iter().map(|(_, picture)| height(picture)).fold(0.0, f64::max) + GAP;
    }
    style.finish(
        drawing,
        &format!("Surfaces of {scene}"),
        "Level sets of density, of each row's first seed, from the first held-out view's camera: triangles lit by smooth \
         normals, one grey for all. What faces away from the camera is darker.",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::TableSpec;
    use crate::report::plots::Width;

    #[test]
    fn every_row_has_its_picture_and_name() {
        let picture = Image { width: 4, height: 3, channels: 3, pixels: vec![0.5; 36] };
        let surfaces: Vec<Surface> = (0..5).map(|i| (format!("row {i}"), picture.clone())).collect();
        let spec = TableSpec::default();
        for width in Width::ALL {
            let style = Style { spec: &spec, width };
            let svg = surfaces_figure(style, "fern", &surfaces).unwrap().unwrap().svg;
            assert!((0..5).all(|i| svg.contains(&format!("row {i}"))), "{svg}");
            assert_eq!(svg.matches("<image").count(), 5);
            assert!(surfaces_figure(style, "fern", &[]).unwrap().is_none());
        }
    }
}
