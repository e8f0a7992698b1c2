//! Folders of single runs: what each left must agree with itself, and a summary with all of them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use super::findings::Findings;
use crate::base::csv::{column_names, plain_cell};
use crate::base::files::read_json;
use crate::base::{Error, Result};
use crate::metrics::{DEPTH_LEFT_OUT, MSE, PSNR_OF_MEAN};
use crate::of_runs::foreign;
use crate::outputs::optional;
use crate::report::tables::plain_field;
use crate::run::{DepthErrors, RunDir, cell as text};

/// Run folders below a folder, by name.
pub fn run_folders(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut runs = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|e| Error::unreadable(folder, &e))? {
        let path = entry.map_err(|e| Error::unreadable(folder, &e))?.path();
        if path.join("metrics.json").exists() {
            runs.push(path);
        }
    }
    runs.sort();
    Ok(runs)
}

/// Names and values, as text.
type Fields = Vec<(String, String)>;

/// Name and means of each run below a folder.
pub fn means(folder: &Path) -> Result<Vec<(String, Fields)>> {
    let of_run = |path: PathBuf| {
        let report = Report::read(&path)?;
        Ok((name(&path), report.mean.iter().map(|(key, value)| (key.clone(), text(value))).collect()))
    };
    run_folders(folder)?.into_iter().map(of_run).collect()
}

/// Checks every run below a folder, and its summary.
pub fn check(folder: &Path, findings: &mut Findings) -> Result<()> {
    let (mut runs, mut wrong) = (BTreeMap::new(), Vec::new());
    for run in run_folders(folder)? {
        let report = Report::read(&run)?;
        report.check_means(&name(&run), &mut wrong);
        check_views(&run, &report, &mut wrong)?;
        check_depths(&run, &report, &mut wrong)?;
        check_config(&run, &report, &mut wrong);
        let smoothness = csv_lines(&run.join("smoothness.csv"))?.and_then(|mut lines| lines.pop());
        runs.insert(name(&run), (report, smoothness));
    }
    findings.of(format!("{} runs: means are those of the views, metrics.csv that of metrics.json", runs.len()), wrong);
    let path = folder.join("summary.csv");
    if let Some(lines) = csv_lines(&path)? {
        let mut wrong = Vec::new();
        for line in &lines {
            check_summary(&runs, line, &mut wrong);
        }
        findings.of(format!("summary.csv: {} lines agree with their runs", lines.len()), wrong);
    }
    findings.not_checked("tables and weights: these are single runs, whose configurations are not kept");
    Ok(())
}

/// A line's cells by column.
type Line = Map<String, Value>;

/// `metrics.json` as any revision wrote it.
#[derive(serde::Deserialize)]
struct Report {
    mean: Map<String, Value>,
    views: Vec<Map<String, Value>>,
    protocol: Map<String, Value>,
}

impl Report {
    fn read(run: &Path) -> Result<Report> {
        let path = run.join("metrics.json");
        read_json(&path, "it is no report of a run")?
            .ok_or_else(|| Error::Data(format!("{} has no metrics.json", run.display())))
    }

    /// Means over the views, in their order, and what follows from them.
    fn check_means(&self, run: &str, wrong: &mut Vec<String>) {
        let mean = |key: &str| {
            let values = self.views.iter().map(|view| view.get(key)?.as_f64()).collect::<Option<Vec<f64>>>()?;
            (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
        };
        for (key, found) in &self.mean {
            let is_of_mean = key == PSNR_OF_MEAN.key;
            let made = if is_of_mean { mean(MSE.key).map(|mse| -10.0 * mse.log10()) } else { mean(key) };
            let Some((made, found)) = made.zip(found.as_f64()) else { continue };
            // What is not finite is no mean: it compares as unequal.
            if !made.is_finite() || (made - found).abs() > 1e-12 * made.abs() {
                wrong.push(format!("{run}/metrics.json: mean {key} is {found}, its views make {made}"));
            }
        }
    }
}

/// `metrics.csv` has the numbers of `metrics.json`.
fn check_views(run: &Path, report: &Report, wrong: &mut Vec<String>) -> Result<()> {
    let path = run.join("metrics.csv");
    let Some(lines) = csv_lines(&path)? else {
        wrong.push(format!("{}: it is not there", path.display()));
        return Ok(());
    };
    if lines.len() != report.views.len() {
        wrong.push(format!("{}: {} lines of {} views", path.display(), lines.len(), report.views.len()));
    }
    for (line, view) in lines.iter().zip(&report.views) {
        for (column, cell) in line {
            let known = view.get(column).or_else(|| report.protocol.get(column));
            if known.is_some_and(|known| text(known) != text(cell)) {
                wrong.push(format!("{}: {column} is '{}', metrics.json has another", path.display(), text(cell)));
            }
        }
    }
    Ok(())
}

/// `depth_errors.gz` has the views of `metrics.json` that have a depth of their own.
fn check_depths(run: &Path, report: &Report, wrong: &mut Vec<String>) -> Result<()> {
    let path = RunDir::depth_errors_in(run);
    let Some(errors) = DepthErrors::read(&path)? else { return Ok(()) };
    let found = errors.views.iter().filter(|view| !view.is_empty()).count();
    let measured =
        report.views.iter().filter(|view| view.get(DEPTH_LEFT_OUT.key).is_some_and(Value::is_number)).count();
    if found != measured {
        wrong.push(format!("{}: depths of {found} views, metrics.json has {measured}", path.display()));
    }
    Ok(())
}

/// `metrics.json` is of the configuration beside it, if the folder is a complete run.
fn check_config(run: &Path, report: &Report, wrong: &mut Vec<String>) {
    if !RunDir::holds_run(run) {
        return;
    }
    match RunDir::open(run).and_then(|run| run.read_config()) {
        Ok(config) => wrong.extend(
            foreign(&report.protocol, &config)
                .map(|why| format!("{}/metrics.json: not the run's own evaluation: {why}", name(run))),
        ),
        Err(error) => wrong.push(error.to_string()),
    }
}

/// A line of `summary.csv` has its run's means and protocol, and the smoothness of its evaluated network.
fn check_summary(runs: &BTreeMap<String, (Report, Option<Line>)>, line: &Line, wrong: &mut Vec<String>) {
    let run = line.get("run").map(text).unwrap_or_default();
    let Some((report, smoothness)) = runs.get(&run) else {
        wrong.push(format!("summary.csv: there is no run '{run}'"));
        return;
    };
    for (column, cell) in line {
        let known = [Some(&report.mean), Some(&report.protocol), smoothness.as_ref()];
        let known = known.into_iter().flatten().find_map(|part| part.get(column));
        if known.is_some_and(|known| text(known) != text(cell)) {
            wrong.push(format!("summary.csv: {column} of {run} is '{}', its run has another", text(cell)));
        }
    }
}

/// The lines of a CSV file; none where there is no such file.
fn csv_lines(path: &Path) -> Result<Option<Vec<Line>>> {
    let Some(bytes) = optional(path)? else { return Ok(None) };
    let bad = |e: String| Error::Data(format!("{}: {e}", path.display()));
    let mut reader = csv::Reader::from_reader(bytes.as_slice());
    let head = column_names(&mut reader).map_err(bad)?;
    let line = |row: csv::Result<csv::StringRecord>| {
        let row = row.map_err(|e| bad(e.to_string()))?;
        Ok(head
            .iter()
            .zip(&row)
            .map(|(name, cell)| plain_field((name.to_string(), plain_cell(cell).to_string())))
            .map(|(name, cell)| (name, Value::String(cell)))
            .collect())
    };
    reader.records().map(line).collect::<Result<_>>().map(Some)
}

fn name(run: &Path) -> String {
    run.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}
