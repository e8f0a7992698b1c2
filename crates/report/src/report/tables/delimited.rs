//! CSV: one line a point, and one line a row. A missing number is an empty cell.

use super::{Cell, Line, Table, axes_text, distinct, protocol_names};
use crate::base::csv::{csv_number, csv_text};
use crate::report::statistics::mean;
use crate::report::{Record, Status};
use crate::settings::columns::is_per_seed;

/// Clock times of a point: its folder's name, and name and value of each.
pub type PointTiming = (String, Vec<(String, Option<f64>)>);

pub(super) const POINT_COLUMNS: [&str; 8] =
    ["id", "scene", "row", "axes", "seed", "status", "reason", "inactive_levels"];
/// Columns that identify a line of the table.
pub(super) const PLACE_COLUMNS: [&str; 4] = ["scene", "source", "row", "axes"];
const LINE_COLUMNS: [&str; 9] =
    ["baseline", "ours", "points", "done", "status", "reason", "inactive_levels", "differs", "mixed"];
const CELL_COLUMNS: [&str; 11] =
    ["n", "mean", "std", "pairs", "difference", "low", "high", "p", "p_holm", "verdict", "published"];
/// Columns of metrics with a margin.
const EQUIVALENCE_COLUMNS: [&str; 4] = ["margin", "p_equivalence", "p_equivalence_holm", "equivalent"];
/// Numbers of a backbone that the paper does not name.
const PUBLISHED_COLUMNS: [&str; 4] =
    ["published_lpips", "published_average", "published_protocol", "protocol_difference"];

/// Returns one line a point: identity, metrics, protocol and, if given, clock times.
pub fn points_csv(records: &[Record], timing: &[PointTiming]) -> String {
    let metrics = distinct(records.iter().flat_map(|record| record.metrics.iter().map(|(name, _)| name.as_str())));
    // The seed already has its column.
    let protocol = distinct(records.iter().flat_map(protocol_names).filter(|name| *name != "seed"));
    let clocks = clock_names(timing);
    let rows = records.iter().map(|record| {
        let mut row = point_cells(record);
        // Numbers of an earlier attempt are not the point's.
        let measured = |metric| Some(record).filter(|r| r.status == Status::Done).and_then(|r| r.metric(metric));
        row.extend(metrics.iter().map(|metric| csv_number(measured(metric))));
        row.extend(protocol.iter().map(|name| record.protocol(name).to_string()));
        row.extend(clocks.iter().map(|name| csv_number(clock(timing, &record.id, name))));
        row
    });
    let head = POINT_COLUMNS.iter().chain(&metrics).chain(&protocol).chain(&clocks);
    csv_text(std::iter::once(head.map(ToString::to_string).collect()).chain(rows))
}

fn point_cells(record: &Record) -> Vec<String> {
    vec![
        record.id.clone(),
        record.scene.clone(),
        record.row.clone(),
        axes_text(record),
        record.seed.map_or(String::new(), |seed| seed.to_string()),
        record.status.name().into(),
        record.reason.clone(),
        record.inactive_levels.join(" "),
    ]
}

/// Returns one line for each measured point: its folder's name, identity and clock times. A point in several rows has
/// one line.
pub fn timing_csv(records: &[Record], timing: &[PointTiming]) -> String {
    let head = ["id", "point"].into_iter().chain(clock_names(timing)).map(String::from).collect();
    let rows = timing.iter().map(|(id, clocks)| {
        let record = records.iter().find(|record| record.id == *id);
        let point = record.map_or(String::new(), Record::point_label);
        let clocks = clocks.iter().map(|(_, value)| csv_number(*value));
        [id.clone(), point].into_iter().chain(clocks).collect()
    });
    csv_text(std::iter::once(head).chain(rows))
}

/// Returns one line a row: counts, each metric with its comparison, the published numbers, the protocol that its seeds
/// share and, if given, its mean clock times.
pub fn table_csv(table: &Table, timing: &[PointTiming]) -> String {
    let names = table.lines.iter().flat_map(|line| line.protocol.iter().map(|(name, _)| name.as_str()));
    let differing = table.lines.iter().flat_map(|line| line.differs.iter().map(String::as_str));
    let protocol = distinct(names.chain(differing).filter(|name| !is_per_seed(name)));
    let clocks = clock_names(timing);
    let tested: Vec<bool> = (0..table.metrics.len()).map(|metric| is_tested(table, metric)).collect();
    let rows = table.lines.iter().map(|line| {
        let mut row = place_cells(line).to_vec();
        row.extend(line_cells(line));
        row.extend(line.cells.iter().zip(&tested).flat_map(|(cell, tested)| cell_cells(cell, *tested)));
        row.extend([csv_number(line.published_lpips), csv_number(line.published_average)]);
        row.extend([line.published_protocol.clone(), line.protocol_difference.clone()]);
        row.extend(protocol.iter().map(|name| line.protocol(name).to_string()));
        row.extend(clocks.iter().map(|name| csv_number(mean_clock(timing, &line.ids, name))));
        row
    });
    let mut head: Vec<String> = PLACE_COLUMNS.iter().chain(&LINE_COLUMNS).map(ToString::to_string).collect();
    for (metric, tested) in table.metrics.iter().zip(&tested) {
        let equivalence: &[&str] = if *tested { &EQUIVALENCE_COLUMNS } else { &[] };
        head.extend(CELL_COLUMNS.iter().chain(equivalence).map(|column| format!("{metric}_{column}")));
    }
    head.extend(PUBLISHED_COLUMNS.iter().chain(&protocol).map(ToString::to_string));
    head.extend(clocks.iter().map(|name| format!("{name}_mean")));
    csv_text(std::iter::once(head).chain(rows))
}

pub(super) fn place_cells(line: &Line) -> [String; PLACE_COLUMNS.len()] {
    let source = match (line.quoted, line.scored) {
        (true, _) => "published",
        (_, true) => "scored",
        _ => "run",
    };
    [line.scene.clone(), source.into(), line.row.clone(), line.axes.clone()]
}

fn line_cells(line: &Line) -> [String; LINE_COLUMNS.len()] {
    [
        line.baseline.clone().unwrap_or_default(),
        line.ours.to_string(),
        line.points.to_string(),
        line.ids.len().to_string(),
        line.status.clone(),
        line.reason.clone(),
        line.inactive_levels.join(" "),
        line.differs.join(" "),
        line.mixed.join(" "),
    ]
}

/// Returns whether equivalence is tested for a metric.
fn is_tested(table: &Table, metric: usize) -> bool {
    let mut comparisons = table.lines.iter().filter_map(|line| line.cells[metric].comparison);
    comparisons.any(|comparison| comparison.equivalence.is_some())
}

fn cell_cells(cell: &Cell, tested: bool) -> Vec<String> {
    let comparison = cell.comparison.as_ref();
    let interval = comparison.and_then(|comparison| comparison.interval);
    let mut cells = vec![
        cell.n.to_string(),
        csv_number(cell.mean),
        csv_number(cell.deviation),
        comparison.map_or(String::new(), |comparison| comparison.pairs.to_string()),
        csv_number(comparison.map(|comparison| comparison.difference)),
        csv_number(interval.map(|(low, _)| low)),
        csv_number(interval.map(|(_, high)| high)),
        csv_number(comparison.and_then(|comparison| comparison.p)),
        csv_number(comparison.and_then(|comparison| comparison.p_holm)),
        comparison.and_then(|comparison| comparison.verdict()).map_or("", |verdict| verdict.name()).into(),
        csv_number(cell.published),
    ];
    if tested {
        let equivalence = comparison.and_then(|comparison| comparison.equivalence);
        let known = equivalence.filter(|equivalence| equivalence.p_holm.is_some());
        cells.extend([
            csv_number(equivalence.map(|equivalence| equivalence.margin)),
            csv_number(equivalence.and_then(|equivalence| equivalence.p)),
            csv_number(equivalence.and_then(|equivalence| equivalence.p_holm)),
            known.map_or(String::new(), |equivalence| equivalence.holds().to_string()),
        ]);
    }
    cells
}

fn clock_names(timing: &[PointTiming]) -> Vec<&str> {
    distinct(timing.iter().flat_map(|(_, clocks)| clocks.iter().map(|(name, _)| name.as_str())))
}

fn clock(timing: &[PointTiming], id: &str, name: &str) -> Option<f64> {
    let (_, clocks) = timing.iter().find(|(known, _)| known == id)?;
    clocks.iter().find(|(known, _)| known == name).and_then(|(_, value)| *value)
}

fn mean_clock(timing: &[PointTiming], ids: &[String], name: &str) -> Option<f64> {
    let values: Vec<f64> = ids.iter().filter_map(|id| clock(timing, id, name)).collect();
    mean(&values)
}
