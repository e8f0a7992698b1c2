//! Answers for people, or as JSON for other programs.

use std::path::Path;

use clap::Args;
use serde::Serialize;

use crate::base::Result;
use crate::metrics::MeanMetrics;
use crate::run::Report;

use super::progress::print;

/// The flag for the form of a command's answer.
#[derive(Args, Clone, Copy)]
#[command(next_help_heading = "Output")]
pub struct Answer {
    /// Print the result as one JSON object
    #[arg(long)]
    pub json: bool,
}

impl Answer {
    /// Prints `value` with `--json`, and otherwise what `words` prints.
    pub fn give(self, value: &impl Serialize, words: impl FnOnce() -> Result<()>) -> Result<()> {
        if self.json { print(&serde_json::to_string(value).expect("plain data")) } else { words() }
    }

    /// Prints `value` with `--json`, and otherwise the folder or file that the command wrote, for scripts.
    pub fn give_place(self, value: &impl Serialize, place: &Path) -> Result<()> {
        self.give(value, || print(&place.display().to_string()))
    }

    /// Prints `value` with `--json`, and otherwise nothing.
    pub fn give_silently(self, value: &impl Serialize) -> Result<()> {
        self.give(value, || Ok(()))
    }
}

/// The measurements of a run.
#[derive(Serialize)]
pub struct Measured<'a> {
    run: String,
    step: u64,
    steps: u64,
    split: String,
    views: usize,
    training_views: usize,
    mean: &'a MeanMetrics,
    inactive_levels: Vec<&'a str>,
    metrics: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    seconds: Option<f64>,
}

impl<'a> Measured<'a> {
    /// Describes the run in folder `run` at step `step` of `steps`, whose metrics file is `metrics`; its steps took `seconds`.
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
