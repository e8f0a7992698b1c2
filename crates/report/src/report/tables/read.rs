//! Reads `points.csv`.

use super::delimited::POINT_COLUMNS;
use crate::base::csv::{column_names, plain_cell};
use crate::report::{AxisValue, Record, Status};

/// The first column of the protocol; metrics come before it.
const FIRST_OF_PROTOCOL: &str = "protocol";

/// The position of a point in the table, as text in `points.csv`.
#[derive(Clone, Copy, Debug)]
pub struct PlaceText<'a> {
    /// The point's name.
    pub id: &'a str,
    /// The scene's name.
    pub scene: &'a str,
    /// The row's name.
    pub row: &'a str,
    /// Axis values.
    pub axes: &'a str,
}

/// Returns the records of a `points.csv`. `axes` returns the axis values for a position, or `None` if it does not
/// exist. `clocks` are columns that are neither metrics nor protocol.
pub fn read_points(
    text: &str,
    clocks: &[String],
    axes: impl Fn(PlaceText) -> Option<Vec<AxisValue>>,
) -> Result<Vec<Record>, String> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let head = column_names(&mut reader)?;
    if head.len() < POINT_COLUMNS.len() || head.iter().zip(POINT_COLUMNS).any(|(found, column)| found != column) {
        return Err(format!("its first columns are not {}", POINT_COLUMNS.join(", ")));
    }
    let protocol = head.iter().position(|name| name == FIRST_OF_PROTOCOL).unwrap_or(head.len());
    let own: Vec<usize> = (protocol..head.len()).filter(|&column| !clocks.contains(&head[column])).collect();
    let mut records = Vec::new();
    for (index, row) in reader.records().enumerate() {
        let row = row.map_err(|e| e.to_string())?;
        let line = index + 2;
        let [id, scene, name, axes_text, seed, status, reason, inactive] = std::array::from_fn(|i| plain_cell(&row[i]));
        let known = Status::ALL.into_iter().find(|known| known.name() == status);
        let number = |column: usize| match &row[column] {
            "" => Ok(None),
            cell => match finite(cell) {
                Some(number) => Ok(Some(number)),
                None => Err(format!("line {line}, column {}: '{cell}' is not a finite number", head[column])),
            },
        };
        let metric = |column: usize| Ok((head[column].clone(), number(column)?));
        let metrics = (POINT_COLUMNS.len()..protocol).map(metric).collect::<Result<_, String>>()?;
        let status = known.ok_or_else(|| format!("line {line}: unknown status '{status}'"))?;
        let mut columns: Vec<(String, String)> = Vec::new();
        if status == Status::Done {
            columns.push(("scene".into(), scene.into()));
            columns.extend(own.iter().map(|&column| (head[column].clone(), plain_cell(&row[column]).to_string())));
        }
        let record = Record {
            id: id.into(),
            scene: scene.into(),
            row: name.into(),
            axes: axes(PlaceText { id, scene, row: name, axes: axes_text }).ok_or_else(|| {
                format!("line {line}: point {id} has no position in row '{name}' of scene '{scene}' at '{axes_text}'")
            })?,
            seed: Some(seed.parse().map_err(|_| format!("line {line}: seed '{seed}' is not an integer from 0 up"))?),
            status,
            reason: reason.into(),
            metrics,
            protocol: columns,
            inactive_levels: inactive.split_whitespace().map(String::from).collect(),
        };
        records.push(record.with_epochs());
    }
    Ok(records)
}

/// Returns the clock times in a `timing.csv`, by point.
pub fn read_timing(text: &str) -> Result<Vec<super::PointTiming>, String> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let head = column_names(&mut reader)?;
    let rows = reader.records().map(|row| {
        let row = row.map_err(|e| e.to_string())?;
        let clock = |column: usize| {
            let value = finite(&row[column]);
            if value.is_none() && !row[column].is_empty() {
                return Err(format!(
                    "{} of point {}: '{}' is not a finite number",
                    head[column], &row[0], &row[column]
                ));
            }
            Ok((head[column].clone(), value))
        };
        Ok((row[0].to_string(), (2..row.len()).map(clock).collect::<Result<_, String>>()?))
    });
    rows.collect()
}

/// Returns a cell's number, which must be finite.
fn finite(cell: &str) -> Option<f64> {
    cell.parse().ok().filter(|number: &f64| number.is_finite())
}
