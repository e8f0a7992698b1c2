//! `augnerf sweep run-point`.

use std::path::PathBuf;
use std::sync::atomic::AtomicUsize;

use clap::Args;
use serde_json::json;

use crate::base::{Error, Result};
use crate::cli::answer::Answer;
use crate::cli::progress::Console;
use crate::cli::signals::catch_scheduler_signals;
use crate::cli::{Compute, LpipsWeights};
use crate::metrics::PSNR;
use crate::report::Status;
use crate::runtime::Runtime;
use crate::sweep::{Claim, Options, Point, Runner, Sharing, SweepFolder};

use super::{begun, say_what_is_missing, trainings};

pub const EXAMPLES: &str = "Examples:
  augnerf sweep run-point runs/smoke --index 3      # after `augnerf sweep run FILE --create`
  augnerf sweep run-point runs/smoke --id f75d9b8c  # by its name in runs/smoke/points
  augnerf sweep run-point runs/smoke --index 3 --retry-failed

Exit codes: 0 done, or another worker has the point; 129, 130 or 143 stopped with a checkpoint (run it again); 7 failed; 8 no \
scene; 2 to 5 wrong usage, data, disk or folder.";

#[derive(Args)]
#[command(next_help_heading = "Experiment")]
pub struct RunPointArguments {
    /// Folder of a created sweep: runs/NAME, or that of --out
    folder: PathBuf,
    /// Point by its number in points.json, from 0
    #[arg(long, value_name = "N", required_unless_present = "id", conflicts_with = "id")]
    index: Option<usize>,
    /// Point by its name, or the beginning of its name
    #[arg(long, value_name = "ID")]
    id: Option<String>,
    /// Run the point again if it failed
    #[arg(long)]
    retry_failed: bool,
    /// Folder of the scenes
    #[arg(long, env = "AUGNERF_DATA", value_name = "DIR")]
    data_root: Option<PathBuf>,
    #[command(flatten)]
    weights: LpipsWeights,
    #[command(flatten)]
    answer: Answer,
    #[command(flatten)]
    compute: Compute,
}

impl RunPointArguments {
    pub fn run(self) -> Result<()> {
        let stop = catch_scheduler_signals()?;
        let folder = SweepFolder::new(&self.folder);
        let points = begun(&folder, self.data_root.as_deref())?;
        let point = self.chosen(&points)?;
        let console = Console::new(self.compute.quiet);
        let own = folder.point(&point.id);
        // A finished point needs neither scene nor device.
        let to_do = own.result()?.is_none() && (self.retry_failed || own.failure()?.is_none());
        if to_do && point.no_data.is_none() {
            self.compute.run(|runtime, console| self.run_one((&folder, point), runtime, console, &stop))?;
        }
        self.tell((&folder, point), !to_do, &console)
    }

    /// Returns the named point.
    fn chosen<'a>(&self, points: &'a [Point]) -> Result<&'a Point> {
        let folder = self.folder.display();
        if let Some(index) = self.index {
            return points.get(index).ok_or_else(|| {
                let last = points.len().saturating_sub(1);
                Error::Config(format!(
                    "--index {index}: out of range; {folder} has {} points, choose 0 to {last}",
                    points.len()
                ))
            });
        }
        let id = self.id.as_deref().unwrap_or_default();
        if let Some(point) = points.iter().find(|point| point.id == id) {
            return Ok(point);
        }
        let found: Vec<&Point> = points.iter().filter(|point| !id.is_empty() && point.id.starts_with(id)).collect();
        match found.as_slice() {
            [point] => Ok(point),
            [] => Err(Error::Config(format!(
                "--id '{id}': no such point in {folder}; `augnerf sweep status {folder}` lists all"
            ))),
            _ => Err(Error::Config(format!(
                "--id '{id}': {} points of {folder} begin so; give more letters",
                found.len()
            ))),
        }
    }

    fn run_one(
        &self,
        (folder, point): (&SweepFolder, &Point),
        runtime: &Runtime,
        console: &Console,
        stop: &AtomicUsize,
    ) -> Result<()> {
        let definition = folder.definition()?;
        let trainings = trainings(&definition, &self.weights, runtime, console)?;
        say_what_is_missing(&definition, &trainings, console);
        let options = Options {
            jobs: 1,
            fail_fast: false,
            retry_failed: self.retry_failed,
            remeasure: Vec::new(),
            sharing: Sharing::Scheduler,
        };
        let points = std::slice::from_ref(point);
        Runner { folder, points, runtime, work: &trainings, options, events: console, stop }.run().map(|_| ())
    }

    /// Prints the state of the point; `before` says that it had ended before this command.
    ///
    /// # Errors
    /// The point failed, or has no data.
    fn tell(&self, (folder, point): (&SweepFolder, &Point), before: bool, console: &Console) -> Result<()> {
        let own = folder.point(&point.id);
        let (record, label) = (own.record(point)?, point.label());
        match record.status {
            Status::Done if before => console.say(&format!("{label} was already done")),
            // The runner has printed it.
            Status::Done => {}
            Status::Failed => {
                return Err(Error::PointsFailed(format!(
                    "{label} failed; run it again with --retry-failed: {}",
                    record.reason
                )));
            }
            Status::NoData => {
                return Err(Error::PointsWithoutData(format!(
                    "{label} has no data here: {}; put the scene into --data-root (AUGNERF_DATA)",
                    record.reason
                )));
            }
            Status::Running | Status::Waiting => {
                let who = Claim::look(own.path()).map_or("another worker".into(), |claim| claim.who());
                console.say(&format!("{label} is skipped: {who} works on it"));
            }
        }
        self.answer.give_silently(&json!({
            "folder": folder.path().display().to_string(),
            "id": point.id,
            "label": label,
            "status": record.status.name(),
            "psnr": record.metric(PSNR.key),
        }))
    }
}
