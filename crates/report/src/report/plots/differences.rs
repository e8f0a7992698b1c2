//! Differences with their intervals on a horizontal scale, one line each.

use crate::draw::canvas::{Anchor, BLACK, BLUE, Canvas, Colour, GREY, GRID, RED, TEXT, number, text_width, ticks};
use crate::report::tables::{Comparison, Verdict};

/// Height of a line.
pub(super) const ROW: f64 = 26.0;
/// Width of a scale.
pub(super) const PANEL: f64 = 330.0;
/// Position of the first line, below the title.
pub(super) const TOP: f64 = 64.0;

/// A horizontal scale.
pub(super) struct Scale {
    pub(super) left: f64,
    pub(super) range: (f64, f64),
}

impl Scale {
    pub(super) fn x(&self, value: f64) -> f64 {
        self.left + PANEL * (value - self.range.0) / (self.range.1 - self.range.0)
    }

    /// Draws grid, numbers and title of lines that end at `bottom`.
    pub(super) fn frame(&self, drawing: &mut Canvas, title: &str, bottom: f64) {
        let (values, step) = ticks(self.range, 5);
        for value in values {
            drawing.line(&[(self.x(value), TOP), (self.x(value), bottom)], GRID, 1.0);
            drawing.text((self.x(value), bottom + 12.0), &number(value, step), TEXT, Anchor::Middle, BLACK);
        }
        drawing.line(&[(self.left, bottom), (self.left + PANEL, bottom)], BLACK, 1.0);
        drawing.text((self.left + PANEL / 2.0, TOP - 14.0), title, TEXT, Anchor::Middle, BLACK);
    }

    /// Draws the line of no difference.
    pub(super) fn zero(&self, drawing: &mut Canvas, bottom: f64) {
        drawing.line(&[(self.x(0.0), TOP), (self.x(0.0), bottom)], GREY, 1.5);
    }

    /// Draws a difference with its interval and verdict, in the verdict's colour.
    pub(super) fn difference(&self, drawing: &mut Canvas, y: f64, comparison: &Comparison, words: &str) {
        let Some((low, high)) = comparison.interval else {
            drawing.text((self.left + PANEL + 10.0, y), "one seed: no interval", TEXT, Anchor::Left, GREY);
            return;
        };
        let colour = colour(comparison);
        drawing.line(&[(self.x(low), y), (self.x(high), y)], colour, 2.0);
        drawing.dot((self.x(comparison.difference), y), 4.0, colour, 1.0);
        drawing.text((self.left + PANEL + 10.0, y), words, TEXT, Anchor::Left, colour);
    }
}

/// Returns the colour by the rule that tables follow.
pub(super) fn colour(comparison: &Comparison) -> Colour {
    match comparison.verdict() {
        Some(verdict) if verdict.is_difference() => RED,
        _ if comparison.is_equivalent() => BLUE,
        _ => GREY,
    }
}

pub(super) fn words(comparison: &Comparison) -> String {
    let verdict = comparison.verdict().map(Verdict::name);
    let equivalent = comparison.is_equivalent().then_some("equivalent");
    verdict.into_iter().chain(equivalent).collect::<Vec<&str>>().join(", ")
}

/// Returns the width of the longest text, at least `least`.
pub(super) fn widest<'a>(texts: impl Iterator<Item = &'a str>, least: f64) -> f64 {
    texts.map(|text| text_width(text, TEXT)).fold(least, f64::max)
}
