//! `augnerf sweep submit`.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde_json::json;

use crate::base::{Error, Result};
use crate::cli::answer::Answer;
use crate::cli::progress::{Console, print};
use crate::cli::{LpipsWeights, whole};
use crate::runtime::Runtime;
use crate::settings::Config;
use crate::sweep::slurm::{Chosen, Request, Script, Slurm, Submitted, array, check_installed};
use crate::sweep::{Point, StepCosts, SweepFolder, Trainings, check_unchanged};

use super::{Changes, Location, MaxDeaths, begin_folder, planned_points, say_how_long, say_what_is_missing, trainings};

pub const EXAMPLES: &str = "Examples:
  augnerf sweep submit sweeps/checks/smoke.toml --dry-run  # prints the scripts
  augnerf sweep submit sweeps/paper/tab1_llff.toml --time 12:00:00 --mem 8G --cpus 8
  augnerf sweep submit FILE --partition gpu --gres gpu:1 --device gpu --sbatch=--account=lab

Prints the number of the job array. All machines must see the sweep's folder. `augnerf sweep status` shows the queue, and \
`augnerf sweep cancel` empties it.";

/// The schedulers.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Scheduler {
    Slurm,
}

#[derive(Args)]
pub struct SubmitArguments {
    #[command(flatten)]
    location: Location,
    #[command(flatten)]
    changes: Changes,
    /// Scheduler
    #[arg(long, value_enum, default_value = "slurm", help_heading = "Hardware")]
    scheduler: Scheduler,
    /// Partition [default: Slurm's]
    #[arg(long, value_name = "NAME", help_heading = "Hardware")]
    partition: Option<String>,
    /// Time limit of a task: 90 (minutes), 12:00:00 or 2-00:00:00 [default: Slurm's]
    #[arg(long, help_heading = "Hardware")]
    time: Option<String>,
    /// Memory of a task: 8G [default: Slurm's]
    #[arg(long, help_heading = "Hardware")]
    mem: Option<String>,
    /// CPU cores and threads of a task [default: Slurm's, often 1]
    #[arg(
        long,
        value_name = "N",
        value_parser = whole::<u16>(1..=1024),
        help_heading = "Hardware"
    )]
    cpus: Option<u16>,
    /// Generic resources of a task: gpu:1
    #[arg(long, value_name = "LIST", help_heading = "Hardware")]
    gres: Option<String>,
    /// Most tasks that run at once [default: no limit]
    #[arg(long, value_name = "N", value_parser = whole::<u32>(1..=u32::MAX.into()), help_heading = "Hardware")]
    array_limit: Option<u32>,
    /// Further option of sbatch: --sbatch=--account=lab
    #[arg(long, value_name = "OPTION", allow_hyphen_values = true, help_heading = "Hardware")]
    sbatch: Vec<String>,
    /// Print the scripts and submit nothing
    #[arg(long, help_heading = "Output")]
    dry_run: bool,
    /// Submit failed points, too
    #[arg(long)]
    retry_failed: bool,
    /// Accept a changed sweep file; keep the old points on disk
    #[arg(long)]
    extend: bool,
    #[command(flatten)]
    max_deaths: MaxDeaths,
    #[command(flatten)]
    weights: LpipsWeights,
    /// Device of a task: cpu, gpu, cuda, cuda-tf32 or metal [default: cpu]
    #[arg(long, value_name = "DEVICE", help_heading = "Hardware")]
    device: Option<String>,
    /// Print errors and the job's number only
    #[arg(long, short, help_heading = "Output")]
    quiet: bool,
    #[command(flatten)]
    answer: Answer,
}

impl SubmitArguments {
    pub fn run(self) -> Result<()> {
        let Scheduler::Slurm = self.scheduler;
        if !self.dry_run {
            check_installed()?;
        }
        let console = Console::new(self.quiet);
        self.max_deaths.warn(&console);
        let definition = self.changes.definition(&self.location)?;
        let folder = self.location.folder()?;
        let (name, path) = (self.location.name()?, absolute(folder.path())?);
        let script = Script { name: &name, folder: &path, request: self.request() };
        script.check()?;
        self.device.as_deref().map_or(Ok(()), Runtime::check_name)?;
        // Unreadable weights are an error here, not in every task.
        let runtime = Runtime::new("cpu", Some(1))?;
        let trainings = trainings(&definition, &self.weights, &runtime, &console)?;
        let costs: (&Trainings, &dyn StepCosts) = (&trainings, &Elsewhere);
        if self.dry_run {
            if !self.extend {
                check_unchanged(&folder, &definition, self.location.data_root.as_deref())?;
            }
            let points = planned_points(&self.location, &definition, costs, &console, || ())?;
            return self.show(&script, &folder, &points, &console);
        }
        if self.extend {
            let points = planned_points(&self.location, &definition, costs, &console, || ())?;
            check_numbers(&folder, &points)?;
        }
        let (folder, points) = begin_folder(&self.location, &definition, self.extend, costs, &console)?;
        say_what_is_missing(&definition, &trainings, &console);
        if !self.quiet && !self.answer.json {
            say_how_long((&folder, &points), (&definition, &trainings), 1, &console)?;
        }
        self.submit(&script, &folder, &points, &console)
    }

    fn request(&self) -> Request {
        Request {
            partition: self.partition.clone(),
            time: self.time.clone(),
            mem: self.mem.clone(),
            cpus: self.cpus,
            gres: self.gres.clone(),
            at_once: self.array_limit,
            further: self.sbatch.clone(),
        }
    }

    fn submit(&self, script: &Script, folder: &SweepFolder, points: &[Point], console: &Console) -> Result<()> {
        // With the lock, a second submission sees the first.
        let _lock = folder.lock()?;
        let slurm = Slurm::of(folder);
        let chosen = Chosen::among(points, folder, &slurm.queue()?, self.retry_failed)?;
        let shown = folder.path().display();
        if chosen.indices.is_empty() {
            return self.nothing_left(folder, &chosen, points, console);
        }
        let (array, tables) = self.scripts(script, &chosen)?;
        let submitted = slurm.submit(&array, &tables)?;
        console.say(&format!("submitted: {}", counted(&chosen, points)));
        console.say(&format!("job {}; its logs are in {}", submitted.points, slurm.path().join("log").display()));
        if let Some(tables) = &submitted.tables {
            let results = self.location.results()?;
            console.say(&format!("job {tables} writes the tables into {} after them", results.display()));
        }
        console.say(&format!("next: augnerf sweep status {shown}"));
        self.answer.give(&answer(folder, &chosen, Some(&submitted), None), || print(submitted.points.number()))
    }

    fn nothing_left(&self, folder: &SweepFolder, chosen: &Chosen, points: &[Point], console: &Console) -> Result<()> {
        let (shown, left_out) = (folder.path().display(), chosen.left_out());
        let hint = if chosen.failed > 0 { "; --retry-failed submits the failed ones" } else { "" };
        console.say(&format!(
            "nothing to submit: {} points in {shown}, {left_out}{hint}; write their tables with `augnerf sweep collect {shown}`",
            points.len()
        ));
        self.answer.give_silently(&answer(folder, chosen, None, None))
    }

    /// Prints the scripts without submitting them.
    fn show(&self, script: &Script, folder: &SweepFolder, points: &[Point], console: &Console) -> Result<()> {
        let slurm = Slurm::of(folder);
        let chosen = Chosen::among(points, folder, &slurm.queue()?, self.retry_failed)?;
        if chosen.indices.is_empty() {
            return self.nothing_left(folder, &chosen, points, console);
        }
        let (array, tables) = self.scripts(script, &chosen)?;
        let scripts = [("points.sbatch", array), ("tables.sbatch", tables)];
        self.answer.give(&answer(folder, &chosen, None, Some(&scripts)), || {
            for (name, text) in &scripts {
                print(&format!("# ---- {}\n{text}", slurm.path().join(name).display()))?;
            }
            print(&format!("# would be submitted: {}", counted(&chosen, points)))
        })
    }

    /// Returns the scripts of the points and of the tables.
    fn scripts(&self, script: &Script, chosen: &Chosen) -> Result<(String, String)> {
        let program = std::env::current_exe()
            .map_err(|e| Error::Output(format!("path of this program, which the jobs run: {e}")))?;
        let folder = script.folder.display().to_string();
        let program = program.display().to_string();
        let mut point = ["sweep", "run-point", &folder].map(String::from).to_vec();
        let mut tables = ["sweep", "collect", &folder, "--results"].map(String::from).to_vec();
        tables.push(absolute(&self.location.results()?)?.display().to_string());
        if script.folder.file_name().is_some_and(|own| own != script.name) {
            tables.extend(["--name".into(), script.name.into()]);
        }
        if let Some(root) = &self.location.data_root {
            let root = ["--data-root".into(), absolute(root)?.display().to_string()];
            point.extend(root.clone());
            tables.extend(root);
        }
        if let Some(weights) = &self.weights.lpips_weights {
            point.extend(["--lpips-weights".into(), absolute(weights)?.display().to_string()]);
        }
        if let Some(device) = &self.device {
            point.extend(["--device".into(), device.clone()]);
        }
        if self.retry_failed {
            point.push("--retry-failed".into());
        }
        let with_program = |rest: Vec<String>| [vec![program.clone()], rest].concat();
        Ok((script.points(&chosen.indices, &with_program(point)), script.tables(&with_program(tables))))
    }
}

/// Checks that no queued task gets another point: a task knows its point by number only.
fn check_numbers(folder: &SweepFolder, planned: &[Point]) -> Result<()> {
    let queue = Slurm::of(folder).queue()?;
    let before = folder.points(None)?.unwrap_or_default();
    let moved = |index: &usize| before.get(*index).map(|point| &point.id) != planned.get(*index).map(|point| &point.id);
    let moved: Vec<String> =
        queue.tasks.iter().filter_map(|task| task.index).filter(moved).map(|index| index.to_string()).collect();
    if moved.is_empty() {
        return Ok(());
    }
    let shown = folder.path().display();
    Err(Error::Config(format!(
        "--extend: renumbers the points of tasks {}, which are in the queue; wait for them or stop them with `augnerf sweep \
         cancel {shown}`, then submit again",
        moved.join(", ")
    )))
}

/// Returns the submission, or with scripts the planned one, as JSON.
fn answer(
    folder: &SweepFolder,
    chosen: &Chosen,
    submitted: Option<&Submitted>,
    scripts: Option<&[(&str, String)]>,
) -> serde_json::Value {
    let scripts = scripts.map(|all| {
        all.iter().map(|(name, text)| (name.to_string(), text.as_str().into())).collect::<serde_json::Map<_, _>>()
    });
    json!({
        "folder": folder.path().display().to_string(),
        "points": chosen.indices,
        "job": submitted.map(|submitted| submitted.points.number()),
        "tables_job": submitted.and_then(|submitted| submitted.tables.as_ref()).map(|job| job.number()),
        "scripts": scripts,
    })
}

/// Describes the submitted points: `8 of 14 points (6 done): 0-7`.
fn counted(chosen: &Chosen, points: &[Point]) -> String {
    let others = chosen.left_out();
    let others = if others.is_empty() { others } else { format!(" ({others})") };
    format!("{} of {} points{others}: {}", chosen.indices.len(), points.len(), array(&chosen.indices))
}

fn absolute(path: &Path) -> Result<PathBuf> {
    std::path::absolute(path).map_err(|e| Error::unreadable(path, &e))
}

/// Step times on machines that train: they are unknown on this one.
struct Elsewhere;

impl StepCosts for Elsewhere {
    fn seconds_per_step(&self, _: &Config) -> Result<f64> {
        Err(Error::Config(
            "budgets in seconds must be measured on a machine that trains; run `augnerf sweep begin FILE` there (with `srun`, and \
             the tasks' --device and --threads), then submit"
                .into(),
        ))
    }

    fn prepare(&self, configs: &[&Config]) -> Result<()> {
        configs.first().map_or(Ok(()), |config| self.seconds_per_step(config).map(|_| ()))
    }
}
