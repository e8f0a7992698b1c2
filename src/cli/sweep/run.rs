//! `augnerf sweep run`.

use std::process::Command;

use clap::Args;

use crate::base::{Error, Result};
use crate::cli::answer::Answer;
use crate::cli::progress::{Console, print, report};
use crate::cli::signals::catch_signals;
use crate::cli::{Compute, LpipsWeights, whole};
use crate::draw::SVG_ALONE;
use crate::report::Status;
use crate::report::tables::table_terminal;
use crate::runtime::{Runtime, with_own_variables};
use crate::sweep::{Options, Runner, Sharing, Unmeasured};

use super::{
    Changes, How, Location, PointState, begin_folder, by_weights, check_any_data, check_done, collect, reasons,
    say_how_long, say_what_is_missing, states_of, table_json, terminal_width, trainings,
};

pub const EXAMPLES: &str = "Examples:
  augnerf sweep run sweeps/checks/smoke.toml                    # the built-in scene, three minutes
  AUGNERF_DATA=~/data augnerf sweep run sweeps/paper/tab1_llff.toml --jobs 2
  augnerf sweep run sweeps/paper/tab1_llff.toml --retry-failed  # again, with the failed points

--then 'echo $AUGNERF_EXIT_CODE > ended' runs a command at the end. The same command resumes a stopped sweep. Several commands on one folder share its points.
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
    /// Continue after a point failed [default]
    #[arg(long, conflicts_with = "fail_fast")]
    keep_going: bool,
    /// Stop at the first point that fails
    #[arg(long)]
    fail_fast: bool,
    /// Run failed points again
    #[arg(long)]
    retry_failed: bool,
    /// Accept a changed sweep file; keep the old points on disk
    #[arg(long)]
    extend: bool,
    /// At the end, run this command in a shell, with the exit code in AUGNERF_EXIT_CODE
    #[arg(long, value_name = "CMD")]
    then: Option<String>,
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
        let ran = self.compute.run(|runtime, _| self.run_points(runtime));
        match &self.then {
            Some(command) => then(command, ran),
            None => ran,
        }
    }

    fn run_points(&self, runtime: &Runtime) -> Result<()> {
        let quiet = self.compute.quiet;
        let console = if self.jobs == 1 { Console::new(quiet) } else { Console::without_bars(quiet) };
        let definition = self.changes.definition(&self.location)?;
        let trainings = trainings(&definition, &self.weights, runtime, &console)?;
        let (name, results) = (self.location.name()?, self.location.results()?);
        let (folder, points) =
            begin_folder(&self.location, &definition, self.extend, (&trainings, &trainings), &console)?;
        let states = states_of(&folder, &points)?;
        check_any_data(&states)?;
        if self.remeasure || states.iter().any(|state| state.status != Status::Done) {
            say_what_is_missing(&definition, &trainings, &console);
        }
        let options = Options {
            jobs: usize::from(self.jobs),
            fail_fast: self.fail_fast,
            retry_failed: self.retry_failed,
            remeasure: if self.remeasure { by_weights(&definition, &trainings).0 } else { Vec::new() },
            sharing: Sharing::Locks,
        };
        if !quiet && !self.answer.json {
            say_how_long((&folder, &points), (&definition, &trainings), self.jobs, &console)?;
        }
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
        let how = How { force: self.force, with_timing: false };
        let table = collect((&folder, &definition, &points), &name, &results, how);
        let unmeasured = ran?;
        if let Ok(table) = &table {
            self.answer.give(&table_json(table, &results), || match quiet {
                true => print(&results.display().to_string()),
                false => print(&table_terminal(table, terminal_width())),
            })?;
        }
        console.say(&format!("tables: {}", results.display()));
        SVG_ALONE.into_iter().for_each(|note| console.say(note));
        // An error of points comes before an error of the table.
        let done = check_done(&states_of(&folder, &points)?);
        if let Err(error) = check_remeasured(unmeasured, points.len()) {
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
fn check_remeasured(unmeasured: Vec<Unmeasured>, all: usize) -> Result<()> {
    let state = |Unmeasured { label, failure }| PointState {
        label,
        status: Status::Failed,
        scene: String::new(),
        reason: failure.reason.lines().next().unwrap_or_default().into(),
    };
    let states: Vec<PointState> = unmeasured.into_iter().map(state).collect();
    if states.is_empty() {
        return Ok(());
    }
    Err(Error::PointsFailed(format!(
        "{} of {all} points could not be measured again and keep their results; try them again with --remeasure:{}",
        states.len(),
        reasons(&states)
    )))
}

/// The exit code for the command of `--then`.
const EXIT_CODE: &str = "AUGNERF_EXIT_CODE";

/// Runs a command after the sweep, and returns how the sweep ended. The command prints to standard error, so that a script
/// reads the sweep's answer alone.
///
/// # Errors
/// That of the sweep; [`Error::Output`] if the sweep is done and the command is not.
fn then(command: &str, ran: Result<()>) -> Result<()> {
    let code = ran.as_ref().map_or_else(|error| error.exit_code(), |()| 0);
    let (shell, flag) = if cfg!(windows) { ("cmd", "/C") } else { ("sh", "-c") };
    let mut shell = Command::new(shell);
    with_own_variables(&mut shell);
    let ended = shell.args([flag, command]).env(EXIT_CODE, code.to_string()).stdout(std::io::stderr()).status();
    let failed = match ended {
        Ok(status) if status.success() => None,
        Ok(status) => Some(format!("--then: '{command}' ended with {status}")),
        Err(error) => Some(format!("--then: cannot run '{command}': {error}")),
    };
    match (ran, failed) {
        (Err(error), failed) => {
            failed.iter().for_each(|failed| report(failed));
            Err(error)
        }
        (Ok(()), Some(failed)) => Err(Error::Output(failed)),
        (Ok(()), None) => Ok(()),
    }
}
