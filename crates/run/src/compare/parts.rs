//! Parts that figures of several runs share: lines of text, colour bars, a note on corrupted views.

use super::run_view::RunView;
use crate::base::{Image, Result};
use crate::draw::canvas::{Anchor, BLACK, Canvas, Colour, GREY, LINE_HEIGHT, TEXT, number, ticks, wrapped};
use crate::draw::scale_colour;

/// Height of [`colour_bar`] with its numbers and name.
pub const BAR: f64 = 46.0;

/// Draws a colour bar with numbers and a name below. The map's colours run from left to right, or from right to left
/// if `falling`.
pub fn colour_bar(
    canvas: &mut Canvas,
    (x, y): (f64, f64),
    width: f64,
    (low, high): (f32, f32),
    falling: bool,
    name: &str,
) -> Result<()> {
    const COLOURS: usize = 256;
    const HEIGHT: f64 = 12.0;
    let share = |i: usize| i as f32 / (COLOURS - 1) as f32;
    let colours = (0..COLOURS).flat_map(|i| scale_colour(if falling { 1.0 - share(i) } else { share(i) }));
    let picture = Image { width: COLOURS, height: 1, channels: 3, pixels: colours.collect() };
    canvas.picture((x, y), (width, HEIGHT), &picture)?;
    let (low, high) = (f64::from(low), f64::from(high));
    // A scale without length, for a constant depth, has one number.
    let (values, step) = if high > low { ticks((low, high), 4) } else { (vec![low], 1e-3) };
    for value in values {
        let at = x + width * (value - low) / (high - low).max(f64::MIN_POSITIVE);
        canvas.line(&[(at, y + HEIGHT), (at, y + HEIGHT + 4.0)], BLACK, 1.0);
        canvas.text((at, y + HEIGHT + 12.0), &number(value, step), TEXT, Anchor::Middle, BLACK);
    }
    canvas.text((x + width / 2.0, y + HEIGHT + 28.0), name, TEXT, Anchor::Middle, BLACK);
    Ok(())
}

/// Draws grey lines of text of at most `width`, from `(x, y)` down; returns the position after them.
pub fn note(canvas: &mut Canvas, at: (f64, f64), width: f64, text: &str) -> f64 {
    if text.is_empty() { at.1 } else { lines(canvas, at, width, text, (TEXT, GREY)) }
}

/// Draws the same with a given size and colour.
pub fn lines(
    canvas: &mut Canvas,
    (x, mut y): (f64, f64),
    width: f64,
    text: &str,
    (size, colour): (f64, Colour),
) -> f64 {
    for line in wrapped(text, width, size) {
        canvas.text((x, y), &line, size, Anchor::Left, colour);
        y += LINE_HEIGHT;
    }
    y
}

/// Returns a note if all runs were trained on views with the same corruption; differences are shown elsewhere.
pub fn trained_on<'a>(runs: impl Iterator<Item = &'a RunView>) -> String {
    let mut what: Vec<String> = runs.map(|run| run.protocol.text("corruption")).collect();
    what.dedup();
    match &what[..] {
        [what] if !what.is_empty() => format!(" All runs were trained on corrupted views: {what}."),
        _ => String::new(),
    }
}
