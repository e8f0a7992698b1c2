//! What a line of a figure of axes is drawn from.

use super::Spread;
use crate::draw::canvas::short;

/// A value as its axis has it: one part for each setting that is varied together.
pub(super) fn tick(value: &str) -> Vec<String> {
    value.split(" / ").map(short).collect()
}

/// One line of one panel: values of an axis with what was measured there.
pub(super) struct Series<'a> {
    pub(super) axis: &'a str,
    pub(super) panel: &'a str,
    /// The row, with the values of further axes.
    pub(super) label: String,
    /// Value, then seed and number of each point.
    pub(super) points: Vec<(&'a str, Vec<(u64, f64)>)>,
}

impl Series<'_> {
    /// Which line of which panel it is.
    pub(super) fn place(&self) -> (&str, &str, &str) {
        (self.axis, self.panel, &self.label)
    }

    pub(super) fn means(&self) -> Vec<(usize, Spread)> {
        let spread = |index: usize| Some((index, Spread::new(&numbers(&self.points[index].1))?));
        (0..self.points.len()).filter_map(spread).collect()
    }
}

fn numbers(seeds: &[(u64, f64)]) -> Vec<f64> {
    seeds.iter().map(|(_, number)| *number).collect()
}
