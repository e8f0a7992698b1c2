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
use crate::report::Status;
use crate::runtime::Runtime;
use crate::sweep::{Claim, Options, Point, Runner, SweepFolder};

use super::{begun, trainings};

pub const EXAMPLES: &str = "Examples:
  augnerf sweep begin sweeps/checks/smoke.toml             # once: lays out runs/smoke
  augnerf sweep run-point runs/smoke --index 3      # then on any machine that sees it
  augnerf sweep run-point runs/smoke --id 97ce1e35  # by the name in runs/smoke/points

Exit codes: 0 the point is done, or another runner works on it; 143 stopped with a checkpoint by SIGTERM or SIGUSR1 (130 \
Ctrl-C, 129 a hangup), run it again; 7 it failed; 8 its scene is not here; 2 to 5 wrong usage, data, disk or folder.";

#[derive(Args)]
pub struct RunPointArguments {
    /// Folder of a sweep that was begun: runs/NAME, or what --out named
    folder: PathBuf,
    /// The point by its number in points.json, from 0
    #[arg(long, value_name = "N", required_unless_present = "id", conflicts_with = "id")]
    index: Option<usize>,
    /// The point by its name, or the beginning of its name
    #[arg(long, value_name = "ID")]
    id: Option<String>,
    /// Try the point again if it failed
    #[arg(long)]
    retry_failed: bool,
    /// A point with which so many runners were killed in a row, none at a later checkpoint, counts as failed
    #[arg(long, value_name = "N", default_value_t = 25, value_parser = clap::value_parser!(u32).range(1..))]
    max_deaths: u32,
    /// Folder that the definition's scenes lie in
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
        // What has ended needs neither scene nor device.
        let to_do = own.result()?.is_none() && (self.retry_failed || own.failure()?.is_none());
        if to_do && point.no_data.is_none() {
            let runtime = self.compute.runtime()?;
            runtime.install(|| self.run_one((&folder, point), &runtime, &console, &stop))?;
        }
        self.tell((&folder, point), !to_do, &console)
    }

    /// The point that is meant.
    fn chosen<'a>(&self, points: &'a [Point]) -> Result<&'a Point> {
        let folder = self.folder.display();
        if let Some(index) = self.index {
            return points.get(index).ok_or_else(|| {
                let last = points.len().saturating_sub(1);
                Error::Config(format!("--index {index}: {folder} has {} points, 0 to {last}", points.len()))
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
                "--id '{id}': no point of {folder} has a name that begins so; `augnerf sweep status {folder}` lists them"
            ))),
            _ => {
                Err(Error::Config(format!("--id '{id}': {} points of {folder} begin so; give more of it", found.len())))
            }
        }
    }

    fn run_one(
        &self,
        (folder, point): (&SweepFolder, &Point),
        runtime: &Runtime,
        console: &Console,
        stop: &AtomicUsize,
    ) -> Result<()> {
        let (trainings, _) = trainings(&folder.definition()?, &self.weights, runtime, console)?;
        let options = Options {
            jobs: 1,
            fail_fast: false,
            retry_failed: self.retry_failed,
            most_deaths: self.max_deaths,
            remeasure: Vec::new(),
            leave_to_others: true,
        };
        let points = std::slice::from_ref(point);
        Runner { folder, points, runtime, work: &trainings, options, events: console, stop }.run()
    }

    /// Says what became of the point, perhaps `before` this; an error where it is over and not done.
    fn tell(&self, (folder, point): (&SweepFolder, &Point), before: bool, console: &Console) -> Result<()> {
        let own = folder.point(&point.id);
        let (state, label) = (own.state(point)?, point.label());
        match state.status {
            Status::Done if before => console.say(&format!("{label} was done before")),
            // The runner said so.
            Status::Done => {}
            Status::Failed => {
                return Err(Error::PointsFailed(format!(
                    "{label} failed; --retry-failed tries it again: {}",
                    state.reason
                )));
            }
            Status::NoData => {
                return Err(Error::PointsWithoutData(format!(
                    "{label} has no data here: {}; put the scene below --data-root (AUGNERF_DATA)",
                    state.reason
                )));
            }
            Status::Running | Status::Waiting => {
                let who = Claim::look(own.path()).map_or("another runner".into(), |claim| claim.who());
                console.say(&format!("{label} is left to {who}, which works on it"));
            }
        }
        self.answer.give_silently(&json!({
            "folder": folder.path().display().to_string(),
            "id": point.id,
            "label": label,
            "status": state.status.name(),
            "psnr": state.result.metric("psnr"),
        }))
    }
}
