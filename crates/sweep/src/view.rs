//! Finished sweeps looked at again: several in one table, or rows of one for a comparison. Nothing is run, and the statistics are
//! of the rows shown.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::base::files::write_atomic;
use crate::base::{Error, Result};
use crate::metrics::{Metric, Scope};
use crate::report::tables::{Table, points_csv};
use crate::report::{AxisValue, Record, RowSpec, Status, TableSpec, distinct};
use crate::run::{DepthErrors, RunDir};
use crate::settings::columns::column_of_setting;
use crate::train::sha256;

use super::collect::{Results, Tables};
use super::common_depth::{add_common_depth, wants_depth};
use super::comparability::{by_seed, must_match};
use super::definition::{Definition, Row};
use super::folder::{DEFINITION, SweepFolder};
use super::outputs::SweepOutputs;
use super::points::Point;
use super::provenance::toml_of;
use super::sweep::{Sweep, TableOptions};
use super::words::quoted;

/// File that a view's folder has in place of a sweep's definition.
pub const VIEW: &str = "view.toml";

/// Rows of one or several sweeps in one table.
pub struct View {
    /// Definition of the first sweep.
    first: Definition,
    pub(super) spec: TableSpec,
    pub(super) outputs: SweepOutputs,
    points: Vec<Point>,
    sweeps: Vec<Origin>,
}

/// A sweep that a view shows, in `view.toml` and `across.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Origin {
    /// The sweep's name.
    pub name: String,
    /// SHA-256 of its `points.csv`.
    pub points_sha256: String,
    /// What a comparison across sweeps calls it instead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<String>,
}

impl Origin {
    pub(super) fn of(source: &Sweep) -> Origin {
        let points = points_csv(&source.outputs.records, &[], &source.outputs.constants(), column_of_setting);
        Origin { name: source.name.clone(), points_sha256: sha256(points.as_bytes()), label: None }
    }
}

impl View {
    /// Joins sweeps in one table. Rows of one name are one row unless their settings differ. In that case the later
    /// sweep's row gets that sweep's name in brackets.
    ///
    /// # Errors
    /// The depth errors of a run cannot be read.
    pub fn merged(name: &str, sources: &[Sweep]) -> Result<View> {
        let (first, others) = sources.split_first().expect("at least one sweep");
        let mut view = View::of(name, first);
        others.iter().for_each(|source| view.merge(source));
        view.match_all(sources);
        let ids: HashSet<&str> = view.outputs.records.iter().map(|record| record.id.as_str()).collect();
        view.points.retain(|point| ids.contains(point.id.as_str()));
        view.outputs.timing.retain(|(id, _)| ids.contains(id.as_str()));
        view.sweeps = sources.iter().map(Origin::of).collect();
        view.measure_common(sources)?;
        let names: Vec<&str> = view.sweeps.iter().map(|sweep| sweep.name.as_str()).collect();
        view.spec.notes = vec![format!("a view of {}", names.join(" and "))];
        Ok(view)
    }

    /// Keeps some rows of a sweep, or all if `rows` is empty, compared with `baseline` in one metric. Metrics over
    /// common pixels stay those over all rows.
    ///
    /// # Errors
    /// A row, the baseline or the metric does not exist.
    pub(super) fn compared(source: &Sweep, baseline: &str, rows: &[String], metric: &str) -> Result<View> {
        let mut view = View::of(&source.name, source);
        let names: Vec<&str> = view.rows().collect();
        if !rows.is_empty() {
            let chosen = split_names("--rows", rows, &names)?;
            let row = |name: &String| view.spec.rows.iter().find(|row| row.name == *name).expect("split").clone();
            view.spec.rows = chosen.iter().map(row).collect();
            view.outputs.records.retain(|record| chosen.contains(&record.row));
        }
        if view.spec.rows.iter().find(|row| row.name == baseline).is_none_or(|row| row.quoted) {
            let names: Vec<&str> = view.rows().collect();
            return Err(Error::Config(format!(
                "--baseline {baseline}: no shown row with measured numbers has this name; the rows are {}",
                quoted(&names)
            )));
        }
        let others = view.spec.rows.iter_mut().filter(|row| !row.quoted);
        others.for_each(|row| row.baseline = (row.name != baseline).then(|| baseline.to_string()));
        if !Metric::in_tables().any(|known| known.key == metric) {
            let known: Vec<&str> = Metric::in_tables().map(|metric| metric.key).collect();
            return Err(Error::Config(format!(
                "--metric: unknown metric '{metric}'; choose from {}",
                known.join(", ")
            )));
        }
        view.spec.metrics = vec![metric.into()];
        view.spec.equivalence.retain(|(name, _)| name == metric);
        Ok(view)
    }

    /// Returns all rows of a sweep.
    fn of(name: &str, source: &Sweep) -> View {
        View {
            first: source.definition.clone(),
            spec: TableSpec { name: name.into(), ..source.spec() },
            outputs: source.outputs.clone(),
            points: source.points.clone(),
            sweeps: Vec::new(),
        }
    }

    /// Adds another sweep's rows, points and files.
    fn merge(&mut self, source: &Sweep) {
        let other = source.spec();
        let names: HashMap<&str, String> =
            other.rows.iter().map(|row| (row.name.as_str(), self.name_of(row, source))).collect();
        let renamed = |name: &str| names.get(name).cloned().unwrap_or_else(|| name.to_string());
        for row in &other.rows {
            let name = renamed(&row.name);
            if !self.spec.rows.iter().any(|known| known.name == name) {
                self.spec.rows.push(RowSpec { name, baseline: row.baseline.as_deref().map(renamed), ..row.clone() });
            }
        }
        for metric in &other.metrics {
            if !self.spec.metrics.contains(metric) {
                self.spec.metrics.push(metric.clone());
            }
        }
        for (metric, margin) in &other.equivalence {
            if self.spec.margin(metric).is_none() {
                self.spec.equivalence.push((metric.clone(), *margin));
            }
        }
        if self.spec.title != other.title {
            self.spec.title = [self.spec.title.as_str(), other.title.as_str()].join(" + ");
        }
        self.spec.varied |= other.varied;
        for record in &source.outputs.records {
            self.add_record(Record { row: renamed(&record.row), ..record.clone() });
        }
        for point in &source.points {
            let mut point = point.clone();
            point.places.iter_mut().for_each(|place| place.row = renamed(&place.row));
            match self.points.iter_mut().find(|known| known.id == point.id) {
                Some(known) => known.places.extend(point.places),
                None => self.points.push(point),
            }
        }
        let own: HashSet<String> = self.outputs.timing.iter().map(|(id, _)| id.clone()).collect();
        self.outputs.timing.extend(source.outputs.timing.iter().filter(|(id, _)| !own.contains(id)).cloned());
        self.outputs.scalars.extend(source.outputs.scalars.clone());
        self.outputs.runs.extend(source.outputs.runs.clone());
    }

    /// Returns the name of another sweep's row in this view.
    fn name_of(&self, row: &RowSpec, source: &Sweep) -> String {
        let is_taken = |name: &str| self.spec.rows.iter().any(|known| known.name == name);
        let known = self.spec.rows.iter().find(|known| known.name == row.name);
        let same = known.is_none_or(|known| match known.quoted || row.quoted {
            true => known.quoted == row.quoted && known.published == row.published,
            // By definition, points of two seeds differ in these.
            _ if !(self.first.by_seed.is_empty() && source.definition.by_seed.is_empty()) => {
                is_defined_alike(&self.first, &source.definition, &row.name)
            }
            _ => is_alike(&settings_of(&self.points, &row.name), &settings_of(&source.points, &row.name)),
        });
        if same {
            return row.name.clone();
        }
        let numbered = (1..).map(|number| match number {
            1 => format!("{} ({})", row.name, source.name),
            _ => format!("{} ({} {number})", row.name, source.name),
        });
        numbered.into_iter().find(|name| !is_taken(name)).expect("numbers do not end")
    }

    /// Adds a record, one for each seed and position; a measured one replaces one that is not.
    fn add_record(&mut self, record: Record) {
        let place = |record: &Record| (record.scene.clone(), record.row.clone(), record.axes.clone(), record.seed);
        let records = &mut self.outputs.records;
        match records.iter_mut().find(|known| place(known) == place(&record)) {
            Some(known) if known.status != Status::Done && record.status == Status::Done => *known = record,
            Some(_) => {}
            None => records.push(record),
        }
    }

    /// Requires rows to agree in what the rows of each sweep must agree in, except for what one sweep varies.
    fn match_all(&mut self, sources: &[Sweep]) {
        let all: Vec<Vec<String>> = sources.iter().map(|s| must_match(&self.spec.metrics, &s.points)).collect();
        self.spec.must_match.retain(|column| all.iter().all(|own| own.contains(column)));
        let by_seed = sources.iter().flat_map(|source| by_seed(&self.spec.must_match, &source.points));
        self.spec.by_seed = distinct(by_seed);
    }

    /// Iterates over the names of the rows that are shown.
    pub fn rows(&self) -> impl Iterator<Item = &str> {
        self.spec.rows.iter().map(|row| row.name.as_str())
    }

    /// Returns the points of the rows that are shown, by these rows' names.
    pub fn records(&self) -> &[Record] {
        &self.outputs.records
    }

    /// Recomputes metrics over the pixels that all rows show.
    fn measure_common(&mut self, sources: &[Sweep]) -> Result<()> {
        let is_common = |name: &str| Metric::find(name).is_some_and(|metric| metric.scope == Scope::Common);
        let folders: Vec<&SweepFolder> = sources.iter().filter_map(|source| source.runs.as_ref()).collect();
        let records = &mut self.outputs.records;
        records.iter_mut().for_each(|record| record.result.metrics.retain(|(name, _)| !is_common(name)));
        if !wants_depth(&self.spec.metrics) {
            return Ok(());
        }
        let errors = |id: &str| {
            let of = |folder: &&SweepFolder| DepthErrors::read(&RunDir::depth_errors_in(&folder.point(id).run()));
            let found = folders.iter().map(of).find(|errors| !matches!(errors, Ok(None)));
            found.unwrap_or(Ok(None))
        };
        add_common_depth(records, errors)
    }

    /// Writes tables and figures into the view's own folder. Returns the table.
    ///
    /// # Errors
    /// The folder holds a sweep's own tables, or files that are no view; [`Error::NotComparable`] if rows may not be
    /// in one table.
    pub fn write(&self, results: &Path, options: TableOptions) -> Result<Table> {
        let refuse = |holds: &str| {
            Err(Error::Output(format!(
                "{} holds {holds}; name another folder for several sweeps with --out",
                results.display()
            )))
        };
        if results.join(DEFINITION).exists() {
            return refuse("the complete tables of a sweep");
        }
        // Old tables and figures are deleted, and files of others may have their names.
        if !results.join(VIEW).exists() && std::fs::read_dir(results).is_ok_and(|mut files| files.next().is_some()) {
            return refuse("files that are not a view of a sweep");
        }
        let results = Results::take(results)?;
        // Written first, so that a view that is killed here is recognized as one.
        write_atomic(&results.path().join(VIEW), self.to_toml().as_bytes())?;
        let mut files = Vec::new();
        let tables = Tables { spec: self.spec.clone(), outputs: &self.outputs, points: &self.points, options };
        let table = tables.write(&results, &mut files);
        results.put(&files)?;
        table
    }

    fn to_toml(&self) -> String {
        #[derive(Serialize)]
        struct File<'a> {
            sweep: &'a [Origin],
            constants: toml::Table,
        }
        let constants = toml_of(&self.outputs.constants());
        toml::to_string(&File { sweep: &self.sweeps, constants }).expect("plain data")
    }
}

/// Positions of a row, each with the hash of its settings apart from the seed.
type Settings = BTreeMap<(String, Vec<(String, String, String)>), String>;

fn settings_of(points: &[Point], row: &str) -> Settings {
    let mut settings = Settings::new();
    for point in points {
        for place in point.places.iter().filter(|place| place.row == row) {
            let mut config = point.config.clone();
            config.seed = 0;
            let value = |value: &AxisValue| (value.axis.clone(), value.panel.clone(), value.value.clone());
            settings.insert((point.scene.clone(), place.axes.iter().map(value).collect()), config.hash());
        }
    }
    settings
}

/// Returns whether a row is the same in both definitions, word by word.
fn is_defined_alike(a: &Definition, b: &Definition, row: &str) -> bool {
    let row_of = |definition: &Definition| {
        let rows = definition.row.iter().map(|own| Row { baseline: None, ours: false, ..own.clone() });
        rows.into_iter().find(|own| own.name == row)
    };
    let shared = a.scenes.iter().filter(|scene| b.scenes.contains(scene));
    let of_scenes = |definition: &Definition| -> Vec<Vec<toml::Table>> {
        shared.clone().map(|scene| definition.settings_of_scene(scene).cloned().collect()).collect()
    };
    (&a.preset, &a.set, &a.by_seed, &a.axis, row_of(a)) == (&b.preset, &b.set, &b.by_seed, &b.axis, row_of(b))
        && of_scenes(a) == of_scenes(b)
}

/// Returns whether settings are equal wherever both have points.
fn is_alike(a: &Settings, b: &Settings) -> bool {
    a.iter().all(|(place, hash)| b.get(place).is_none_or(|other| other == hash))
}

/// Splits names at commas; each must be one of `known`. A name may contain commas, so the longest match is taken.
///
/// # Errors
/// A name is unknown, or occurs twice.
pub fn split_names(flag: &str, texts: &[String], known: &[&str]) -> Result<Vec<String>> {
    let mut names: Vec<String> = Vec::new();
    for text in texts {
        let parts: Vec<&str> = text.split(',').collect();
        let mut from = 0;
        while from < parts.len() {
            let joined = |to: usize| parts[from..to].join(",").trim().to_string();
            let Some(to) = (from + 1..=parts.len()).rev().find(|&to| known.contains(&joined(to).as_str())) else {
                return Err(Error::Config(format!(
                    "{flag}: '{}' is not a row; the rows are {}",
                    parts[from].trim(),
                    quoted(known)
                )));
            };
            if names.contains(&joined(to)) {
                return Err(Error::Config(format!("{flag}: '{}' is named twice", joined(to))));
            }
            names.push(joined(to));
            from = to;
        }
    }
    Ok(names)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_may_hold_commas() {
        let known = ["NeRF", "NeRF, equal steps", "Aug-NeRF"];
        let split = |text: &str| split_names("--rows", &[text.to_string()], &known);
        assert_eq!(split("Aug-NeRF,NeRF").unwrap(), ["Aug-NeRF", "NeRF"]);
        assert_eq!(split("NeRF, equal steps, NeRF").unwrap(), ["NeRF, equal steps", "NeRF"]);
        assert!(split("NeRF,Nerf").unwrap_err().to_string().contains("'Nerf' is not a row; the rows are 'NeRF', "));
        assert!(split("NeRF,NeRF").unwrap_err().to_string().contains("twice"));
    }
}
