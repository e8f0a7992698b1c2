//! `augnerf sweep`: flags and steps that its commands share; each command has a file.

use std::collections::{BTreeSet, HashSet};
use std::io::IsTerminal;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::{Args, Subcommand};
use serde_json::{Map, Value, json};

use crate::base::{Error, Result};
use crate::metrics::{Metric, Needs, Scope};
use crate::report::tables::{Table, table_columns};
use crate::report::{Record, Status};
use crate::run::load_lpips;
use crate::runtime::Runtime;
use crate::settings::columns::{AXIS, SETTING};
use crate::settings::{Config, parse_assignment};
use crate::sweep::verify::Archive;
use crate::sweep::{
    Change, Definition, MeasureSteps, Overrides, Point, Results, StepSeconds, Sweep, SweepFolder, TableOptions,
    Trainings, begin, check_name, check_results_place, plan,
};

use super::LpipsWeights;
use super::progress::{Console, duration};

mod across;
mod collect;
mod new;
mod plan;
mod run;
mod run_point;
mod slurm;
mod status;

/// The folder of points: those of the sweep NAME are in `runs/NAME`.
const RUNS: &str = "runs";
/// The folder of tables: `results/NAME`, or `DIR/results` with `--out DIR`.
const RESULTS: &str = "results";

#[derive(Subcommand)]
pub enum SweepCommand {
    /// Run or resume all points of a sweep and write its tables
    #[command(after_help = run::EXAMPLES)]
    Run(run::RunArguments),
    /// List a sweep's points and measure their cost, without running them
    #[command(after_help = plan::EXAMPLES)]
    Plan(plan::PlanArguments),
    /// Show which points are done, running or failed
    #[command(after_help = status::EXAMPLES)]
    Status(status::StatusArguments),
    /// Write tables and figures from the finished points
    #[command(after_help = collect::EXAMPLES)]
    Collect(collect::CollectArguments),
    /// Run one point of a sweep, for a job array
    #[command(after_help = run_point::EXAMPLES)]
    RunPoint(run_point::RunPointArguments),
    /// Write the script of a Slurm job array that runs the points
    #[command(after_help = slurm::EXAMPLES)]
    Slurm(slurm::SlurmArguments),
    /// Compare two rows in each of several sweeps
    #[command(after_help = across::EXAMPLES)]
    Across(across::AcrossArguments),
    /// Write a sweep file with comments, to change and run
    #[command(after_help = new::EXAMPLES)]
    New(new::NewArguments),
}

impl SweepCommand {
    pub fn run(self) -> Result<()> {
        match self {
            SweepCommand::Run(arguments) => arguments.run(),
            SweepCommand::Plan(arguments) => arguments.run(),
            SweepCommand::Status(arguments) => arguments.run(),
            SweepCommand::Collect(arguments) => arguments.run(),
            SweepCommand::RunPoint(arguments) => arguments.run(),
            SweepCommand::Slurm(arguments) => arguments.run(),
            SweepCommand::Across(arguments) => arguments.run(),
            SweepCommand::New(arguments) => arguments.run(),
        }
    }
}

/// Flags that name a sweep and its folders.
#[derive(Args)]
struct Location {
    /// Sweep file, or the name of a shipped sweep: tab4_fern
    file: PathBuf,
    /// Folder of the scenes
    #[arg(long, env = "AUGNERF_DATA", value_name = "DIR", help_heading = "Experiment")]
    data_root: Option<PathBuf>,
    /// Name of the sweep: points in runs/NAME, tables in results/NAME [default: the file's]
    #[arg(long, help_heading = "Output")]
    name: Option<String>,
    /// Folder for points and tables [default: runs/NAME and results/NAME]
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out: Option<PathBuf>,
}

/// Flags that change a definition.
#[derive(Args)]
#[command(next_help_heading = "Experiment")]
struct Changes {
    /// Preset [default: the file's]
    #[arg(long, value_name = "NAME")]
    preset: Option<String>,
    /// Scenes: folders in the data root, builtin, builtin-forward, or one by number: builtin:17 [default: the file's]
    #[arg(long, value_delimiter = ',', value_name = "SCENE,...")]
    scenes: Option<Vec<String>>,
    /// Seeds and ranges of them: 0,1 or 0-9 [default: the file's]
    #[arg(long, value_delimiter = ',', value_name = "N,...")]
    seeds: Option<Vec<Seeds>>,
    /// A setting for all points, which rows and axes override: --set train.steps=1000
    #[arg(long, value_name = "FIELD=VALUE")]
    set: Vec<String>,
}

/// A seed, or a range of seeds with both ends: `0-9`.
#[derive(Clone, Debug, PartialEq)]
struct Seeds(RangeInclusive<u64>);

/// Most seeds of a range, as many as a sweep has points.
const MOST_SEEDS: u64 = 10_000;

impl FromStr for Seeds {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Seeds, String> {
        let wrong = || format!("'{text}' is no seed; give whole numbers such as 3, or ranges such as 0-9");
        let number = |text: &str| text.trim().parse::<u64>().map_err(|_| wrong());
        let (first, last) = text.split_once('-').unwrap_or((text, text));
        let (first, last) = (number(first)?, number(last)?);
        if last < first || last - first >= MOST_SEEDS {
            return Err(format!(
                "'{text}' is no range; it begins with the smaller number and has at most {MOST_SEEDS} seeds"
            ));
        }
        Ok(Seeds(first..=last))
    }
}

impl Location {
    fn name(&self) -> Result<String> {
        let stem = || self.file.file_stem().map(|stem| stem.to_string_lossy().into_owned());
        let name = self.name.clone().or_else(stem).unwrap_or_default();
        if name.is_empty() || name.contains(['/', '\\']) || name == "." || name == ".." {
            return Err(Error::Config(format!("--name '{name}': not a name; choose one without path separators")));
        }
        check_name("the sweep's name", &name).map_err(Error::Config)?;
        Ok(name)
    }

    fn folder(&self) -> Result<SweepFolder> {
        Ok(SweepFolder::new(&match &self.out {
            Some(out) => out.clone(),
            None => Path::new(RUNS).join(self.name()?),
        }))
    }

    fn results(&self) -> Result<PathBuf> {
        Ok(match &self.out {
            Some(out) => out.join(RESULTS),
            None => Path::new(RESULTS).join(self.name()?),
        })
    }
}

impl Changes {
    fn definition(&self, location: &Location) -> Result<Definition> {
        let mut definition = Definition::read(&location.file)?;
        let set = self.set.iter().map(|text| parse_assignment(text)).collect::<Result<Vec<_>>>()?;
        definition.apply(Overrides {
            preset: self.preset.clone(),
            scenes: self.scenes.clone(),
            seeds: self.seeds.as_ref().map(|seeds| seeds.iter().flat_map(|seeds| seeds.0.clone()).collect()),
            set,
        })?;
        Ok(definition)
    }
}

/// Returns a table as JSON: its folder, and the rows of `table.csv` with all columns. Counts and metrics are numbers,
/// empty cells are null.
pub(super) fn table_json(table: &Table, results: &Path) -> Value {
    let columns = table_columns(table, &[]);
    let cell = |name: &str, cell: &Value| match cell {
        Value::String(text) if text.is_empty() => Value::Null,
        // A swept value is text, which may be a number. A hash of digits is none.
        Value::String(text) if name.starts_with(AXIS) || name.starts_with(SETTING) => {
            text.parse().map_or_else(|_| cell.clone(), Value::Number)
        }
        other => other.clone(),
    };
    let row = |line: usize| -> Map<String, Value> {
        columns.iter().map(|(name, cells)| (name.clone(), cell(name, &cells[line]))).collect()
    };
    let rows: Vec<_> = (0..table.lines.len()).map(row).collect();
    json!({ "name": table.name, "title": table.title, "results": results.display().to_string(), "rows": rows })
}

/// Returns the columns of the terminal, or 160 for a file or a pipe.
pub(super) fn terminal_width() -> u16 {
    let (_, columns) = console::Term::stdout().size();
    if std::io::stdout().is_terminal() { columns.max(60) } else { 160 }
}

/// Returns the points of a created sweep.
fn begun(folder: &SweepFolder, data_root: Option<&Path>) -> Result<Vec<Point>> {
    folder.points(data_root)?.ok_or_else(|| {
        Error::Checkpoint(format!("{}: no points.json; create it with `augnerf sweep run`", folder.path().display()))
    })
}

/// Creates or opens the folder of a sweep, whose new points `trainings` checks. `measure` gives the seconds of steps;
/// their source is printed.
fn begin_folder(
    location: &Location,
    definition: &Definition,
    extend: bool,
    (trainings, measure): (&Trainings, &MeasureSteps),
    console: &Console,
) -> Result<(SweepFolder, Vec<Point>)> {
    let (folder, results) = (location.folder()?, location.results()?);
    // Before hours of training rather than after.
    check_results_place(&results, &location.name()?, &folder)?;
    let check = |points: &[Point], refused| trainings.check_points(points, refused);
    let measure = |configs: &[&Config]| published_or_measured(&results, configs, measure, console);
    let points = begin(&folder, definition, location.data_root.as_deref(), extend, &measure, &check);
    Ok((folder, points.map_err(elsewhere)?))
}

/// Returns the seconds of steps next to the tables, which it names, or measures them if any is missing there.
fn published_or_measured(
    results: &Path,
    configs: &[&Config],
    measure: &MeasureSteps,
    console: &Console,
) -> Result<StepSeconds> {
    let Some(seconds) = StepSeconds::published(results, configs)? else { return measure(configs) };
    let clock = seconds.clock.as_ref().map_or(String::new(), |clock| format!(", measured on {clock}"));
    let file = SweepFolder::new(results).step_seconds();
    console.say(&format!("budgets in seconds: step times of {}{clock}", file.display()));
    Ok(seconds)
}

/// Returns the points of a sweep, or those that its folder would get, checked by `trainings`.
fn planned_points(
    location: &Location,
    definition: &Definition,
    trainings: &Trainings,
    console: &Console,
    checked: impl Fn(),
) -> Result<Vec<Point>> {
    let (folder, data_root) = (location.folder()?, location.data_root.as_deref());
    match folder.points(data_root)? {
        Some(points) if folder.compare(definition)? == Change::None => {
            checked();
            Ok(points)
        }
        _ => {
            let results = location.results()?;
            let estimated = |configs: &[&Config]| trainings.estimated_step_seconds(configs);
            let measure = |configs: &[&Config]| published_or_measured(&results, configs, &estimated, console);
            let check = |points: &[Point], refused| trainings.check_points(points, refused).map(|()| checked());
            plan(definition, data_root, &measure, &check)
        }
    }
}

/// Returns the trainings of a definition, with the available LPIPS weights.
fn trainings<'a>(
    definition: &Definition,
    weights: &LpipsWeights,
    runtime: &Runtime,
    console: &'a Console,
) -> Result<Trainings<'a>> {
    let weights = weights.lpips_weights.as_ref().map(std::path::absolute).transpose();
    let weights = weights.map_err(|e| Error::Config(format!("--lpips-weights: {e}")))?;
    let weights = weights.map_or(String::new(), |dir| dir.to_string_lossy().into_owned());
    let lpips = load_lpips(&weights, runtime.device())?;
    let smoothness = definition.metric_in(Scope::Lattice).is_some();
    Ok(Trainings::new(runtime.clone(), (lpips, weights), smoothness, console))
}

/// Returns a definition's metrics that can be measured with the LPIPS weights of its trainings, and the others.
fn by_weights(definition: &Definition, trainings: &Trainings) -> (Vec<String>, Vec<String>) {
    definition.metrics.iter().cloned().partition(|metric| match Metric::find(metric).map(|metric| metric.needs) {
        Some(Needs::Lpips(backbone)) => trainings.lpips.iter().any(|lpips| lpips.backbone() == backbone),
        _ => true,
    })
}

/// Prints the metrics that cannot be measured for want of LPIPS weights, when trainings start.
fn say_what_is_missing(definition: &Definition, trainings: &Trainings, console: &Console) {
    let (_, metrics) = by_weights(definition, trainings);
    if !metrics.is_empty() {
        console.say(&format!(
            "not measured without LPIPS weights (--lpips-weights, AUGNERF_LPIPS_WEIGHTS): {}; `augnerf sweep run \
             --remeasure` can measure them later",
            metrics.join(", ")
        ));
    }
}

/// Returns the name of a sweep: that of its folder.
fn name_of(folder: &Path) -> Result<String> {
    let path = std::path::absolute(folder).map_err(|e| Error::unreadable(folder, &e))?;
    let name = path.file_name().map_or("sweep".into(), |name| name.to_string_lossy().into_owned());
    check_name("the sweep's name", &name).map_err(Error::Config)?;
    Ok(name)
}

/// Returns one record of each point. Several rows may show a point. In two sweeps, it may be done in one alone.
fn one_of_each(records: &[Record]) -> impl Iterator<Item = &Record> {
    let mut seen = HashSet::new();
    records.iter().filter(move |record| seen.insert((record.id.as_str(), record.status.name())))
}

/// Checks that all points of a sweep are done.
///
/// # Errors
/// [`Error::PointsFailed`], [`Error::PointsWaiting`] or [`Error::PointsWithoutData`], with the reasons.
fn check_done(records: &[Record]) -> Result<()> {
    let points: Vec<&Record> = one_of_each(records).collect();
    let of = |status| points.iter().filter(move |point| point.status == status);
    let count = |status| of(status).count();
    let (all, done) = (points.len(), count(Status::Done));
    let [failed, waiting, running, no_data] =
        [Status::Failed, Status::Waiting, Status::Running, Status::NoData].map(count);
    if failed > 0 {
        return Err(Error::PointsFailed(format!(
            "{failed} of {all} points failed ({done} are done); run them again with --retry-failed:{}",
            reasons(of(Status::Failed).map(|point| (point.reason.as_str(), point.point_label())))
        )));
    }
    if waiting + running > 0 {
        return Err(Error::PointsWaiting(format!(
            "{done} of {all} points are done, {running} are running and {waiting} are waiting; `augnerf sweep run` runs them"
        )));
    }
    if no_data > 0 {
        let scenes: BTreeSet<&str> = of(Status::NoData).map(|point| point.scene.as_str()).collect();
        let reason = of(Status::NoData).map(|point| point.reason.as_str()).next().unwrap_or_default();
        return Err(Error::PointsWithoutData(format!(
            "{no_data} of {all} points have no data here ({done} are done), because scenes are missing: {} ({reason}); put them \
             into --data-root (AUGNERF_DATA) and run the sweep again",
            scenes.into_iter().collect::<Vec<_>>().join(", ")
        )));
    }
    Ok(())
}

/// Checks that not all points lack their scenes: such a sweep has no table.
///
/// # Errors
/// [`Error::PointsWithoutData`].
fn check_any_data(records: &[Record]) -> Result<()> {
    let is_lost = records.iter().all(|record| record.status == Status::NoData);
    if is_lost { check_done(records) } else { Ok(()) }
}

/// Lists the reasons of failed points, each once with the labels of the points that it is of.
fn reasons<'a>(failed: impl Iterator<Item = (&'a str, String)>) -> String {
    let mut by_reason: Vec<(&str, Vec<String>)> = Vec::new();
    for (own, label) in failed {
        match by_reason.iter_mut().find(|(reason, _)| *reason == own) {
            Some((_, labels)) => labels.push(label),
            None => by_reason.push((own, vec![label])),
        }
    }
    by_reason.iter().map(|(reason, labels)| format!("\n  {}: {reason}", labels.join("; "))).collect()
}

/// Opens `runs/NAME` or `results/NAME`, of the former the points' records alone.
fn open(path: &Path, data_root: Option<&Path>) -> Result<Sweep> {
    if path.join("provenance.toml").is_file() {
        return Ok(Archive::read(path, data_root)?.sweep);
    }
    let folder = SweepFolder::new(path);
    let definition = folder.definition()?;
    let points = begun(&folder, data_root)?;
    Sweep::of_folder(name_of(path)?, folder, definition, points)
}

/// Opens sweeps with all outputs of their points.
fn read_all(paths: &[PathBuf], data_root: Option<&Path>) -> Result<Vec<Sweep>> {
    let read = |path: &PathBuf| {
        let mut sweep = open(path, data_root)?;
        sweep.read_outputs().map(|()| sweep)
    };
    paths.iter().map(read).collect()
}

/// Writes tables and figures of a sweep's points in the folder `runs` into `results`, and returns the table.
fn collect((sweep, runs): (&mut Sweep, &SweepFolder), results: &Path, options: TableOptions) -> Result<Table> {
    check_results_place(results, &sweep.name, runs)?;
    let results = Results::take(results).map_err(elsewhere)?;
    sweep.read_outputs()?;
    sweep.write(&results, options).map_err(elsewhere)
}

/// Adds to the error of a folder that cannot be written, such as somebody else's, how to name another.
fn elsewhere(error: Error) -> Error {
    match error {
        Error::Output(text) if text.starts_with("cannot write ") => {
            Error::Output(format!("{text}; name another folder with --out"))
        }
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_are_numbers_and_ranges() {
        let read = |text: &str| text.parse::<Seeds>().map(|seeds| seeds.0.collect::<Vec<_>>());
        assert_eq!(read("3"), Ok(vec![3]));
        assert_eq!(read("0-3"), Ok(vec![0, 1, 2, 3]));
        for wrong in ["", "a", "-1", "3-1", "0-10000", "1-2-3", "0..3"] {
            assert!(read(wrong).unwrap_err().starts_with(&format!("'{wrong}' is no ")), "{wrong}");
        }
    }
}
