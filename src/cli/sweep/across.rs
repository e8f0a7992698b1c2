//! `augnerf sweep across`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde_json::json;

use crate::base::{Error, Result};
use crate::cli::answer::Answer;
use crate::cli::progress::{print, print_shown};
use crate::metrics::PSNR;
use crate::sweep::ComparisonRequest;

use super::read_all;

pub const EXAMPLES: &str = "Examples:
  augnerf sweep across results/fern results/chair --row Aug-NeRF --out results/both
  augnerf sweep across results/fern results/chair --row TV --metric ssim --out results/ssim
  augnerf sweep across results/many_scenes --unit scene --out results/over_scenes

By sweep, p values are corrected over the sweeps (Holm). By scene, rows are compared over all scenes: intervals, Holm's p, \
sign test, prediction of a new scene.";

#[derive(Args)]
#[command(next_help_heading = "Experiment")]
pub struct AcrossArguments {
    /// Folders of sweeps or of their results
    #[arg(required = true)]
    folders: Vec<PathBuf>,
    /// What counts as one observation
    #[arg(long, value_enum, default_value_t = Unit::Sweep)]
    unit: Unit,
    /// Row to compare in each sweep
    #[arg(long, conflicts_with_all = ["rows", "scenes", "seeds"])]
    row: Option<String>,
    /// Rows to compare over scenes [default: all]
    #[arg(long, value_name = "ROW,...")]
    rows: Vec<String>,
    /// Scenes to compare over [default: all]
    #[arg(long, value_name = "SCENE,...", value_delimiter = ',')]
    scenes: Vec<String>,
    /// Seeds to compare over scenes [default: all]
    #[arg(long, value_name = "SEED,...", value_delimiter = ',')]
    seeds: Vec<u64>,
    /// Baseline, seed by seed
    #[arg(long, value_name = "ROW", default_value = "NeRF")]
    baseline: String,
    /// Metric
    #[arg(long, default_value = PSNR.key)]
    metric: String,
    /// Name of a sweep in the figure and the page, by sweep
    #[arg(long = "label", conflicts_with_all = ["rows", "scenes", "seeds"], value_name = "NAME=TEXT", value_parser = label)]
    labels: Vec<(String, String)>,
    /// Folder for the tables, a page and a figure: across.* or over_scenes.*
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out: PathBuf,
    /// Folder of the scenes
    #[arg(long, env = "AUGNERF_DATA", value_name = "DIR")]
    data_root: Option<PathBuf>,
    #[command(flatten)]
    answer: Answer,
}

/// What a comparison counts as one observation.
#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Unit {
    /// One row in each sweep: seeds are the observations of each
    Sweep,
    /// All rows over the sweeps' scenes: a scene's mean over seeds is one observation
    Scene,
}

/// A sweep and what it is called.
fn label(text: &str) -> std::result::Result<(String, String), String> {
    let (name, label) = text.split_once('=').ok_or("give NAME=TEXT, such as fern_few=\"fern, 8 views\"")?;
    Ok((name.into(), label.into()))
}

impl AcrossArguments {
    pub fn run(self) -> Result<()> {
        let sweeps = read_all(&self.folders, self.data_root.as_deref())?;
        let asked = self.asked()?;
        let (request, comparisons) = asked.answer(&sweeps, &self.labels)?;
        request.write(&comparisons, &self.out)?;
        let page = request.page(&comparisons);
        let mut answer = json!({ "baseline": request.baseline, "metric": request.metric, "results": self.out });
        if let Some(row) = &request.row {
            answer["row"] = json!(row);
        } else {
            answer["rows"] = comparisons.lines.iter().map(|line| line.name.as_str()).collect();
            answer["scenes"] = json!(comparisons.scenes);
        }
        self.answer.give(&answer, || {
            print_shown(page.trim_end())?;
            print(&format!("files: {}", self.out.display()))
        })
    }

    fn asked(&self) -> Result<ComparisonRequest> {
        let by_scene = self.unit == Unit::Scene;
        if by_scene && self.row.is_some() {
            return Err(Error::Config("--row is for --unit sweep; over scenes, --rows names rows".into()));
        }
        if !by_scene && self.row.is_none() {
            return Err(Error::Config(
                "--row names the row to compare in each sweep; --unit scene compares rows over their scenes".into(),
            ));
        }
        if by_scene && !self.labels.is_empty() {
            return Err(Error::Config("--label is for --unit sweep; over scenes, no file shows it".into()));
        }
        Ok(ComparisonRequest {
            row: self.row.clone(),
            baseline: self.baseline.clone(),
            metric: self.metric.clone(),
            rows: self.rows.clone(),
            scenes: self.scenes.clone(),
            seeds: self.seeds.clone(),
            sweep: Vec::new(),
        })
    }
}
