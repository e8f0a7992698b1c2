//! `augnerf verify`.

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use serde_json::json;

use crate::base::{Error, Result};
use crate::run::load_lpips;
use crate::runtime::Runtime;
use crate::sweep::Trainings;
use crate::sweep::verify::{Finding, Findings, Outcome, Verifier};

use super::answer::Answer;
use super::progress::{Console, print};
use super::signals::catch_signals;
use super::{Compute, LpipsWeights};

pub const EXAMPLES: &str = "Examples:
  augnerf verify                                  # all of results/
  augnerf verify results/checks/smoke --retrain 2  # and trains two points again
  augnerf verify results/paper --update            # writes a group's tables and kept figures again

Exit codes: 0 all of it holds, 10 something does not. What cannot be checked is listed with the reason.";

#[derive(Args)]
pub struct VerifyArguments {
    /// Results folders, or folders of them
    #[arg(default_value = "results")]
    results: Vec<PathBuf>,
    /// Write tables, and figures that are kept, again from points.csv where they differ
    #[arg(long)]
    update: bool,
    /// With --update: write figures and other files that are not kept, too
    #[arg(long, requires = "update")]
    all: bool,
    /// Train N points again, drawn at random, and compare every digit [default: 0]
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true)]
    retrain: usize,
    /// With --retrain: draw other points than with another seed
    #[arg(long, requires = "retrain", value_name = "SEED", default_value_t = 0)]
    retrain_seed: u64,
    /// With --retrain: accept another revision than that of the points
    #[arg(long, requires = "retrain")]
    any_revision: bool,
    /// Folder of the scenes
    #[arg(long, env = "AUGNERF_DATA", value_name = "DIR", help_heading = "Experiment")]
    data_root: Option<PathBuf>,
    #[command(flatten)]
    weights: LpipsWeights,
    #[command(flatten)]
    answer: Answer,
    #[command(flatten)]
    compute: Compute,
}

/// A folder and its findings.
#[derive(Serialize)]
struct Verified {
    folder: String,
    findings: Vec<Finding>,
}

impl VerifyArguments {
    pub fn run(self) -> Result<()> {
        self.compute.run(|runtime, console| self.verify(runtime, console))
    }

    fn verify(&self, runtime: &Runtime, console: &Console) -> Result<()> {
        let weights =
            self.weights.lpips_weights.as_ref().map_or(String::new(), |dir| dir.to_string_lossy().into_owned());
        let lpips = load_lpips(&weights, runtime.device())?;
        let trainings = Trainings::new(runtime.clone(), (lpips, weights), true, console);
        let stop = catch_signals()?;
        let verifier = Verifier {
            data_root: self.data_root.as_deref(),
            trainings: &trainings,
            runtime,
            update: self.update,
            all: self.all,
            retrain: self.retrain,
            retrain_seed: self.retrain_seed,
            any_revision: self.any_revision,
            stop: &stop,
        };
        let (mut wrong, mut verified) = (Vec::new(), Vec::new());
        let mut show = |path: &Path, findings: &Findings| {
            let folder = path.display().to_string();
            if findings.count(Outcome::Wrong) > 0 {
                wrong.push(folder.clone());
            }
            if self.answer.json {
                verified.push(Verified { folder, findings: findings.lines.clone() });
                return Ok(());
            }
            print(&folder)?;
            findings.lines.iter().try_for_each(|line| print(&format!("  {:11}  {}", line.outcome.name(), line.text)))
        };
        for path in &self.results {
            verifier.verify(path, &mut show)?;
        }
        self.answer.give_silently(&json!({ "holds": wrong.is_empty(), "folders": verified }))?;
        if wrong.is_empty() {
            return Ok(());
        }
        Err(Error::Mismatch(format!("{}: does not verify; see the lines marked WRONG above", wrong.join(", "))))
    }
}
