//! `augnerf sweep slurm`.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;
use serde_json::json;

use crate::base::{Error, Result, quoted};
use crate::cli::LpipsWeights;
use crate::cli::answer::Answer;
use crate::cli::progress::Console;
use crate::runtime::{Accelerator, Runtime};
use crate::settings::{Config, Resolved};
use crate::sweep::slurm::Script;
use crate::sweep::{Point, StepSeconds, SweepFolder};

use super::{Changes, Location, begin_folder, say_what_is_missing, trainings};

pub const EXAMPLES: &str = "Examples:
  augnerf sweep slurm sweeps/paper/tab1_llff.toml
  augnerf sweep slurm FILE --device gpu  # for sbatch --gres gpu:1

Prints the path of the script. `sbatch --time 12:00:00 --mem 8G --cpus-per-task 8 SCRIPT` submits it, with any other options. All machines must see the sweep's folder. `squeue` shows the tasks, `scancel` stops them with a \
checkpoint, and `augnerf sweep collect` writes the tables.";

#[derive(Args)]
pub struct SlurmArguments {
    #[command(flatten)]
    location: Location,
    #[command(flatten)]
    changes: Changes,
    /// Run failed points, too
    #[arg(long)]
    retry_failed: bool,
    /// Accept a changed sweep file; keep the old points on disk
    #[arg(long)]
    extend: bool,
    #[command(flatten)]
    weights: LpipsWeights,
    /// Device of a task: cpu, gpu, cuda, cuda-tf32 or metal [default: cpu]
    #[arg(long, value_name = "DEVICE", help_heading = "Hardware")]
    device: Option<String>,
    /// Print errors and the script's path only
    #[arg(long, short, help_heading = "Output")]
    quiet: bool,
    #[command(flatten)]
    answer: Answer,
}

impl SlurmArguments {
    pub fn run(self) -> Result<()> {
        let console = Console::new(self.quiet);
        let definition = self.changes.definition(&self.location)?;
        let (name, path) = (self.location.name()?, absolute(self.location.folder()?.path())?);
        let mut script = Script { name: &name, folder: &path, points: vec![], command: vec![] };
        script.check()?;
        let device = self.device.as_deref().unwrap_or("cpu");
        // Unreadable weights are an error here, not in every task.
        let runtime = match Runtime::accelerator_index(device)? {
            Some(_) => Runtime::with_accelerator(Arc::new(Elsewhere), device.into(), Some(1))?,
            None => Runtime::new("cpu", Some(1))?,
        };
        let trainings = trainings(&definition, &self.weights, &runtime, &console)?;
        let (folder, points) =
            begin_folder(&self.location, &definition, self.extend, (&trainings, &measured_elsewhere), &console)?;
        say_what_is_missing(&definition, &trainings, &console);
        script.points = self.left(&points, &folder)?;
        let of_cpu = points.iter().filter(|point| point.on_cpu && script.points.contains(&point.id.as_str())).count();
        if of_cpu > 0 && !runtime.is_cpu() {
            console.say(&format!(
                "{of_cpu} of these points are of rows with device = \"cpu\": they wait for a GPU like the others, but compute on the CPU; \
                 to keep GPUs free, leave the rows out by remove = true in a file that extends this one"
            ));
        }
        script.command = self.command(&path)?;
        self.write(&script, &folder, points.len(), &console)
    }

    /// Returns the points that have not ended and have a scene here, by name.
    fn left<'a>(&self, points: &'a [Point], folder: &SweepFolder) -> Result<Vec<&'a str>> {
        let mut left = Vec::new();
        for point in points {
            let own = folder.point(&point.id);
            let has_failed = own.failure()?.is_some() && !self.retry_failed;
            if own.result()?.is_none() && !has_failed && point.no_data.is_none() {
                left.push(point.id.as_str());
            }
        }
        Ok(left)
    }

    fn write(&self, script: &Script, folder: &SweepFolder, all: usize, console: &Console) -> Result<()> {
        let (count, shown) = (script.points.len(), quoted(&folder.path().display().to_string()));
        let answer = |path: Option<&Path>| {
            let path = path.map(|path| path.display().to_string());
            json!({ "folder": folder.path().display().to_string(), "points": script.points, "script": path })
        };
        if count == 0 {
            console.say(&format!(
                "no script: of {all} points in {shown}, all have ended (--retry-failed runs failed ones again) or lack their scene \
                 here; write the tables with `augnerf sweep collect {shown}`"
            ));
            return self.answer.give_silently(&answer(None));
        }
        let path = script.write(folder)?;
        console.say(&format!(
            "{count} of {all} points; submit them with `sbatch {}`",
            quoted(&path.display().to_string())
        ));
        console.say(&format!("next: augnerf sweep collect {shown}, when they have ended"));
        self.answer.give_place(&answer(Some(&path)), &path)
    }

    /// Returns the command of a task, without its point.
    fn command(&self, folder: &Path) -> Result<Vec<String>> {
        let program = std::env::current_exe()
            .map_err(|e| Error::Output(format!("path of this program, which the jobs run: {e}")))?;
        let shown = |path: &Path| path.display().to_string();
        let mut command = vec![shown(&program), "sweep".into(), "run-point".into(), shown(folder)];
        if let Some(root) = &self.location.data_root {
            command.extend(["--data-root".into(), shown(&absolute(root)?)]);
        }
        if let Some(weights) = &self.weights.lpips_weights {
            command.extend(["--lpips-weights".into(), shown(&absolute(weights)?)]);
        }
        if let Some(device) = &self.device {
            command.extend(["--device".into(), device.clone()]);
        }
        if self.retry_failed {
            command.push("--retry-failed".into());
        }
        Ok(command)
    }
}

fn absolute(path: &Path) -> Result<PathBuf> {
    std::path::absolute(path).map_err(|e| Error::unreadable(path, &e))
}

/// The GPU of the machines that train.
#[derive(Debug)]
struct Elsewhere;

impl Accelerator for Elsewhere {
    fn description(&self) -> String {
        "GPU of another machine".into()
    }

    fn synchronize(&self) -> Result<()> {
        Ok(())
    }

    fn check(&self, _: &Resolved) -> Result<()> {
        Ok(())
    }
}

/// Returns the error of a budget in seconds.
fn measured_elsewhere(_: &[&Config]) -> Result<StepSeconds> {
    Err(Error::Config(
        "budgets in seconds must be measured on a machine that trains; run `augnerf sweep run FILE --create` there (with `srun`, and \
         the tasks' --device and --threads), then write the script"
            .into(),
    ))
}
