//! The data of one line in a figure of axes.

use super::Spread;
use super::places::Places;
use crate::draw::numbers::short;
use crate::report::{AxisValue, Record, Status, distinct, label};

/// Returns a value in a sentence.
pub(super) fn value_text(value: &str) -> String {
    value.split(" / ").map(short).collect::<Vec<String>>().join(" / ")
}

/// One line of one panel: the values of an axis, with measurements.
pub(super) struct Series<'a> {
    pub(super) axis: &'a str,
    pub(super) panel: &'a str,
    /// The row's name.
    pub(super) row: &'a str,
    /// The row, with the values of further axes.
    pub(super) label: String,
    /// Value, then seed and number of each point, in the order of drawing.
    pub(super) points: Vec<(&'a str, Vec<(u64, f64)>)>,
}

impl Series<'_> {
    pub(super) fn means(&self) -> Vec<(usize, Spread)> {
        let spread = |index: usize| Some((index, Spread::new(&numbers(&self.points[index].1))?));
        (0..self.points.len()).filter_map(spread).collect()
    }
}

fn numbers(seeds: &[(u64, f64)]) -> Vec<f64> {
    seeds.iter().map(|(_, number)| *number).collect()
}

/// Groups the points of a scene with axis values by first axis, row and values of further axes.
pub(super) fn series<'a>(records: &[&'a Record], metric: &str) -> Vec<Series<'a>> {
    let mut all: Vec<Series> = Vec::new();
    for record in records {
        let Some((AxisValue { axis, panel, value }, further)) = record.axes.split_first() else { continue };
        let label = label(&record.row, further);
        let same = |s: &Series| (s.axis, s.panel, &s.label) == (axis.as_str(), panel.as_str(), &label);
        let index = all.iter().position(same).unwrap_or_else(|| {
            all.push(Series { axis, panel, row: &record.row, label, points: Vec::new() });
            all.len() - 1
        });
        let points = &mut all[index].points;
        if points.iter().all(|(known, _)| known != value) {
            points.push((value, Vec::new()));
        }
        let (_, seeds) = points.iter_mut().find(|(known, _)| known == value).expect("just put there");
        seeds.extend(measured(record, metric).map(|value| (record.seed.unwrap_or_default(), value)));
    }
    for index in 0..all.len() {
        let places = places(&all, all[index].axis, all[index].panel);
        all[index].points.sort_by_key(|(value, _)| places.index(value));
    }
    all
}

/// Returns the values of a panel's lines.
pub(super) fn places<'a>(series: &[Series<'a>], axis: &str, panel: &str) -> Places<'a> {
    let lines = series.iter().filter(|s| (s.axis, s.panel) == (axis, panel));
    Places::new(&distinct(lines.flat_map(|s| s.points.iter().map(|(value, _)| *value))))
}

fn measured(record: &Record, metric: &str) -> Option<f64> {
    Some(record).filter(|r| r.status == Status::Done)?.metric(metric).filter(|value| value.is_finite())
}

/// Returns the values without any number, by why they have none: `failed: output steps = 3 (Aug-NeRF)`.
pub(super) fn absent(series: &[Series], records: &[&Record]) -> Vec<String> {
    let empty = |s: &Series| -> Vec<(&'static str, String)> {
        let values = s.points.iter().filter(|(_, seeds)| seeds.is_empty()).map(|(value, _)| *value);
        let why = |value: &str| {
            let own = |r: &&&Record| {
                r.axes.split_first().is_some_and(|(first, further)| {
                    (first.axis.as_str(), first.panel.as_str(), first.value.as_str()) == (s.axis, s.panel, value)
                        && label(&r.row, further) == s.label
                })
            };
            let status = records.iter().find(own).map_or(Status::NoData, |record| record.status);
            if status == Status::Done { "not measured" } else { status.name() }
        };
        let space = if s.panel.is_empty() { "" } else { " " };
        let text = |value: &str| format!("{}{space}{} = {} ({})", s.panel, s.axis, value_text(value), s.label);
        values.map(|value| (why(value), text(value))).collect()
    };
    let all: Vec<(&str, String)> = series.iter().flat_map(empty).collect();
    let of = |why: &&str| {
        let texts = all.iter().filter(|(own, _)| own == why).map(|(_, text)| text.as_str());
        format!("{why}: {}", texts.collect::<Vec<&str>>().join("; "))
    };
    distinct(all.iter().map(|(why, _)| *why)).iter().map(of).collect()
}
