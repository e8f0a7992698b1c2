//! Parts that figures of several runs share: lines of text, colour bars, a note on corrupted views.

use super::run_view::RunView;
use crate::base::{Image, Result};
use crate::data::View;
use crate::draw::canvas::{Anchor, BLACK, Canvas, GREY, LINE_HEIGHT, TEXT, text_width, ticks, wrapped};
use crate::draw::numbers::numbers;
use crate::draw::{scale_colour, stripe};

/// Returns a view's photo with stripes where it is masked.
pub fn striped(view: &View) -> Image {
    let mut photo = view.image.as_ref().clone();
    view.mask.iter().for_each(|mask| stripe(&mut photo, mask));
    photo
}

/// Draws a colour bar with numbers and a name below. The map's colours run from left to right, or from right to left
/// if `falling`. Returns the position after it.
pub fn colour_bar(
    canvas: &mut Canvas,
    (x, y): (f64, f64),
    width: f64,
    (low, high): (f32, f32),
    falling: bool,
    name: &str,
) -> Result<f64> {
    const COLOURS: usize = 256;
    const HEIGHT: f64 = 12.0;
    let share = |i: usize| i as f32 / (COLOURS - 1) as f32;
    let colours = (0..COLOURS).flat_map(|i| scale_colour(if falling { 1.0 - share(i) } else { share(i) }));
    let picture = Image { width: COLOURS, height: 1, channels: 3, pixels: colours.collect() };
    canvas.picture((x, y), (width, HEIGHT), &picture)?;
    let (low, high) = (f64::from(low), f64::from(high));
    // A scale without length, for a constant depth, has one number.
    let (values, step) = if high > low { ticks((low, high), 4) } else { (vec![low], 1e-3) };
    for (value, text) in values.iter().zip(numbers(&values, step)) {
        let at = x + width * (value - low) / (high - low).max(f64::MIN_POSITIVE);
        canvas.line(&[(at, y + HEIGHT), (at, y + HEIGHT + 4.0)], BLACK, 1.0);
        // A number at the bar's end does not leave it.
        let half = (text_width(&text, TEXT) / 2.0).min(width / 2.0);
        let middle = at.clamp(x + half, x + width - half);
        canvas.text((middle, y + HEIGHT + 12.0), &text, TEXT, Anchor::Middle, BLACK);
    }
    let mut foot = y + HEIGHT + 28.0;
    for line in wrapped(name, width, TEXT) {
        canvas.text((x + width / 2.0, foot), &line, TEXT, Anchor::Middle, BLACK);
        foot += LINE_HEIGHT;
    }
    Ok(foot)
}

/// Draws grey lines of text of at most `width`, from `(x, y)` down; returns the position after them.
pub fn note(canvas: &mut Canvas, at: (f64, f64), width: f64, text: &str) -> f64 {
    if text.is_empty() { at.1 } else { canvas.lines(at, width, text, GREY) }
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
