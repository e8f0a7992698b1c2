//! `augnerf sweep`.

use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use crate::base::{Error, Result};
use crate::metrics::{Lpips, Metric, Needs, Scope};
use crate::report::Status;
use crate::report::tables::table_terminal;
use crate::run::load_lpips;
use crate::runtime::Runtime;
use crate::settings::parse_assignment;
use crate::sweep::{
    Change, Collector, Cost, Definition, Options, Overrides, Point, Runner, SweepFolder, Trainings, begin, expand,
    shape,
};

use super::progress::{Console, print};
use super::train::catch_signals;
use super::{Compute, LpipsWeights};

const RUN_EXAMPLES: &str = "Examples:
  augnerf sweep run sweeps/smoke.toml                      two minutes on the embedded scene
  augnerf sweep run sweeps/tab4_ablation.toml --scenes builtin --preset smoke --name tab4_builtin
  AUGNERF_DATA=~/data augnerf sweep run sweeps/tab1_llff.toml --jobs 2
  augnerf sweep run sweeps/tab1_llff.toml --retry-failed   once more, with what failed

The same command goes on where it was stopped or killed; several on one folder share the points.
Exit codes: 0 done, 7 some points failed, 8 scenes of some points are missing, 9 rows may not stand in one
table (see --force), 130 or 143 stopped (run it again), 2 the
definition is wrong (do not run it again).";

/// Points of the sweep NAME are in `runs/NAME`.
const RUNS: &str = "runs";
/// Its tables are in `results/NAME`, or in `DIR/results` below `--out DIR`.
const RESULTS: &str = "results";

#[derive(Subcommand)]
pub enum SweepCommand {
    /// Run all points of a sweep, or go on with it, and write its tables
    #[command(after_help = RUN_EXAMPLES)]
    Run(RunArguments),
    /// List the points and measure what they will cost, without running them
    Plan(PlanArguments),
    /// Show what is done, running, failed
    Status(StatusArguments),
    /// Write tables and figures from what is done, from files alone
    Collect(CollectArguments),
}

impl SweepCommand {
    pub fn run(self) -> Result<()> {
        match self {
            SweepCommand::Run(arguments) => arguments.run(),
            SweepCommand::Plan(arguments) => arguments.run(),
            SweepCommand::Status(arguments) => arguments.run(),
            SweepCommand::Collect(arguments) => arguments.run(),
        }
    }
}

/// Which sweep, and where it lies.
#[derive(Args)]
struct Place {
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

impl Place {
    fn name(&self) -> Result<String> {
        let stem = || self.file.file_stem().map(|stem| stem.to_string_lossy().into_owned());
        let name = self.name.clone().or_else(stem).unwrap_or_default();
        if name.is_empty() || name.contains(['/', '\\']) || name == "." || name == ".." {
            return Err(Error::Config(format!("--name '{name}': give a name without path separators")));
        }
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
    fn definition(&self, place: &Place) -> Result<Definition> {
        let mut definition = Definition::read(&place.file)?;
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

#[derive(Args)]
pub struct RunArguments {
    #[command(flatten)]
    place: Place,
    #[command(flatten)]
    changes: Changes,
    /// Points at once; the threads are shared among them
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: u16,
    /// Go on after a point failed (the default)
    #[arg(long, conflicts_with = "fail_fast")]
    keep_going: bool,
    /// Stop at the first point that fails
    #[arg(long)]
    fail_fast: bool,
    /// Try points that failed again
    #[arg(long)]
    retry_failed: bool,
    /// Take a definition that has changed since the folder was begun; points that it no longer has stay on disk
    #[arg(long)]
    extend: bool,
    /// A point with which so many runners were killed in a row, none at a later checkpoint, counts as failed
    #[arg(long, value_name = "N", default_value_t = 25, value_parser = clap::value_parser!(u32).range(1..))]
    max_deaths: u32,
    /// Measure finished points again that lack a metric which can be measured now, such as LPIPS
    #[arg(long)]
    remeasure: bool,
    /// Put rows side by side that differ in an uncontrolled setting, such as the code's revision, and mark them
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    weights: LpipsWeights,
    #[command(flatten)]
    compute: Compute,
}

impl RunArguments {
    pub fn run(self) -> Result<()> {
        let runtime = self.compute.runtime()?;
        runtime.install(|| self.run_points(&runtime))
    }

    fn run_points(&self, runtime: &Runtime) -> Result<()> {
        let quiet = self.compute.quiet;
        let console = if self.jobs == 1 { Console::new(quiet) } else { Console::without_bars(quiet) };
        let definition = self.changes.definition(&self.place)?;
        let folder = self.place.folder()?;
        let weights = self.weights.lpips_weights.as_ref().map(std::path::absolute).transpose();
        let weights = weights.map_err(|e| Error::Config(format!("--lpips-weights: {e}")))?;
        let weights = weights.map_or(String::new(), |dir| dir.to_string_lossy().into_owned());
        let lpips = load_lpips(&weights, runtime.device())?;
        let (measured, missing): (Vec<_>, Vec<_>) =
            definition.metrics.iter().cloned().partition(|metric| measurable(metric, &lpips));
        if !missing.is_empty() {
            console.say(&format!(
                "not measured, for want of LPIPS weights (--lpips-weights, AUGNERF_LPIPS_WEIGHTS): {}; with --remeasure a \
                 later run measures them from the points' checkpoints",
                missing.join(", ")
            ));
        }
        let smoothness = definition.metric_in(Scope::Lattice).is_some();
        let trainings = Trainings::new(runtime.clone(), (lpips, weights), smoothness, &console);
        let points = begin(&folder, &definition, self.place.data_root.as_deref(), self.extend, &trainings)?;
        let options = Options {
            jobs: usize::from(self.jobs),
            fail_fast: self.fail_fast,
            retry_failed: self.retry_failed,
            most_deaths: self.max_deaths,
            remeasure: if self.remeasure { measured } else { Vec::new() },
        };
        let stop = catch_signals()?;
        let runner = Runner {
            folder: &folder,
            points: &points,
            runtime,
            work: &trainings,
            options,
            events: &console,
            stop: &stop,
        };
        let ran = runner.run();
        let name = self.place.name()?;
        let collector = Collector {
            folder: &folder,
            definition: &definition,
            points: &points,
            name: &name,
            results: &self.place.results()?,
            force: self.force,
            with_timing: false,
        };
        // A stopped sweep leaves the table of what is done, too.
        let table = collector.write();
        ran?;
        if let Ok(table) = &table
            && !quiet
        {
            print(&table_terminal(table, terminal_width()));
        }
        console.say(&format!("tables: {}", collector.results.display()));
        // What became of the points comes before what became of the table.
        summarise(&folder, &points)?;
        table.map(|_| ())
    }
}

/// Whether a metric can be had with these LPIPS backbones.
fn measurable(metric: &str, lpips: &[Lpips]) -> bool {
    match Metric::find(metric).map(|metric| metric.needs) {
        Some(Needs::Lpips(backbone)) => lpips.iter().any(|lpips| lpips.backbone() == backbone),
        _ => true,
    }
}

/// Says what became of the points; an error where not all are done.
fn summarise(folder: &SweepFolder, points: &[Point]) -> Result<()> {
    let states = points.iter().map(|point| folder.point(&point.id).state(point)).collect::<Result<Vec<_>>>()?;
    let count = |status| states.iter().filter(|state| state.status == status).count();
    let reasons = points.iter().zip(&states).filter(|(_, state)| state.status == Status::Failed);
    let reasons: Vec<String> =
        reasons.map(|(point, state)| format!("\n  {}: {}", point.label(), state.reason)).collect();
    let (done, failed, no_data) = (count(Status::Done), count(Status::Failed), count(Status::NoData));
    if failed > 0 {
        return Err(Error::PointsFailed(format!(
            "{failed} of {} points failed ({done} are done); --retry-failed tries them again:{}",
            points.len(),
            reasons.concat()
        )));
    }
    if no_data > 0 {
        let first = states.iter().find(|state| state.status == Status::NoData).expect("counted");
        return Err(Error::PointsWithoutData(format!(
            "{no_data} of {} points have no data here ({done} are done): {}; put the scenes below --data-root \
             (AUGNERF_DATA) and run the sweep again",
            points.len(),
            first.reason
        )));
    }
    Ok(())
}

/// Columns of the terminal; a file or a pipe gets lines that most screens show.
fn terminal_width() -> u16 {
    let (_, columns) = console::Term::stdout().size();
    if std::io::stdout().is_terminal() { columns.max(60) } else { 160 }
}

/// The points of a folder that a sweep was begun in.
fn begun(folder: &SweepFolder, data_root: Option<&Path>) -> Result<Vec<Point>> {
    folder.points(data_root)?.ok_or_else(|| {
        Error::Checkpoint(format!("{} has no points.json: `augnerf sweep run` writes it", folder.path().display()))
    })
}

#[derive(Args)]
pub struct CollectArguments {
    /// Folder of a sweep: runs/NAME, or what --out named
    folder: PathBuf,
    /// Folder for tables and figures [default: results/NAME of runs/NAME, otherwise FOLDER/results]
    #[arg(long, value_name = "DIR")]
    results: Option<PathBuf>,
    /// Put rows side by side that differ in an uncontrolled setting, such as the code's revision, and mark them
    #[arg(long)]
    force: bool,
    /// Join seconds and memory to the tables
    #[arg(long)]
    with_timing: bool,
    /// Folder that the definition's scenes lie in
    #[arg(long, env = "AUGNERF_DATA", value_name = "DIR")]
    data_root: Option<PathBuf>,
}

impl CollectArguments {
    pub fn run(self) -> Result<()> {
        let folder = SweepFolder::new(&self.folder);
        let definition = folder.definition()?;
        let points = begun(&folder, self.data_root.as_deref())?;
        let path = std::path::absolute(&self.folder).map_err(|e| Error::unreadable(&self.folder, &e))?;
        let name = path.file_name().map_or("sweep".into(), |name| name.to_string_lossy().into_owned());
        let runs = path.parent().filter(|parent| parent.file_name().is_some_and(|name| name == RUNS));
        let results = self.results.clone().unwrap_or_else(|| match runs {
            Some(runs) => runs.with_file_name(RESULTS).join(&name),
            None => path.join(RESULTS),
        });
        let (force, with_timing) = (self.force, self.with_timing);
        let collector = Collector {
            folder: &folder,
            definition: &definition,
            points: &points,
            name: &name,
            results: &results,
            force,
            with_timing,
        };
        print(&table_terminal(&collector.write()?, terminal_width()));
        print(&format!("tables: {}", results.display()));
        Ok(())
    }
}

#[derive(Args)]
pub struct PlanArguments {
    #[command(flatten)]
    place: Place,
    #[command(flatten)]
    changes: Changes,
    #[command(flatten)]
    compute: Compute,
}

impl PlanArguments {
    pub fn run(self) -> Result<()> {
        let runtime = self.compute.runtime()?;
        runtime.install(|| self.plan(&runtime))
    }

    fn plan(&self, runtime: &Runtime) -> Result<()> {
        let console = Console::new(self.compute.quiet);
        let definition = self.changes.definition(&self.place)?;
        let folder = self.place.folder()?;
        let trainings = Trainings::new(runtime.clone(), (Vec::new(), String::new()), false, &console);
        let data_root = self.place.data_root.as_deref();
        let points = match folder.points(data_root)? {
            Some(points) if folder.compare(&definition)? == Change::None => points,
            _ => expand(&definition, data_root, &trainings)?,
        };
        print(&format!("{} points", points.len()));
        let left: Vec<&Point> =
            points.iter().filter(|point| point.no_data.is_none() && !folder.point(&point.id).ended()).collect();
        // Points of equal steps and shape cost the same.
        let mut kinds: BTreeMap<(String, u64), Vec<&Point>> = BTreeMap::new();
        for point in &left {
            kinds.entry((shape(&point.config), point.config.train.steps)).or_default().push(point);
        }
        let mut costs: BTreeMap<&str, Cost> = BTreeMap::new();
        let (mut total, mut memory) = (0.0, None);
        for ((shape, steps), points) in &kinds {
            let cost = match costs.get(shape.as_str()) {
                Some(cost) => *cost,
                None => trainings.cost(&points[0].config)?,
            };
            costs.insert(shape, cost);
            total += points.len() as f64 * cost.seconds(*steps);
            memory = [memory, cost.peak_memory_mib].into_iter().flatten().reduce(f64::max);
            print(&format!(
                "{:4} x {:44} {:8.3} s/step  {:9} a point  {}",
                points.len(),
                points[0].label(),
                cost.seconds_per_step,
                duration(cost.seconds(*steps)),
                mebibytes(cost.peak_memory_mib)
            ));
        }
        let missing = points.iter().filter(|point| point.no_data.is_some()).count();
        if missing > 0 {
            print(&format!("{missing:4} x no data"));
        }
        let ended = points.len() - missing - left.len();
        if ended > 0 {
            print(&format!("{ended:4} x done or failed before"));
        }
        print(&format!(
            "{} in all, one point after the other, and {} of memory; --jobs N needs N times as much. Rendering is counted; \
             LPIPS and smoothness are not",
            duration(total),
            mebibytes(memory)
        ));
        Ok(())
    }
}

fn mebibytes(memory: Option<f64>) -> String {
    memory.map_or("unknown".into(), |mib| format!("{mib:.0} MiB"))
}

/// Seconds for a person.
fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s if s < 172_800.0 => format!("{:.1} h", s / 3600.0),
        s => format!("{:.1} days", s / 86_400.0),
    }
}

#[derive(Args)]
pub struct StatusArguments {
    /// Folder of a sweep: runs/NAME, or what --out named
    folder: PathBuf,
    /// Folder that the definition's scenes lie in
    #[arg(long, env = "AUGNERF_DATA", value_name = "DIR")]
    data_root: Option<PathBuf>,
    /// Show it again every so many seconds, until all points have ended
    #[arg(long, value_name = "SECONDS", value_parser = clap::value_parser!(u16).range(1..))]
    watch: Option<u16>,
}

impl StatusArguments {
    pub fn run(self) -> Result<()> {
        let folder = SweepFolder::new(&self.folder);
        let points = begun(&folder, self.data_root.as_deref())?;
        let terminal = console::Term::stdout();
        let mut shown = 0;
        loop {
            let (lines, left) = states(&folder, &points)?;
            // On a screen the table stays in its place.
            terminal
                .clear_last_lines(shown)
                .map_err(|e| Error::Output(format!("cannot write to the terminal: {e}")))?;
            lines.iter().for_each(|line| print(line));
            match self.watch {
                Some(seconds) if left > 0 => std::thread::sleep(std::time::Duration::from_secs(seconds.into())),
                _ => return Ok(()),
            }
            shown = if terminal.is_term() { screen_lines(&lines, terminal.size()) } else { 0 };
        }
    }
}

/// Lines that a screen of `(rows, columns)` shows for these, as far as it can still reach them.
fn screen_lines(lines: &[String], (rows, columns): (u16, u16)) -> usize {
    let of_line = |line: &String| line.chars().count().div_ceil(usize::from(columns).max(1)).max(1);
    lines.iter().map(of_line).sum::<usize>().min(usize::from(rows).saturating_sub(1))
}

/// The points' states, and how many have not ended.
fn states(folder: &SweepFolder, points: &[Point]) -> Result<(Vec<String>, usize)> {
    let mut lines = Vec::new();
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for point in points {
        let state = folder.point(&point.id).state(point)?;
        *counts.entry(state.status.name()).or_default() += 1;
        let what = match (state.status, &state.claim) {
            (Status::Running, Some(claim)) => {
                let left = claim.seconds_left.map_or(String::new(), |left| format!(", {} left", duration(left)));
                format!("step {} of {}{left} ({}, process {})", claim.step, claim.steps, claim.host, claim.pid)
            }
            (Status::Done, _) => state.result.metric("psnr").map_or(String::new(), |psnr| format!("PSNR {psnr:.2} dB")),
            _ => state.reason.clone(),
        };
        lines.push(format!("{:8} {} {}  {what}", state.status.name(), point.id, point.label()));
    }
    let counts: Vec<String> = counts.iter().map(|(status, count)| format!("{count} {status}")).collect();
    lines.push(format!("{}: {}", folder.path().display(), counts.join(", ")));
    let left = |point: &&Point| point.no_data.is_none() && !folder.point(&point.id).ended();
    Ok((lines, points.iter().filter(left).count()))
}
