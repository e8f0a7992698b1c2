//! CSV: one line a point, and one line a row. A missing number is an empty cell.

use std::collections::HashMap;

use serde_json::Value;

use super::sheet::{Column, ColumnOf, Constants, compact, constants_of, csv_of};
use super::{Cell, Line, Table, axes_text, distinct, protocol_names};
use crate::base::columns::is_per_seed;
use crate::metrics::FLOOR_PSNR;
use crate::report::statistics::mean;
use crate::report::{Record, Status};

/// Clock times of a point: its folder's name, and name and value of each.
pub type PointTiming = (String, Vec<(String, Option<f64>)>);

/// The column that tells lines of one point apart.
pub const POSITION: &str = "position";
/// Columns that identify a line of the table.
pub(super) const PLACE_COLUMNS: [&str; 4] = ["scene", "source", "row", "axes"];

/// Returns the protocol fields that all measured points share; none of them is a column of [`points_csv`] and [`table_csv`].
pub fn constants(records: &[Record]) -> Constants {
    let done: Vec<&Record> = records.iter().filter(|record| record.status == Status::Done).collect();
    constants_of(protocol_columns(&done))
}

/// Returns one line a point: identity, metrics, protocol but for `constants` and, if given, clock times.
pub fn points_csv(records: &[Record], timing: &[PointTiming], constants: &Constants, column_of: ColumnOf) -> String {
    let all: Vec<&Record> = records.iter().collect();
    let text = |name: &str, of: fn(&Record) -> Value| column(name, records.iter().map(of));
    let mut columns = vec![
        text("id", |record| record.id.as_str().into()),
        text("scene", |record| record.scene.as_str().into()),
        text("row", |record| record.row.as_str().into()),
        text("axes", |record| axes_text(record).into()),
    ];
    columns.extend(positions(records));
    columns.extend([
        text("seed", |record| record.seed.into()),
        text("status", |record| record.status.name().into()),
        text("reason", |record| record.reason.as_str().into()),
        text("inactive_levels", |record| record.result.inactive_levels.join(" ").into()),
    ]);
    for metric in
        distinct(records.iter().flat_map(|record| record.result.metrics.iter().map(|(name, _)| name.as_str())))
    {
        // Numbers of an earlier attempt are not the point's.
        let measured = |record: &Record| record.metric(metric).filter(|_| record.status == Status::Done);
        columns.push(column(metric, records.iter().map(|record| measured(record).into())));
    }
    columns.extend(protocol_columns(&all));
    for name in clock_names(timing) {
        columns.push(column(name, records.iter().map(|record| clock(timing, &record.id, name).into())));
    }
    csv_of(&compact(columns, constants, column_of))
}

fn column(name: &str, cells: impl Iterator<Item = Value>) -> Column {
    (name.into(), cells.collect())
}

/// Returns which of its point's lines each line is, from 1, and how many the point has.
fn positions(records: &[Record]) -> [Column; 2] {
    let mut counts: HashMap<&str, usize> = HashMap::new();
    let mut places: Vec<Value> = Vec::new();
    for record in records {
        let count = counts.entry(&record.id).or_default();
        *count += 1;
        places.push((*count).into());
    }
    let all = records.iter().map(|record| counts[record.id.as_str()].into());
    [(POSITION.into(), places), column("positions", all)]
}

/// Returns a column for each protocol field, without the scene and the seed, which have theirs.
fn protocol_columns(records: &[&Record]) -> Vec<Column> {
    let names = distinct(records.iter().flat_map(|record| protocol_names(record)).filter(|name| *name != "seed"));
    let of = |name: &str| column(name, records.iter().map(|record| record.protocol(name).into()));
    names.into_iter().map(of).collect()
}

/// Returns one line for each measured point: its folder's name, identity and clock times. A point in several rows has
/// one line.
pub fn timing_csv(records: &[Record], timing: &[PointTiming], constants: &Constants) -> String {
    let label = |id: &str| records.iter().find(|record| record.id == id).map(Record::point_label).unwrap_or_default();
    let mut columns = vec![
        column("id", timing.iter().map(|(id, _)| id.as_str().into())),
        column("point", timing.iter().map(|(id, _)| label(id).into())),
    ];
    for name in clock_names(timing) {
        columns.push(column(name, timing.iter().map(|(id, _)| clock(timing, id, name).into())));
    }
    csv_of(&compact(columns, constants, |_| None))
}

/// Returns one line a row: counts, each metric with its comparison, the published numbers, the protocol that its seeds
/// share but for `constants` and, if given, its mean clock times.
pub fn table_csv(table: &Table, timing: &[PointTiming], constants: &Constants, column_of: ColumnOf) -> String {
    csv_of(&compact(table_columns(table, timing), constants, column_of))
}

/// Returns all columns of [`table_csv`]. Counts and metrics are numbers.
pub fn table_columns(table: &Table, timing: &[PointTiming]) -> Vec<Column> {
    let lines = || table.lines.iter();
    let text = |name: &str, of: fn(&Line) -> Value| column(name, table.lines.iter().map(of));
    let mut columns: Vec<Column> = Vec::new();
    for (index, name) in PLACE_COLUMNS.into_iter().enumerate() {
        columns.push(column(name, lines().map(|line| place_cells(line)[index].as_str().into())));
    }
    columns.extend([
        text("baseline", |line| line.baseline.as_deref().unwrap_or_default().into()),
        text("ours", |line| line.ours.to_string().into()),
        text("points", |line| line.points.into()),
        text("done", |line| line.ids.len().into()),
        text("status", |line| line.status.as_str().into()),
        text("reason", |line| line.reason.as_str().into()),
        text("inactive_levels", |line| inactive_text(line).into()),
        text("differs", |line| line.differs.join(" ").into()),
        text("mixed", |line| line.mixed.join(" ").into()),
        text("no_better_than_one_colour", |line| line.no_better_than_one_colour.join(", ").into()),
        text(FLOOR_PSNR.key, |line| line.floor_psnr.into()),
    ]);
    for (index, metric) in table.metrics.iter().enumerate() {
        let cells: Vec<&Cell> = lines().map(|line| &line.cells[index]).collect();
        columns.extend(cell_columns(metric, &cells));
    }
    columns.extend([
        text("published_lpips", |line| line.published_lpips.into()),
        text("published_average", |line| line.published_average.into()),
        text("published_protocol", |line| line.published_protocol.as_str().into()),
        text("protocol_difference", |line| line.protocol_difference.as_str().into()),
    ]);
    let names = lines().flat_map(|line| line.protocol.iter().map(|(name, _)| name.as_str()));
    let differing = lines().flat_map(|line| line.differs.iter().map(String::as_str));
    for name in distinct(names.chain(differing).filter(|name| !is_per_seed(name))) {
        columns.push(column(name, lines().map(|line| line.protocol(name).into())));
    }
    for name in clock_names(timing) {
        let means = lines().map(|line| mean_clock(timing, &line.ids, name).into());
        columns.push(column(&format!("{name}_mean"), means));
    }
    columns
}

/// Returns the inactive sites: `rgb density:2/3` if the second is so with 2 of 3 seeds.
fn inactive_text(line: &Line) -> String {
    let text = |(site, seeds): &(String, usize)| match line.ids.len() {
        all if all == *seeds => site.clone(),
        all => format!("{site}:{seeds}/{all}"),
    };
    line.inactive_levels.iter().map(text).collect::<Vec<String>>().join(" ")
}

pub(super) fn place_cells(line: &Line) -> [String; PLACE_COLUMNS.len()] {
    let source = if line.quoted { "published" } else { "run" };
    [line.scene.clone(), source.into(), line.row.clone(), line.axes.clone()]
}

/// Returns the columns of a metric: of all lines, and those of the test of equivalence if it was made.
fn cell_columns(metric: &str, cells: &[&Cell]) -> Vec<Column> {
    let is_tested = cells.iter().any(|cell| cell.equivalence().is_some());
    let own = ["n", "mean", "std", "pairs", "difference", "low", "high", "p", "p_holm", "verdict", "published"].iter();
    let tests = ["margin", "p_equivalence", "p_equivalence_holm", "equivalent"].iter().filter(|_| is_tested);
    let value = |name: &str, cell: &Cell| match name {
        "n" => cell.n.into(),
        "mean" => cell.mean.into(),
        "std" => cell.deviation.into(),
        "published" => cell.published.into(),
        _ => cell.comparison.map_or(Value::Null, |comparison| comparison.cell(name)),
    };
    let of = |name: &&str| column(&format!("{metric}_{name}"), cells.iter().map(|cell| value(name, cell)));
    own.chain(tests).map(of).collect()
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
