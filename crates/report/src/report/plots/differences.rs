//! Differences with their intervals on a horizontal scale, one line each.

use super::{Figure, canvas, captioned, range_of};
use crate::draw::canvas::{
    Anchor, BLACK, BLUE, Canvas, Colour, GREY, GRID, LINE_HEIGHT, ORANGE, PAGE, SIDE, TEXT, text_width, tick_texts,
    wrapped,
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

/// Height of the ends of a further interval.
const WHISKER: f64 = 5.0;
/// Room of the words at the right.
const WORDS: f64 = 190.0;
/// Most room of the names.
const NAMES: f64 = 250.0;

/// A figure of differences alone: a name, a difference and words on each line.
pub(super) struct Differences<'a> {
    pub(super) title: String,
    pub(super) metric: &'a str,
    /// Name of the scale.
    pub(super) head: String,
    /// Name and words of each line.
    pub(super) lines: Vec<(String, String)>,
    /// All that is drawn.
    pub(super) values: Vec<f64>,
    /// Drawn as dashed lines, on both sides of 0.
    pub(super) margin: Option<f64>,
    pub(super) caption: String,
}

impl Differences<'_> {
    /// Draws the figure; `draw` draws the marks of a line at a height.
    pub(super) fn figure(&self, draw: impl Fn(&mut Canvas, &Scale, f64, usize)) -> Figure {
        let mut drawing = canvas();
        let names: Vec<String> = self.lines.iter().map(|(name, _)| name.clone()).collect();
        let widest = names.iter().map(|name| text_width(name, TEXT)).fold(60.0, f64::max);
        let room = widest.min(NAMES);
        let left = SIDE + room + 10.0;
        let margins = || self.margin.into_iter().flat_map(|margin| [-margin, margin]);
        let mut scale = Scale {
            left,
            width: PAGE - left - WORDS - SIDE - 10.0,
            top: 0.0,
            range: range_of(self.metric, self.values.iter().copied().chain([0.0]).chain(margins()))
                .unwrap_or((-1.0, 1.0)),
        };
        let head = scale.head(&self.head);
        scale.top = drawing.height + head.len() as f64 * LINE_HEIGHT + 8.0;
        let words: Vec<Vec<String>> = self.lines.iter().map(|(_, words)| wrapped(words, WORDS, TEXT)).collect();
        let rooms = words.iter().map(|lines| lines.len() as f64 * LINE_HEIGHT + 6.0);
        let heights: Vec<f64> = heights(&names, room).into_iter().zip(rooms).map(|(a, b)| a.max(b)).collect();
        let (middles, bottom) = middles(&heights, scale.top);
        scale.frame(&mut drawing, &head, bottom);
        scale.zero(&mut drawing, bottom);
        for end in margins() {
            drawing.dashed(&[(scale.x(end), scale.top), (scale.x(end), bottom)], GREY, 1.0);
        }
        for (index, ((name, words), y)) in names.iter().zip(&words).zip(middles).enumerate() {
            drawing.name((left - 10.0, y), room, name);
            draw(&mut drawing, &scale, y, index);
            let first = y - LINE_HEIGHT * (words.len() as f64 - 1.0) / 2.0;
            for (index, line) in words.iter().enumerate() {
                let at = (scale.right() + 10.0, first + LINE_HEIGHT * index as f64);
                drawing.text(at, line, TEXT, Anchor::Left, GREY);
            }
        }
        drawing.height = bottom + FOOT;
        captioned(drawing, &self.title, &self.caption)
    }
}

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

    /// Draws an interval as a thin line with ends.
    pub(super) fn whiskers(&self, drawing: &mut Canvas, y: f64, (low, high): (f64, f64), colour: Colour) {
        drawing.line(&[(self.x(low), y), (self.x(high), y)], colour, 0.8);
        for end in [low, high] {
            drawing.line(&[(self.x(end), y - WHISKER), (self.x(end), y + WHISKER)], colour, 0.8);
        }
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
