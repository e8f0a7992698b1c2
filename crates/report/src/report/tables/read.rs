//! Reads `points.csv`.

use super::delimited::POSITION;
use super::sheet::{ColumnOf, Constants, fields_of};
use crate::base::csv::{column_names, plain_hash};
use crate::metrics::Metric;
use crate::report::{AxisValue, PointResult, Record, Status};

/// Columns that every line fills.
const NEEDED: [&str; 5] = ["id", "scene", "row", "seed", "status"];
/// The other columns that are no field of the protocol. A file lacks those that would be empty.
const OTHERS: [&str; 5] = ["axes", POSITION, "positions", "reason", "inactive_levels"];

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

/// Returns the records of a `points.csv`. `constants` are the fields that all measured points share and that are no
/// columns. `clocks` are columns that are neither metrics nor protocol. `axes` returns the axis values for a position, or
/// `None` if it does not exist.
pub fn read_points(
    text: &str,
    constants: &Constants,
    clocks: &[String],
    column_of: ColumnOf,
    axes: impl Fn(PlaceText) -> Option<Vec<AxisValue>>,
) -> Result<Vec<Record>, String> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let head = column_names(&mut reader)?;
    if let Some(lacking) = NEEDED.iter().find(|name| !head.iter().any(|column| column == *name)) {
        return Err(format!("it has no column '{lacking}'; it needs {}", NEEDED.join(", ")));
    }
    let is_own = |name: &str| NEEDED.contains(&name) || OTHERS.contains(&name) || clocks.iter().any(|own| own == name);
    let (metrics, fields): (Vec<usize>, Vec<usize>) =
        (0..head.len()).filter(|&i| !is_own(&head[i])).partition(|&i| Metric::find(&head[i]).is_some());
    let mut records = Vec::new();
    for (index, row) in reader.records().enumerate() {
        let row = row.map_err(|e| e.to_string())?;
        let line = index + 2;
        let cell = |name: &str| head.iter().position(|column| column == name).map_or("", |i| &row[i]);
        let number = |column: usize| match &row[column] {
            "" => Ok(None),
            cell => match finite(cell) {
                Some(number) => Ok(Some(number)),
                None => Err(format!("line {line}, column {}: '{cell}' is not a finite number", head[column])),
            },
        };
        let metric = |&column: &usize| Ok((head[column].clone(), number(column)?));
        let (id, scene, name) = (plain_hash(cell("id")), cell("scene"), cell("row"));
        let (seed, status) = (cell("seed"), cell("status"));
        let status = Status::ALL.into_iter().find(|known| known.name() == status);
        let status = status.ok_or_else(|| format!("line {line}: unknown status '{}'", cell("status")))?;
        let mut protocol: Vec<(String, String)> = Vec::new();
        if status == Status::Done {
            let own = fields.iter().map(|&i| (head[i].clone(), row[i].to_string()));
            protocol.push(("scene".into(), scene.into()));
            protocol.extend(fields_of(own.chain(constants.clone()).collect(), column_of));
        }
        let record = Record {
            id: id.into(),
            scene: scene.into(),
            row: name.into(),
            axes: axes(PlaceText { id, scene, row: name, axes: cell("axes") }).ok_or_else(|| {
                let at = cell("axes");
                format!("line {line}: point {id} has no position in row '{name}' of scene '{scene}' at '{at}'")
            })?,
            seed: Some(seed.parse().map_err(|_| format!("line {line}: seed '{seed}' is not an integer from 0 up"))?),
            status,
            reason: cell("reason").into(),
            result: PointResult {
                metrics: metrics.iter().map(metric).collect::<Result<_, String>>()?,
                protocol,
                inactive_levels: cell("inactive_levels").split_whitespace().map(String::from).collect(),
            },
        };
        records.push(record.ordered());
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
        Ok((plain_hash(&row[0]).to_string(), (2..row.len()).map(clock).collect::<Result<_, String>>()?))
    });
    rows.collect()
}

/// Returns a cell's number, which must be finite.
fn finite(cell: &str) -> Option<f64> {
    cell.parse().ok().filter(|number: &f64| number.is_finite())
}
