//! `augnerf sweep across`.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use crate::base::Result;
use crate::cli::answer::Answer;
use crate::cli::progress::{print, print_shown};
use crate::sweep::AcrossRequest;

use super::opened::Opened;

pub const EXAMPLES: &str = "Examples:
  augnerf sweep across results/fern results/chair --row Aug-NeRF --baseline NeRF --out results/both

One question to several sweeps: p values are corrected over the sweeps (Holm), and intervals are given that hold for all of them \
at once. `augnerf verify` makes the files again from the sweeps' folders beside them.";

#[derive(Args)]
pub struct AcrossArguments {
    /// Folders of sweeps or of their results, a block each
    #[arg(required = true)]
    folders: Vec<PathBuf>,
    /// The row that is compared in each
    #[arg(long)]
    row: String,
    /// What it is compared with, seed by seed
    #[arg(long, value_name = "ROW", default_value = "NeRF")]
    baseline: String,
    /// In which metric
    #[arg(long, default_value = "psnr")]
    metric: String,
    /// Folder for across.toml, across.csv, across.md and the figure across.svg
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Folder that the definitions' scenes lie in
    #[arg(long, env = "AUGNERF_DATA", value_name = "DIR")]
    data_root: Option<PathBuf>,
    #[command(flatten)]
    answer: Answer,
}

impl AcrossArguments {
    pub fn run(self) -> Result<()> {
        let open = |path: &PathBuf| Opened::read(path, self.data_root.as_deref());
        let sweeps = self.folders.iter().map(open).collect::<Result<Vec<_>>>()?;
        let sources = sweeps.iter().map(Opened::source).collect::<Result<Vec<_>>>()?;
        let (request, across) = AcrossRequest::new(&self.row, &self.baseline, &self.metric, &sources)?;
        request.write(&across, &self.out)?;
        let answer =
            json!({ "row": request.row, "baseline": request.baseline, "metric": request.metric, "results": self.out });
        self.answer.give(&answer, || {
            print_shown(across.markdown().trim_end())?;
            print(&format!("files: {}", self.out.display()))
        })
    }
}
