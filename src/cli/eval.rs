//! `augnerf eval`.

use std::path::PathBuf;

use clap::Args;

use crate::base::Result;
use crate::run::{Trained, load_lpips};
use crate::runtime::Runtime;

use super::progress::{Console, print};
use super::{Compute, Sources};

#[derive(Args)]
pub struct EvalArguments {
    /// Run folder; its newest checkpoint is measured
    run: PathBuf,
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
        let lpips = load_lpips(&self.sources.weights.or(&trained.config), runtime.device())?;
        let report = trained.evaluate(&lpips, &console)?;
        print(&serde_json::to_string_pretty(&report.mean).expect("plain data"));
        let (step, steps) = (trained.state.step, trained.config.train.steps);
        console.say(&format!("step {step} of {steps}: {}", trained.run.metrics_json().display()));
        Ok(())
    }
}
