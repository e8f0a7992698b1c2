//! The points, one line each.

use crate::draw::numbers::rounded;
use crate::metrics::Metric;
use crate::report::tables::Table;
use crate::report::{Record, Status, distinct};

/// Fewer values than this on each axis are better read in the table.
const LEAST: usize = 3;

/// A line.
pub struct Point<'a> {
    pub id: &'a str,
    pub link: String,
    pub scene: &'a str,
    /// The row without its values on axes.
    pub row: &'a str,
    pub label: String,
    pub seed: String,
    pub status: &'static str,
    pub reason: &'a str,
    /// Values on axes, as a JSON object; empty for a point without axes.
    pub axes: String,
    /// Column group, sort key and text of each metric.
    pub metrics: Vec<(usize, String, String)>,
}

pub fn points<'a>(table: &Table, records: &'a [Record], link: &dyn Fn(&str) -> Option<String>) -> Vec<Point<'a>> {
    let number = |record: &Record, (group, key): (usize, &String)| {
        let value = Some(record).filter(|record| record.status == Status::Done).and_then(|record| record.metric(key));
        let text = |value| Metric::find(key).map_or_else(|| f64::to_string(&value), |metric| metric.text(value));
        (group, value.map_or(String::new(), |value| value.to_string()), value.map_or(String::new(), text))
    };
    let point = |record: &'a Record| Point {
        id: &record.id,
        link: link(&record.id).unwrap_or_default(),
        scene: &record.scene,
        row: &record.row,
        label: rounded(&record.label()),
        seed: record.seed.map_or(String::new(), |seed| seed.to_string()),
        status: record.status.name(),
        reason: &record.reason,
        axes: axes(record),
        metrics: table.metrics.iter().enumerate().map(|metric| number(record, metric)).collect(),
    };
    records.iter().map(point).collect()
}

/// Returns whether an axis has so many values that points are worth drawing against them.
pub fn has_axes(records: &[Record]) -> bool {
    let of = |(axis, panel): (&str, &str)| {
        let all = records.iter().flat_map(|record| &record.axes);
        distinct(all.filter(|value| value.axis == axis && value.panel == panel).map(|value| &value.value)).len()
    };
    let axes = distinct(records.iter().flat_map(|record| &record.axes).map(|v| (v.axis.as_str(), v.panel.as_str())));
    axes.into_iter().any(|axis| of(axis) >= LEAST)
}

fn axes(record: &Record) -> String {
    let name = |panel: &str, axis: &str| if panel.is_empty() { axis.into() } else { format!("{panel} {axis}") };
    let value = |text: &str| match text.parse::<f64>() {
        Ok(number) if number.is_finite() => serde_json::json!(number),
        _ => serde_json::json!(text),
    };
    let values = record.axes.iter().map(|axis| (name(&axis.panel, &axis.axis), value(&axis.value)));
    match record.axes.is_empty() {
        true => String::new(),
        false => serde_json::Value::Object(values.collect()).to_string(),
    }
}
