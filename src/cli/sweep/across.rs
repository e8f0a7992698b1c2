//! `augnerf sweep across`.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use crate::base::Result;
use crate::cli::answer::Answer;
use crate::cli::progress::{print, print_shown};
use crate::metrics::PSNR;
use crate::sweep::AcrossRequest;

use super::opened::Opened;

pub const EXAMPLES: &str = "Examples:
  augnerf sweep across results/fern results/chair --row Aug-NeRF --out results/both
  augnerf sweep across results/fern results/chair --row TV --metric ssim --out results/ssim
  augnerf sweep across results/a results/b --row TV --label a='fern, 8 views' --out results/ab

P values are corrected over the sweeps (Holm), and simultaneous intervals are given.";

#[derive(Args)]
pub struct AcrossArguments {
    /// Folders of sweeps or of their results, one experiment each
    #[arg(required = true)]
    folders: Vec<PathBuf>,
    /// Row to compare
    #[arg(long)]
    row: String,
    /// Baseline, seed by seed
    #[arg(long, value_name = "ROW", default_value = "NeRF")]
    baseline: String,
    /// Metric
    #[arg(long, default_value = PSNR.key)]
    metric: String,
    /// Name of a sweep in the figure and the page
    #[arg(long = "label", value_name = "NAME=TEXT", value_parser = label)]
    labels: Vec<(String, String)>,
    /// Folder for across.toml, across.csv, across.md and the figure across.svg
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Folder of the scenes
    #[arg(long, env = "AUGNERF_DATA", value_name = "DIR")]
    data_root: Option<PathBuf>,
    #[command(flatten)]
    answer: Answer,
}

/// A sweep and what it is called.
fn label(text: &str) -> std::result::Result<(String, String), String> {
    let (name, label) = text.split_once('=').ok_or("give NAME=TEXT, such as fern_few=\"fern, 8 views\"")?;
    Ok((name.into(), label.into()))
}

impl AcrossArguments {
    pub fn run(self) -> Result<()> {
        let open = |path: &PathBuf| Opened::read(path, self.data_root.as_deref());
        let sweeps = self.folders.iter().map(open).collect::<Result<Vec<_>>>()?;
        let sources = sweeps.iter().map(Opened::source).collect::<Result<Vec<_>>>()?;
        let (request, across) = AcrossRequest::new(&self.row, &self.baseline, &self.metric, &sources, &self.labels)?;
        request.write(&across, &self.out)?;
        let answer =
            json!({ "row": request.row, "baseline": request.baseline, "metric": request.metric, "results": self.out });
        self.answer.give(&answer, || {
            print_shown(across.markdown().trim_end())?;
            print(&format!("files: {}", self.out.display()))
        })
    }
}
