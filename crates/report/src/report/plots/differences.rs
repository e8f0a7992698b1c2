//! Differences with their intervals on a horizontal scale, one line each.

use crate::draw::canvas::{
    Anchor, BLACK, BLUE, Canvas, Colour, GREY, GRID, LINE_HEIGHT, ORANGE, TEXT, tick_texts, wrapped,
};
use crate::report::tables::{Comparison, Judgement, Line};

/// Least height of a line.
const ROW: f64 = 24.0;
/// Height below a scale: its numbers.
pub(super) const FOOT: f64 = 26.0;
/// How the marks of differences are read.
pub(super) const MARKS: &str =
    "A blue triangle upwards is better, an orange one downwards worse, by Holm's p below 0.05 over";
pub(super) const NOT_SHOWN: &str = "Grey: no difference is shown, which proves no equality.";

/// A horizontal scale.
pub(super) struct Scale {
    pub(super) left: f64,
    pub(super) width: f64,
    pub(super) top: f64,
    pub(super) range: (f64, f64),
}

impl Scale {
    pub(super) fn x(&self, value: f64) -> f64 {
        self.left + self.width * (value - self.range.0) / (self.range.1 - self.range.0)
    }

    pub(super) fn right(&self) -> f64 {
        self.left + self.width
    }

    /// Returns the lines of a head that fits above the scale.
    pub(super) fn head(&self, text: &str) -> Vec<String> {
        wrapped(text, self.width, TEXT)
    }

    /// Draws grid, numbers and head of lines that end at `bottom`.
    pub(super) fn frame(&self, drawing: &mut Canvas, head: &[String], bottom: f64) {
        for (value, text) in tick_texts(self.range, self.width) {
            drawing.line(&[(self.x(value), self.top), (self.x(value), bottom)], GRID, 1.0);
            drawing.text((self.x(value), bottom + 12.0), &text, TEXT, Anchor::Middle, BLACK);
        }
        drawing.line(&[(self.left, bottom), (self.right(), bottom)], BLACK, 1.0);
        for (index, line) in head.iter().enumerate() {
            let above = (head.len() - 1 - index) as f64;
            let at = (self.left + self.width / 2.0, self.top - 12.0 - LINE_HEIGHT * above);
            drawing.text(at, line, TEXT, Anchor::Middle, BLACK);
        }
    }

    /// Draws the line of no difference.
    pub(super) fn zero(&self, drawing: &mut Canvas, bottom: f64) {
        drawing.line(&[(self.x(0.0), self.top), (self.x(0.0), bottom)], GREY, 1.5);
    }

    /// Draws a difference with its interval, in the colour of its judgement.
    pub(super) fn difference(&self, drawing: &mut Canvas, y: f64, metric: &str, comparison: &Comparison) {
        let Some((low, high)) = comparison.interval else {
            drawing.dot((self.x(comparison.difference), y), 4.0, GREY, 1.0);
            return;
        };
        let judgement = Judgement::of(metric, comparison);
        let (colour, at) = (colour(judgement), (self.x(comparison.difference), y));
        drawing.line(&[(self.x(low), y), (self.x(high), y)], colour, 2.0);
        match judgement {
            Judgement::Better | Judgement::Higher => drawing.triangle(at, 5.0, true, colour),
            Judgement::Worse | Judgement::Lower => drawing.triangle(at, 5.0, false, colour),
            Judgement::NotShown => drawing.dot(at, 4.0, colour, 1.0),
        }
    }
}

/// Returns the height of each line, by its name in a column of `width`.
pub(super) fn heights(names: &[String], width: f64) -> Vec<f64> {
    names.iter().map(|name| ROW.max(wrapped(name, width, TEXT).len() as f64 * LINE_HEIGHT + 6.0)).collect()
}

/// Returns the middle of each line, from `top` down, and the foot of the last.
pub(super) fn middles(heights: &[f64], top: f64) -> (Vec<f64>, f64) {
    let mut y = top;
    let middles = heights.iter().map(|height| {
        y += height;
        y - height / 2.0
    });
    (middles.collect(), y)
}

/// Returns the colour of a judgement; of a metric without a better direction, black.
pub(super) fn colour(judgement: Judgement) -> Colour {
    match judgement {
        Judgement::Better => BLUE,
        Judgement::Worse => ORANGE,
        Judgement::Higher | Judgement::Lower => BLACK,
        Judgement::NotShown => GREY,
    }
}

/// Returns a judgement in words; empty where no difference is shown.
pub(super) fn words(metric: &str, comparison: &Comparison) -> String {
    if comparison.interval.is_none() {
        return "one seed: no interval".into();
    }
    let judged = Some(Judgement::of(metric, comparison).name()).filter(|name| !name.is_empty());
    let equivalent = comparison.is_equivalent().then_some("equivalent");
    judged.into_iter().chain(equivalent).collect::<Vec<&str>>().join(", ")
}

/// Returns why a line has no number.
pub(super) fn absent(line: &Line) -> &str {
    let of = |status: &str| line.status.split(", ").any(|part| part.starts_with(status));
    match ["failed", "no data", "running", "waiting"].into_iter().find(|status| of(status)) {
        Some(status) if line.ids.is_empty() => status,
        _ => "not measured",
    }
}
