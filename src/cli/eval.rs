//! `augnerf eval`.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use crate::base::{Error, Result};
use crate::run::{OpenOptions, RunDir, Split, Trained, load_lpips};
use crate::runtime::Runtime;

use super::answer::{Answer, Measured};
use super::progress::{Console, print};
use super::{Compute, Sources};

pub const EXAMPLES: &str = "Examples:
  augnerf eval runs/fern-nerf-*                    # the held-out views, with this program
  augnerf eval RUN --step 2000 --split train       # another checkpoint, on the trained views
  augnerf eval RUN --lpips-weights ~/lpips --json  # with LPIPS, for a script

Evaluations of another checkpoint or split go to RUN/eval and leave the run's own metrics as they are.";

#[derive(Args)]
pub struct EvalArguments {
    /// Run folder; its newest checkpoint is measured
    run: PathBuf,
    /// Measure the checkpoint of this step
    #[arg(long, value_name = "N")]
    step: Option<u64>,
    /// Measure these views [default: those that the run holds out]
    #[arg(long, value_enum)]
    split: Option<SplitName>,
    /// Folder for metrics.json and metrics.csv, which otherwise replace the run's, or with --step or --split go to
    /// RUN/eval/step_N_SPLIT
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    sources: Sources,
    #[command(flatten)]
    compute: Compute,
    #[command(flatten)]
    answer: Answer,
}

#[derive(Clone, Copy, ValueEnum)]
enum SplitName {
    /// Held out
    Test,
    /// Kept for choices: a Blender scene's validation views, or what data.validation keeps
    Val,
    /// Trained on
    Train,
}

impl EvalArguments {
    pub fn run(self) -> Result<()> {
        let runtime = self.compute.runtime()?;
        runtime.install(|| self.evaluate(&runtime))
    }

    fn evaluate(&self, runtime: &Runtime) -> Result<()> {
        let console = Console::new(self.compute.quiet);
        let split = self.split.map(|name| match name {
            SplitName::Test => Split::Test,
            SplitName::Val => Split::Val,
            SplitName::Train => Split::Train,
        });
        let options = OpenOptions { step: self.step, split };
        let trained = Trained::open_at(&self.run, options, self.sources.data.as_deref(), runtime, &console)?;
        let (step, steps) = (trained.state.step, trained.config.train.steps);
        let folder = self.folder(&trained.run, step)?;
        let lpips = load_lpips(&self.sources.weights.or(&trained.config), runtime.device())?;
        let report = trained.evaluate_into(&folder, &lpips, &console)?;
        let [json, _] = RunDir::metrics_in(&folder);
        self.answer.give(&Measured::new((&self.run, &json), &report, (step, steps), None), || {
            print(&serde_json::to_string_pretty(&report.mean).expect("plain data"))
        })?;
        console.say(&format!("step {step} of {steps}: {}", json.display()));
        Ok(())
    }

    /// Where the files go, which can be written to.
    fn folder(&self, run: &RunDir, step: u64) -> Result<PathBuf> {
        let made = |folder: &Path| {
            std::fs::create_dir_all(folder).map_err(|e| Error::unwritable(folder, &e)).map(|()| folder.to_path_buf())
        };
        if let Some(out) = &self.out {
            return made(out);
        }
        if !run.is_writable() {
            return Err(Error::Output(format!(
                "{} cannot be written: name a folder for metrics.json and metrics.csv with --out",
                run.path().display()
            )));
        }
        if self.step.is_none() && self.split.is_none() {
            return Ok(run.path().to_path_buf());
        }
        let split = self.split.and_then(|split| split.to_possible_value());
        let split = split.map_or(String::new(), |split| format!("_{}", split.get_name()));
        made(&run.evaluations().join(format!("step_{step:09}{split}")))
    }
}
