//! Answers for people, or as JSON for other programs.

use std::path::Path;

use clap::Args;
use serde::Serialize;

use crate::base::Result;
use crate::metrics::MeanMetrics;
use crate::run::Report;

use super::progress::print;

/// In which form a command answers.
#[derive(Args, Clone, Copy)]
pub struct Answer {
    /// Print the answer as one JSON object on standard output, and nothing else there
    #[arg(long)]
    pub json: bool,
}

impl Answer {
    /// Prints `value` where JSON is asked for, and otherwise what `words` prints.
    pub fn give(self, value: &impl Serialize, words: impl FnOnce() -> Result<()>) -> Result<()> {
        if self.json { print(&serde_json::to_string(value).expect("plain data")) } else { words() }
    }

    /// The same of a command that leaves a folder or a file, whose name alone is printed, quiet or not: what scripts go on with.
    pub fn give_place(self, value: &impl Serialize, place: &Path) -> Result<()> {
        self.give(value, || print(&place.display().to_string()))
    }

    /// The same of a command that has nothing for people but what it said on its way.
    pub fn give_silently(self, value: &impl Serialize) -> Result<()> {
        self.give(value, || Ok(()))
    }
}

/// What was measured of a run.
#[derive(Serialize)]
pub struct Measured<'a> {
    run: String,
    step: u64,
    steps: u64,
    split: String,
    views: usize,
    training_views: usize,
    mean: &'a MeanMetrics,
    inactive_levels: Vec<&'static str>,
    metrics: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    seconds: Option<f64>,
}

impl<'a> Measured<'a> {
    /// Of the run in folder `run`, which is to take `steps` steps and whose files are in `metrics`; `seconds` were spent on steps.
    pub fn new(
        (run, metrics): (&Path, &Path),
        report: &'a Report,
        (step, steps): (u64, u64),
        seconds: Option<f64>,
    ) -> Measured<'a> {
        Measured {
            run: run.display().to_string(),
            step,
            steps,
            split: report.protocol.text("split"),
            views: report.views.len(),
            training_views: report.training_views.len(),
            mean: &report.mean,
            inactive_levels: report.inactive_levels(),
            metrics: metrics.display().to_string(),
            seconds,
        }
    }
}
