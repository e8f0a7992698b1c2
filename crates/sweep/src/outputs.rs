//! Outputs of a sweep's points, the input of tables and figures: read from the points' folders, kept next to the
//! tables.

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use flate2::{Compression, GzBuilder, read::GzDecoder};

use crate::base::csv::{column_names, csv_text, hash_cell, plain_hash};
use crate::base::files::{read_json, write_atomic};
use crate::base::input::{TABLE_BYTES, read_bytes};
use crate::base::{Error, Result};
use crate::report::Record;
use crate::report::tables::{Constants, PointTiming, constants};
use crate::run::{DepthErrors, RunDir};
use crate::runtime::Timing;

use super::common_depth::{add_common_depth, wants_depth};
use super::definition::Definition;
use super::folder::{STEP_SECONDS, SweepFolder};
use super::points::Point;

/// The logs of all points, next to the tables.
pub const SCALARS: &str = "scalars.csv.gz";
/// The outputs of a sweep's points.
#[derive(Clone, Debug, Default)]
pub struct SweepOutputs {
    /// The points, one record for each position in the table.
    pub records: Vec<Record>,
    /// Clock times of the points that are done.
    pub timing: Vec<PointTiming>,
    /// Logs by the points' names, for points that have one.
    pub scalars: BTreeMap<String, Scalars>,
    /// Run folders of the points that are done, by the points' names; not kept next to the tables.
    pub runs: BTreeMap<String, PathBuf>,
    /// `step_seconds.json`, if budgets in seconds needed it.
    pub step_seconds: Option<Vec<u8>>,
}

/// A run's `scalars.csv`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scalars {
    /// Column names.
    pub head: Vec<String>,
    /// Cells, one row a logged step.
    pub rows: Vec<Vec<String>>,
}

impl SweepOutputs {
    /// Reads the points' folders.
    pub fn of_folder(folder: &SweepFolder, definition: &Definition, points: &[Point]) -> Result<SweepOutputs> {
        let mut outputs = SweepOutputs {
            records: folder.records(definition, points)?,
            step_seconds: optional(&folder.step_seconds())?,
            ..SweepOutputs::default()
        };
        for point in points {
            let own = folder.point(&point.id);
            if own.finished_at().is_some() {
                outputs.read_run(&point.id, &own.run())?;
            }
        }
        if wants_depth(&definition.metrics) {
            let errors = |id: &str| DepthErrors::read(&RunDir::depth_errors_in(&folder.point(id).run()));
            add_common_depth(&mut outputs.records, errors)?;
        }
        Ok(outputs)
    }

    /// Adds the files of a measured run.
    pub(super) fn read_run(&mut self, id: &str, run: &Path) -> Result<()> {
        self.runs.insert(id.into(), run.to_path_buf());
        if let Some(timing) = read_json::<Timing>(&run.join("timing.json"), "delete it to continue")? {
            self.timing.push((id.into(), clocks(&timing)));
        }
        if let Some(bytes) = optional(&run.join("scalars.csv"))? {
            let scalars = Scalars::parse(bytes.as_slice()).map_err(|e| damaged(&run.join("scalars.csv"), &e))?;
            self.scalars.insert(id.into(), scalars);
        }
        Ok(())
    }

    /// Returns the protocol fields that all points share and that are no columns of their tables.
    pub fn constants(&self) -> Constants {
        constants(&self.records)
    }

    /// Writes all inputs of tables and figures into their folder: the definition, the points with their
    /// configurations, the step times and the logs.
    pub fn archive(&self, definition: &Definition, points: &[Point], results: &Path) -> Result<()> {
        SweepFolder::new(results).archive(definition, points)?;
        for (name, bytes) in [(STEP_SECONDS, self.step_seconds.clone()), (SCALARS, self.packed_scalars())] {
            let path = results.join(name);
            match bytes {
                Some(bytes) => write_atomic(&path, &bytes)?,
                // A file from an earlier time belongs to other points.
                None if path.exists() => std::fs::remove_file(&path).map_err(|e| Error::unwritable(&path, &e))?,
                None => {}
            }
        }
        Ok(())
    }

    /// Returns all logs as one table, each row under its point's name, or `None` if there are none.
    fn packed_scalars(&self) -> Option<Vec<u8>> {
        let mut head: Vec<&str> = vec!["id"];
        for name in self.scalars.values().flat_map(|scalars| &scalars.head) {
            if !head.contains(&name.as_str()) {
                head.push(name);
            }
        }
        let rows = self.scalars.iter().flat_map(|(id, scalars)| {
            let places: Vec<Option<usize>> = head.iter().map(|name| scalars.place(name)).collect();
            scalars.rows.iter().map(move |row| {
                let cell = |place: &Option<usize>| place.map_or(String::new(), |place| row[place].clone());
                std::iter::once(hash_cell(id)).chain(places[1..].iter().map(cell)).collect()
            })
        });
        let text = csv_text(std::iter::once(head.iter().map(ToString::to_string).collect()).chain(rows));
        (!self.scalars.is_empty()).then(|| packed(text.as_bytes()))
    }
}

impl Scalars {
    fn parse(table: impl Read) -> std::result::Result<Scalars, String> {
        let mut reader = csv::Reader::from_reader(table);
        let head = column_names(&mut reader)?;
        let cells = |row: csv::Result<csv::StringRecord>| Ok(row?.iter().map(str::to_string).collect());
        let rows = reader.records().map(cells).collect::<csv::Result<_>>().map_err(|e| e.to_string())?;
        Ok(Scalars { head, rows })
    }

    fn place(&self, column: &str) -> Option<usize> {
        self.head.iter().position(|known| known == column)
    }

    /// Returns the numbers of a column.
    pub fn numbers(&self, column: &str) -> Vec<f64> {
        let Some(place) = self.place(column) else { return Vec::new() };
        self.rows.iter().filter_map(|row| row[place].parse().ok()).collect()
    }

    /// Returns the numbers of two columns, for rows that have both.
    pub fn pairs(&self, x: &str, y: &str) -> Vec<(f64, f64)> {
        let Some((x, y)) = self.place(x).zip(self.place(y)) else { return Vec::new() };
        let number = |row: &Vec<String>, place: usize| row[place].parse::<f64>().ok();
        self.rows.iter().filter_map(|row| Some((number(row, x)?, number(row, y)?))).collect()
    }
}

/// Reads the logs that a results folder keeps, by the points' names; empty if it has none.
pub fn read_scalars(results: &Path) -> Result<BTreeMap<String, Scalars>> {
    let path = results.join(SCALARS);
    let Some(bytes) = optional(&path)? else { return Ok(BTreeMap::new()) };
    let all = Scalars::parse(GzDecoder::new(bytes.as_slice())).map_err(|e| damaged(&path, &e))?;
    if all.head.first().is_none_or(|name| name != "id") {
        return Err(damaged(&path, &"its first column is not 'id'"));
    }
    let mut by_point: BTreeMap<String, Scalars> = BTreeMap::new();
    for mut row in all.rows {
        let empty = || Scalars { head: all.head[1..].to_vec(), rows: Vec::new() };
        by_point.entry(plain_hash(&row.remove(0)).to_string()).or_insert_with(empty).rows.push(row);
    }
    Ok(by_point)
}

/// Packs bytes without a name or a time, so that equal content gives equal bytes.
fn packed(bytes: &[u8]) -> Vec<u8> {
    let mut writer = GzBuilder::new().write(Vec::new(), Compression::best());
    let written = writer.write_all(bytes).and_then(|()| writer.finish());
    written.expect("memory takes everything")
}

/// Returns name and value of each clock of a run.
fn clocks(timing: &Timing) -> Vec<(String, Option<f64>)> {
    let clocks = [
        ("seconds_training", Some(timing.seconds_training)),
        ("seconds_evaluation", Some(timing.seconds_evaluation)),
        ("rays_per_second", timing.rays_per_second),
        ("peak_memory_mib", timing.peak_memory_mib),
        ("threads", Some(timing.threads as f64)),
        ("sessions", Some(timing.sessions as f64)),
        ("started_unix", Some(timing.started_unix as f64)),
    ];
    clocks.map(|(name, value)| (name.to_string(), value)).to_vec()
}

/// Reads a file, or returns `None` if it does not exist.
pub fn optional(path: &Path) -> Result<Option<Vec<u8>>> {
    match read_bytes(path, TABLE_BYTES) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(Error::unreadable(path, &error)),
    }
}

fn damaged(path: &Path, error: &dyn std::fmt::Display) -> Error {
    Error::Checkpoint(format!("cannot read {}: {error}", path.display()))
}
