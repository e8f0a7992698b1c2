//! A fade between two runs, as a GIF.

use std::path::Path;

use super::comparison::{Comparison, Side, metrics_text};
use super::display_size::DisplaySize;
use crate::base::{Error, Image, Result};
use crate::draw::canvas::{Anchor, BLACK, Canvas, LINE_HEIGHT, TEXT, wrapped};
use crate::draw::{SVG_ALONE, write_timed_gif};

/// Hundredths of a second that each run is shown, and each step between.
const STAY: u16 = 120;
const STEP: u16 = 8;
/// Steps of the fade from one run to the other.
const STEPS: usize = 9;

/// Writes both runs in turn, each under its name, with a fade from one to the other and back.
pub fn write_fade(comparison: &Comparison, path: &Path) -> Result<()> {
    check_fade(comparison.sides.len())?;
    let scale = DisplaySize::alone(comparison.truth());
    let texts: Vec<Vec<String>> = comparison.sides.iter().map(|side| text(side, scale.width)).collect();
    let lines = texts.iter().map(Vec::len).max().unwrap_or(0);
    let names = texts.iter().map(|text| name_strip(text, lines, scale.width)).collect::<Result<Vec<Image>>>()?;
    let views =
        comparison.sides.iter().map(|side| scale.raster(&side.rendered.image)).collect::<Result<Vec<Image>>>()?;
    let frame = |step: usize| {
        let share = step as f32 / (STEPS + 1) as f32;
        // Names change at once, since two names over each other are unreadable.
        let name = &names[if share < 0.5 { 0 } else { 1 }];
        let mixed = views[0].pixels.iter().zip(&views[1].pixels).map(|(a, b)| a + share * (b - a));
        let pixels: Vec<f32> = name.pixels.iter().copied().chain(mixed).collect();
        Image { height: name.height + views[0].height, pixels, ..*name }
    };
    let frames: Vec<Image> = (0..=STEPS + 1).chain((1..=STEPS).rev()).map(frame).collect();
    let delays: Vec<u16> = (0..frames.len()).map(|i| if i % (STEPS + 1) == 0 { STAY } else { STEP }).collect();
    write_timed_gif(path, &frames, &delays)
}

/// Returns name and metrics in lines of at most `width`.
fn text(side: &Side, width: f64) -> Vec<String> {
    let both = [side.run.caption(), metrics_text(&side.metrics)];
    both.iter().flat_map(|text| wrapped(text, width - 8.0, TEXT)).collect()
}

/// Draws text on a white strip of `lines` lines.
fn name_strip(text: &[String], lines: usize, width: f64) -> Result<Image> {
    let mut canvas = Canvas::new(width, lines as f64 * LINE_HEIGHT + 6.0);
    for (index, line) in text.iter().enumerate() {
        let y = 3.0 + (index as f64 + 0.5) * LINE_HEIGHT;
        canvas.text((4.0, y), line, TEXT, Anchor::Left, BLACK);
    }
    canvas.raster()
}

/// Returns an error unless there are exactly two runs and figures are drawn as pixels.
pub fn check_fade(runs: usize) -> Result<()> {
    let refused = match (runs, SVG_ALONE) {
        (2, None) => return Ok(()),
        (2, Some(why)) => format!("--gif needs drawn pixels, but {why}; omit --gif"),
        _ => format!("--gif fades between two runs, but there are {runs}; name two, or omit --gif"),
    };
    Err(Error::Config(refused))
}
