//! Samples of lines with their names, in as many columns as fit.

use super::Stroke;
use crate::draw::canvas::{Anchor, BLACK, Canvas, LINE_HEIGHT, SIDE, TEXT, text_width, wrapped};

/// Width of a line's sample, and of the gap after it.
const SAMPLE: f64 = 28.0;
const GAP: f64 = 6.0;
const BETWEEN: f64 = 18.0;

/// Draws the entries below everything; the drawing grows by their height.
pub(super) fn draw(drawing: &mut Canvas, entries: &[(&str, Stroke)]) {
    let room = drawing.width - 2.0 * SIDE;
    let longest = entries.iter().map(|(name, _)| text_width(name, TEXT)).fold(0.0, f64::max);
    let columns = (((room + BETWEEN) / (SAMPLE + GAP + longest + BETWEEN)) as usize).clamp(1, entries.len().max(1));
    let step = (room + BETWEEN) / columns as f64;
    for line in entries.chunks(columns) {
        let mut lines = 1;
        for (column, (name, stroke)) in line.iter().enumerate() {
            let (x, y) = (SIDE + column as f64 * step, drawing.height + LINE_HEIGHT / 2.0);
            Stroke { width: 2.5, ..*stroke }.draw(drawing, &[(x, y), (x + SAMPLE, y)]);
            let name = wrapped(name, step - BETWEEN - SAMPLE - GAP, TEXT);
            lines = lines.max(name.len());
            for (index, part) in name.iter().enumerate() {
                let at = (x + SAMPLE + GAP, y + LINE_HEIGHT * index as f64);
                drawing.text(at, part, TEXT, Anchor::Left, BLACK);
            }
        }
        drawing.height += LINE_HEIGHT * lines as f64;
    }
    drawing.height += LINE_HEIGHT / 2.0;
}
