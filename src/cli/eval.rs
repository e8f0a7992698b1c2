//! `augnerf eval`.

use std::path::{Path, PathBuf};

use clap::Args;

use crate::base::{Error, Result};
use crate::run::{RunDir, Trained, load_lpips};
use crate::runtime::Runtime;

use super::progress::{Console, print};
use super::{Compute, Sources};

#[derive(Args)]
pub struct EvalArguments {
    /// Run folder; its newest checkpoint is measured
    run: PathBuf,
    /// Folder for metrics.json and metrics.csv, which otherwise replace the run's
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    sources: Sources,
    #[command(flatten)]
    compute: Compute,
}

impl EvalArguments {
    pub fn run(self) -> Result<()> {
        let runtime = self.compute.runtime()?;
        runtime.install(|| self.evaluate(&runtime))
    }

    fn evaluate(&self, runtime: &Runtime) -> Result<()> {
        let console = Console::new(self.compute.quiet);
        let trained = Trained::open(&self.run, self.sources.data.as_deref(), runtime, &console)?;
        let folder = self.folder(&trained.run)?;
        let lpips = load_lpips(&self.sources.weights.or(&trained.config), runtime.device())?;
        let report = trained.evaluate_into(folder, &lpips, &console)?;
        print(&serde_json::to_string_pretty(&report.mean).expect("plain data"))?;
        let (step, steps) = (trained.state.step, trained.config.train.steps);
        let [json, _] = RunDir::metrics_in(folder);
        console.say(&format!("step {step} of {steps}: {}", json.display()));
        Ok(())
    }

    /// Where the files go, which can be written to.
    fn folder<'a>(&'a self, run: &'a RunDir) -> Result<&'a Path> {
        let Some(out) = &self.out else {
            if run.is_writable() {
                return Ok(run.path());
            }
            return Err(Error::Output(format!(
                "{} cannot be written: name a folder for metrics.json and metrics.csv with --out",
                run.path().display()
            )));
        };
        std::fs::create_dir_all(out).map_err(|e| Error::unwritable(out, &e))?;
        Ok(out)
    }
}
