//! `augnerf sweep`: which sweep is meant, and a file a command.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use serde_json::json;

use crate::base::csv::plain_cell;
use crate::base::{Error, Result};
use crate::metrics::{Lpips, Metric, Needs, Scope};
use crate::report::tables::{Table, table_csv};
use crate::run::load_lpips;
use crate::runtime::Runtime;
use crate::settings::parse_assignment;
use crate::sweep::{
    Change, Collector, Definition, Overrides, Point, PublishedCosts, Results, StepCosts, SweepFolder, SweepOutputs,
    Trainings, begin, check_name, expand,
};

use super::LpipsWeights;
use super::progress::{Console, duration, report};

mod across;
mod begin;
mod best;
mod cancel;
mod collect;
mod new;
mod opened;
mod plan;
mod power;
mod run;
mod run_point;
mod status;
mod submit;

/// Points of the sweep NAME are in `runs/NAME`.
const RUNS: &str = "runs";
/// Its tables are in `results/NAME`, or in `DIR/results` below `--out DIR`.
const RESULTS: &str = "results";

#[derive(Subcommand)]
pub enum SweepCommand {
    /// Run all points of a sweep, or go on with it, and write its tables
    #[command(after_help = run::EXAMPLES)]
    Run(run::RunArguments),
    /// List the points and measure what they will cost, without running them
    #[command(after_help = plan::EXAMPLES)]
    Plan(plan::PlanArguments),
    /// Show what is done, running, failed
    #[command(after_help = status::EXAMPLES)]
    Status(status::StatusArguments),
    /// Write tables and figures from what is done, from files alone: all of a sweep, chosen rows, or several sweeps
    #[command(after_help = collect::EXAMPLES)]
    Collect(collect::CollectArguments),
    /// Lay out a sweep's folder without running anything: its points may then run anywhere
    #[command(after_help = begin::EXAMPLES)]
    Begin(begin::BeginArguments),
    /// Run one point of a folder that was begun: a task of a cluster's job array, or of a loop
    #[command(after_help = run_point::EXAMPLES)]
    RunPoint(run_point::RunPointArguments),
    /// Have a cluster run the points: a Slurm job array, and a job that collects
    #[command(after_help = submit::EXAMPLES)]
    Submit(submit::SubmitArguments),
    /// Take what was submitted out of the queue; what runs stops with a checkpoint
    #[command(after_help = cancel::EXAMPLES)]
    Cancel(cancel::CancelArguments),
    /// Say which row is best, with its settings and folders
    #[command(after_help = best::EXAMPLES)]
    Best(best::BestArguments),
    /// Compare two rows in each of several sweeps, corrected over the sweeps
    #[command(after_help = across::EXAMPLES)]
    Across(across::AcrossArguments),
    /// Say how many seeds a difference takes, without showing any
    #[command(after_help = power::EXAMPLES)]
    Power(power::PowerArguments),
    /// Write a sweep file with comments, to be changed and run
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
            SweepCommand::Begin(arguments) => arguments.run(),
            SweepCommand::RunPoint(arguments) => arguments.run(),
            SweepCommand::Submit(arguments) => arguments.run(),
            SweepCommand::Cancel(arguments) => arguments.run(),
            SweepCommand::Best(arguments) => arguments.run(),
            SweepCommand::Across(arguments) => arguments.run(),
            SweepCommand::Power(arguments) => arguments.run(),
            SweepCommand::New(arguments) => arguments.run(),
        }
    }
}

/// Which sweep, and where it lies.
#[derive(Args)]
struct Location {
    /// Sweep file
    file: PathBuf,
    /// The sweep's name: points in runs/NAME, tables in results/NAME [default: the file's]
    #[arg(long)]
    name: Option<String>,
    /// Folder for points and tables instead of runs/NAME and results/NAME
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Folder that the definition's scenes lie in
    #[arg(long, env = "AUGNERF_DATA", value_name = "DIR")]
    data_root: Option<PathBuf>,
}

/// What the command line changes in a definition.
#[derive(Args)]
struct Changes {
    /// Another preset than the file's
    #[arg(long, value_name = "NAME")]
    preset: Option<String>,
    /// Other scenes: folders below the data root, builtin, builtin-forward
    #[arg(long, value_delimiter = ',', value_name = "SCENE,...")]
    scenes: Option<Vec<String>>,
    /// Other seeds
    #[arg(long, value_delimiter = ',', value_name = "N,...")]
    seeds: Option<Vec<u64>>,
    /// A setting for all points, under what rows and axes set: --set train.steps=1000
    #[arg(long, value_name = "FIELD=VALUE")]
    set: Vec<String>,
}

impl Location {
    fn name(&self) -> Result<String> {
        let stem = || self.file.file_stem().map(|stem| stem.to_string_lossy().into_owned());
        let name = self.name.clone().or_else(stem).unwrap_or_default();
        if name.is_empty() || name.contains(['/', '\\']) || name == "." || name == ".." {
            return Err(Error::Config(format!("--name '{name}': give a name without path separators")));
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
            seeds: self.seeds.clone(),
            set,
        })?;
        Ok(definition)
    }
}

/// A table for other programs: where it lies, and the rows of `table.csv`, whose counts and metrics are numbers and whose empty
/// cells are null.
pub(super) fn table_json(table: &Table, results: &Path) -> serde_json::Value {
    let text = table_csv(table, &[]);
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let names = reader.headers().expect("a table has a head").clone();
    // A hash of digits is no number.
    let of_metric = |name: &str| {
        table.metrics.iter().any(|metric| name.strip_prefix(metric).is_some_and(|rest| rest.starts_with('_')))
    };
    let numeric = |name: &str| ["points", "done"].contains(&name) || of_metric(name);
    let cell = |name: &str, text: &str| match text.parse::<serde_json::Number>() {
        _ if text.is_empty() => serde_json::Value::Null,
        Ok(number) if numeric(name) => number.into(),
        _ => plain_cell(text).into(),
    };
    let object = |row: csv::StringRecord| -> serde_json::Map<String, serde_json::Value> {
        names.iter().zip(&row).map(|(name, text)| (name.to_string(), cell(name, text))).collect()
    };
    let rows: Vec<_> = reader.records().map(|row| object(row.expect("rows are as long as the head"))).collect();
    json!({ "name": table.name, "title": table.title, "results": results.display().to_string(), "rows": rows })
}

/// Columns of the terminal; a file or a pipe gets lines that most screens show.
pub(super) fn terminal_width() -> u16 {
    let (_, columns) = console::Term::stdout().size();
    if std::io::stdout().is_terminal() { columns.max(60) } else { 160 }
}

/// The points of a folder that a sweep was begun in.
fn begun(folder: &SweepFolder, data_root: Option<&Path>) -> Result<Vec<Point>> {
    folder.points(data_root)?.ok_or_else(|| {
        Error::Checkpoint(format!("{} has no points.json: `augnerf sweep run` writes it", folder.path().display()))
    })
}

/// Lays out the folder of a sweep, or goes on with it; says where seconds of steps came from, which `measure` gives.
fn begin_folder(
    location: &Location,
    definition: &Definition,
    extend: bool,
    measure: &dyn StepCosts,
    console: &Console,
) -> Result<(SweepFolder, Vec<Point>)> {
    let folder = location.folder()?;
    let costs = PublishedCosts::beside(&location.results()?, measure)?;
    let points = begin(&folder, definition, location.data_root.as_deref(), extend, &costs)?;
    costs.note().iter().for_each(|note| console.say(note));
    link_by_name(&folder, &points);
    Ok((folder, points))
}

/// The points that a sweep has or, before its folder is begun with this definition, would have.
fn planned_points(
    location: &Location,
    definition: &Definition,
    measure: &dyn StepCosts,
    console: &Console,
) -> Result<Vec<Point>> {
    let (folder, data_root) = (location.folder()?, location.data_root.as_deref());
    match folder.points(data_root)? {
        Some(points) if folder.compare(definition)? == Change::None => Ok(points),
        _ => {
            let costs = PublishedCosts::beside(&location.results()?, measure)?;
            let points = expand(definition, data_root, &costs)?;
            costs.note().iter().for_each(|note| console.say(note));
            Ok(points)
        }
    }
}

/// What trains and measures the points of a definition, and which of its metrics that can be with the LPIPS weights at hand; what
/// cannot is said.
fn trainings<'a>(
    definition: &Definition,
    weights: &LpipsWeights,
    runtime: &Runtime,
    console: &'a Console,
) -> Result<(Trainings<'a>, Vec<String>)> {
    let weights = weights.lpips_weights.as_ref().map(std::path::absolute).transpose();
    let weights = weights.map_err(|e| Error::Config(format!("--lpips-weights: {e}")))?;
    let weights = weights.map_or(String::new(), |dir| dir.to_string_lossy().into_owned());
    let lpips = load_lpips(&weights, runtime.device())?;
    let (measured, missing): (Vec<_>, Vec<_>) =
        definition.metrics.iter().cloned().partition(|metric| measurable(metric, &lpips));
    say_what_is_missing(&missing, console);
    let smoothness = definition.metric_in(Scope::Lattice).is_some();
    Ok((Trainings::new(runtime.clone(), (lpips, weights), smoothness, console), measured))
}

fn say_what_is_missing(metrics: &[String], console: &Console) {
    if !metrics.is_empty() {
        console.say(&format!(
            "not measured, for want of LPIPS weights (--lpips-weights, AUGNERF_LPIPS_WEIGHTS): {}; with --remeasure a \
             later run measures them from the points' checkpoints",
            metrics.join(", ")
        ));
    }
}

/// Whether a metric can be had with these LPIPS backbones.
fn measurable(metric: &str, lpips: &[Lpips]) -> bool {
    match Metric::find(metric).map(|metric| metric.needs) {
        Some(Needs::Lpips(backbone)) => lpips.iter().any(|lpips| lpips.backbone() == backbone),
        _ => true,
    }
}

/// The name of a sweep by its folder: the folder's own.
fn name_of(folder: &Path) -> Result<String> {
    let path = std::path::absolute(folder).map_err(|e| Error::unreadable(folder, &e))?;
    let name = path.file_name().map_or("sweep".into(), |name| name.to_string_lossy().into_owned());
    check_name("the sweep's name", &name).map_err(Error::Config)?;
    Ok(name)
}

/// Writes the links that call points by their rows' names, or says why there are none.
fn link_by_name(folder: &SweepFolder, points: &[Point]) {
    let said = folder.link_by_name(points).unwrap_or_else(|error| Some(error.to_string()));
    said.iter().for_each(|why| report(why));
}

/// How tables are made.
struct How {
    /// Rows that differ in an uncontrolled setting stand side by side, marked.
    force: bool,
    /// With clocks.
    with_timing: bool,
}

/// Writes tables and figures of what the points of a sweep's folder left into `results`, and returns the table.
fn collect(
    (folder, definition, points): (&SweepFolder, &Definition, &[Point]),
    name: &str,
    results: &Path,
    how: How,
) -> Result<Table> {
    link_by_name(folder, points);
    let results = Results::take(results)?;
    let outputs = &SweepOutputs::of_folder(folder, definition, points)?;
    let How { force, with_timing } = how;
    Collector { outputs, definition, points, name, force, with_timing }.write(&results)
}
