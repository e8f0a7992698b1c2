//! The points, one line each.

use crate::draw::numbers::rounded;
use crate::metrics::Metric;
use crate::report::tables::Table;
use crate::report::{Record, Status};

/// A line.
pub struct Point<'a> {
    pub id: &'a str,
    pub link: String,
    pub scene: &'a str,
    pub label: String,
    pub seed: String,
    pub status: &'static str,
    pub reason: &'a str,
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
        label: rounded(&record.label()),
        seed: record.seed.map_or(String::new(), |seed| seed.to_string()),
        status: record.status.name(),
        reason: &record.reason,
        metrics: table.metrics.iter().enumerate().map(|metric| number(record, metric)).collect(),
    };
    records.iter().map(point).collect()
}
