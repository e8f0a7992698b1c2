//! The data of one line in a figure of axes.

use super::Spread;
use crate::draw::canvas::short;

/// Returns a value as its axis shows it: one part for each setting that is varied together.
pub(super) fn tick(value: &str) -> Vec<String> {
    value.split(" / ").map(short).collect()
}

/// One line of one panel: the values of an axis, with measurements.
pub(super) struct Series<'a> {
    pub(super) axis: &'a str,
    pub(super) panel: &'a str,
    /// The row, with the values of further axes.
    pub(super) label: String,
    /// Value, then seed and number of each point.
    pub(super) points: Vec<(&'a str, Vec<(u64, f64)>)>,
}

impl Series<'_> {
    /// Returns panel and line.
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
