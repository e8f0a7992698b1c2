//! `augnerf sweep run`.

use clap::Args;
use serde_json::json;

use crate::base::{Error, Result};
use crate::cli::answer::Answer;
use crate::cli::progress::{Console, print, report};
use crate::cli::signals::catch_signals;
use crate::cli::train::PAPER_STEPS;
use crate::cli::{Compute, LpipsWeights, whole};
use crate::report::Status;
use crate::report::tables::table_terminal;
use crate::runtime::Runtime;
use crate::settings::Config;
use crate::sweep::{Options, Runner, Sharing, Sweep, TableOptions, Trainings, Unmeasured};

use super::{
    Changes, Location, begin_folder, by_weights, check_any_data, check_done, collect, reasons, say_what_is_missing,
    table_json, terminal_width, trainings,
};

pub const EXAMPLES: &str = "Examples:
  augnerf sweep run sweeps/checks/smoke.toml                    # the built-in scene, three minutes
  AUGNERF_DATA=~/data augnerf sweep run sweeps/paper/tab1_llff.toml --jobs 2
  augnerf sweep run sweeps/paper/tab1_llff.toml --retry-failed  # again, with the failed points

The same command resumes a stopped sweep. Several commands on one folder share its points.
Exit codes: 0 done, 7 points failed, 8 scenes are missing, 9 rows are not comparable (see --force), 11 points are not \
done yet (another worker has them), 129, 130 or 143 stopped (run it \
again), 2 the sweep file is wrong.";

#[derive(Args)]
pub struct RunArguments {
    #[command(flatten)]
    location: Location,
    #[command(flatten)]
    changes: Changes,
    /// Points that run at once and share the threads
    #[arg(
        long,
        value_name = "N",
        default_value_t = 1,
        value_parser = whole::<u16>(1..=1024),
        help_heading = "Hardware"
    )]
    jobs: u16,
    /// Stop at the first point that fails
    #[arg(long)]
    fail_fast: bool,
    /// Run failed points again
    #[arg(long)]
    retry_failed: bool,
    /// Accept a changed sweep file; keep the old points on disk
    #[arg(long)]
    extend: bool,
    /// Create the folder and run nothing; run-point then runs its points
    #[arg(long, conflicts_with_all = ["fail_fast", "retry_failed", "remeasure", "force"])]
    create: bool,
    /// Measure missing metrics of finished points, such as LPIPS
    #[arg(long)]
    remeasure: bool,
    /// Mark rows that differ in an uncontrolled setting, such as the revision, instead of stopping
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    weights: LpipsWeights,
    #[command(flatten)]
    answer: Answer,
    #[command(flatten)]
    compute: Compute,
}

impl RunArguments {
    pub fn run(self) -> Result<()> {
        self.compute.run(|runtime, console| match self.create {
            true => self.create(runtime, console),
            false => self.run_points(runtime),
        })
    }

    /// Creates the folder alone.
    fn create(&self, runtime: &Runtime, console: &Console) -> Result<()> {
        let definition = self.changes.definition(&self.location)?;
        let trainings = Trainings::new(runtime.clone(), (Vec::new(), String::new()), false, console);
        let measure = |configs: &[&Config]| trainings.step_seconds(configs);
        let (folder, points) = begin_folder(&self.location, &definition, self.extend, (&trainings, &measure), console)?;
        let (folder, last) = (folder.path().display().to_string(), points.len().saturating_sub(1));
        self.answer.give(&json!({ "folder": folder, "points": points.len() }), || {
            print(&format!(
                "{folder}: {} points, --index 0 to {last} of `augnerf sweep run-point {folder} --index N`",
                points.len()
            ))
        })
    }

    fn run_points(&self, runtime: &Runtime) -> Result<()> {
        let quiet = self.compute.quiet;
        let console = if self.jobs == 1 { Console::new(quiet) } else { Console::without_bars(quiet) };
        let definition = self.changes.definition(&self.location)?;
        let trainings = trainings(&definition, &self.weights, runtime, &console)?;
        let (name, results) = (self.location.name()?, self.location.results()?);
        let measure = |configs: &[&Config]| trainings.step_seconds(configs);
        let (folder, points) =
            begin_folder(&self.location, &definition, self.extend, (&trainings, &measure), &console)?;
        let records = folder.records(&definition, &points)?;
        check_any_data(&records)?;
        let is_open = records.iter().any(|record| record.status != Status::Done);
        if self.remeasure || is_open {
            say_what_is_missing(&definition, &trainings, &console);
        }
        let is_long = points.iter().any(|point| point.config.train.steps >= PAPER_STEPS);
        if is_open && is_long && !definition.is_preset_changed() {
            console
                .say("no --preset is named: points of 100,000 steps take days on a CPU; --preset fast takes minutes");
        }
        let options = Options {
            jobs: usize::from(self.jobs),
            fail_fast: self.fail_fast,
            retry_failed: self.retry_failed,
            remeasure: if self.remeasure { by_weights(&definition, &trainings).0 } else { Vec::new() },
            sharing: Sharing::Locks,
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
        // A stopped sweep writes the table of its finished points, too.
        let mut sweep = Sweep::of_folder(name, folder.clone(), definition, points)?;
        let options = TableOptions { force: self.force, with_timing: false };
        let table = collect((&mut sweep, &folder), &results, options);
        let unmeasured = ran?;
        if let Ok(table) = &table {
            self.answer.give(&table_json(table, &results), || match quiet {
                true => print(&results.display().to_string()),
                false => print(&table_terminal(table, terminal_width())),
            })?;
        }
        console.say(&format!("tables: {}", results.display()));
        // An error of points comes before an error of the table.
        let done = check_done(&sweep.outputs.records);
        if let Err(error) = check_remeasured(&unmeasured, sweep.points.len()) {
            // Its code comes before those of points that wait or have no data.
            done.err().iter().for_each(|done| report(&done.to_string()));
            return Err(error);
        }
        done?;
        table.map(|_| ())
    }
}

/// Checks that all finished points that were measured again are measured.
///
/// # Errors
/// [`Error::PointsFailed`], with the reasons.
fn check_remeasured(unmeasured: &[Unmeasured], all: usize) -> Result<()> {
    if unmeasured.is_empty() {
        return Ok(());
    }
    let failed = unmeasured
        .iter()
        .map(|Unmeasured { label, failure }| (failure.reason.lines().next().unwrap_or_default(), label.clone()));
    Err(Error::PointsFailed(format!(
        "{} of {all} points could not be measured again and keep their results; try them again with --remeasure:{}",
        unmeasured.len(),
        reasons(failed)
    )))
}
