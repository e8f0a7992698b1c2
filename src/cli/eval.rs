//! `augnerf eval`.

use std::path::{Path, PathBuf};

use clap::Args;

use crate::base::files::check_own;
use crate::base::{Error, Result};
use crate::run::{OpenOptions, RunDir, Split, Trained, load_lpips};
use crate::runtime::Runtime;

use super::answer::{Answer, Measured};
use super::measure::SmoothnessArguments;
use super::progress::{Console, print};
use super::{Choice, Compute, Sources, choice};

pub const EXAMPLES: &str = "Examples:
  augnerf eval runs/fern-nerf-*                    # the held-out views
  augnerf eval RUN --step 2000 --split train       # another checkpoint, on the training views
  augnerf eval RUN --lpips-weights ~/lpips --json  # with LPIPS, for a script

--smoothness prints l1, total variation and Laplacian of the density of both fields. RUN/smoothness.csv adds the run's protocol.";

#[derive(Args)]
#[command(next_help_heading = "Experiment")]
pub struct EvalArguments {
    /// Run folder
    run: PathBuf,
    /// Checkpoint of this step [default: the newest]
    #[arg(long, value_name = "N")]
    step: Option<u64>,
    /// Views to measure [default: the run's held-out views]
    #[arg(long, value_parser = choice(&SPLITS))]
    split: Option<Split>,
    #[command(flatten)]
    sources: Sources,
    #[command(flatten)]
    smoothness: SmoothnessArguments,
    /// Folder for metrics.json and metrics.csv [default: RUN, replaced; with --step or --split RUN/eval/step_N_SPLIT]
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out: Option<PathBuf>,
    #[command(flatten)]
    answer: Answer,
    #[command(flatten)]
    compute: Compute,
}

const SPLITS: [Choice<Split>; 3] = [
    ("test", "Held-out views", Split::Test),
    ("val", "Validation views: a Blender scene's, or those of data.validation", Split::Val),
    ("train", "Training views", Split::Train),
];

impl EvalArguments {
    pub fn run(self) -> Result<()> {
        if self.smoothness.smoothness {
            return self.smoothness.measure(&self.run, self.sources.data.as_deref(), self.answer, &self.compute);
        }
        self.compute.run(|runtime, console| self.evaluate(runtime, console))
    }

    fn evaluate(&self, runtime: &Runtime, console: &Console) -> Result<()> {
        self.check_out()?;
        let options = OpenOptions { step: self.step, split: self.split, ..OpenOptions::default() };
        let trained = Trained::open_at(&self.run, options, self.sources.data.as_deref(), runtime, console)?;
        let (step, steps) = (trained.state.step, trained.config.train.steps);
        let folder = self.folder(&trained.run, step)?;
        let lpips = load_lpips(&self.sources.weights.or(&trained.config), runtime.device())?;
        let report = trained.evaluate_into(&folder, &lpips, console)?;
        let [json, _] = RunDir::metrics_in(&folder);
        self.answer.give(&Measured::new((&self.run, &json), &report, (step, steps), None), || {
            // A metric that could not be computed is empty.
            report.mean.iter().try_for_each(|(metric, value)| {
                let (text, unit) = value.map_or_else(Default::default, |value| (metric.text(value), metric.unit));
                print(format!("{:24} {text:>10} {unit}", metric.key).trim_end())
            })
        })?;
        console.say(&format!("step {step} of {steps}: {}", json.display()));
        report.no_better_than_one_colour().iter().for_each(|remark| console.say(remark));
        report.check_learned(&self.run)
    }

    /// Checks that `--out` replaces no run's own metrics by others.
    ///
    /// # Errors
    /// [`Error::Output`]: it is another run, or this run with `--step` or `--split`.
    fn check_out(&self) -> Result<()> {
        let Some(out) = self.out.as_deref().filter(|out| RunDir::holds_run(out)) else { return Ok(()) };
        let real = |path: &Path| path.canonicalize().ok();
        let why = if real(out) != real(&self.run) {
            "another run, whose metrics.json would be replaced; name another folder"
        } else if self.step.is_some() || self.split.is_some() {
            "the run itself, whose metrics.json is of its newest checkpoint and its held-out views; name another \
             folder, or omit --out"
        } else {
            return Ok(());
        };
        Err(Error::Output(format!("--out {}: {why}", out.display())))
    }

    /// Returns the folder for the files.
    ///
    /// # Errors
    /// [`Error::Output`]: it cannot be created or written.
    fn folder(&self, run: &RunDir, step: u64) -> Result<PathBuf> {
        let made = |folder: &Path| {
            std::fs::create_dir_all(folder).map_err(|e| Error::unwritable(folder, &e)).map(|()| folder.to_path_buf())
        };
        if let Some(out) = &self.out {
            return made(out);
        }
        if !run.is_writable() {
            return Err(Error::Output(format!(
                "{}: read-only; name a folder for metrics.json and metrics.csv with --out",
                run.path().display()
            )));
        }
        if self.step.is_none() && self.split.is_none() {
            return Ok(run.path().to_path_buf());
        }
        let named = SPLITS.iter().find(|(.., split)| self.split == Some(*split));
        let split = named.map_or(String::new(), |(name, ..)| format!("_{name}"));
        let folder = run.evaluations().join(format!("step_{step:09}{split}"));
        check_own(&folder, true)?;
        made(&folder)
    }
}
