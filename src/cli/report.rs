//! `augnerf report`.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::base::files::write_named;
use crate::base::{Error, Result};
use crate::metrics::{PSNR, SSIM};
use crate::report::tables::{Table, table_terminal};
use crate::sweep::verify::Archive;
use crate::sweep::{PAGE, RunsTable, check_page_place};

use super::answer::Answer;
use super::progress::{print, report};
use super::sweep::{table_json, terminal_width};

pub const EXAMPLES: &str = "Examples:
  augnerf report runs/fern-nerf-* runs/fern-aug-nerf-*  # runs side by side, in report.html
  augnerf report A B C --label NeRF --label NeRF --label Aug-NeRF --out figures/fern.html
  augnerf report results/paper/tab4_fern                # a sweep's results, in their folder

Runs that differ in the seed only, or have the same name, are one row. The first row is the baseline. The page needs no \
other file.";

#[derive(Args)]
pub struct ReportArguments {
    /// Run folders, or one folder of a sweep's results
    #[arg(required = true, value_name = "RUN")]
    runs: Vec<PathBuf>,
    /// Name of a run's row, once for each in their order [default: method and differing settings]
    #[arg(long = "label", value_name = "NAME")]
    labels: Vec<String>,
    /// File to write, replaced if it is there [default: report.html, in the results folder if one is named]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Add training time and memory to the page
    #[arg(long)]
    with_timing: bool,
    #[command(flatten)]
    answer: Answer,
}

impl ReportArguments {
    pub fn run(self) -> Result<()> {
        let (table, page, out) = match self.runs.as_slice() {
            [results] if results.join("points.csv").is_file() => {
                if !self.labels.is_empty() || self.with_timing {
                    return Err(Error::Config(format!(
                        "{}: a sweep's results, to which --label and --with-timing do not apply; omit them, or use `augnerf \
                         sweep collect --with-timing`",
                        results.display()
                    )));
                }
                let out = check_page_place(&self.out.clone().unwrap_or_else(|| results.join(PAGE)))?;
                let archive = Archive::read(results, None)?;
                let runs = archive.runs();
                if runs.is_none() && self.out.is_none() && archive.has_collected_page() {
                    return Err(Error::Output(format!(
                        "{}: made with images of the runs, which are not in runs/ here, so that a new page would lack views, videos \
                         and links; open it as it is, or write the smaller page elsewhere with --out FILE",
                        out.display()
                    )));
                }
                if runs.is_none() {
                    report("no runs beside these results: the page has no views, no videos and no links to runs");
                }
                let (table, page) = archive.page(runs.as_ref())?;
                (table, page, out)
            }
            runs => {
                if let Some(results) = runs.iter().find(|run| run.join("points.csv").is_file()) {
                    return Err(Error::Config(format!(
                        "{}: a sweep's results, which have a page of their own; name them alone, or runs alone",
                        results.display()
                    )));
                }
                if let Some(sweep) = runs.iter().find(|run| run.join("sweep.toml").is_file()) {
                    return Err(Error::Config(format!(
                        "{0}: the folder of a sweep, whose page is made of its results; name the folder that `augnerf sweep collect \
                         {0}` prints",
                        sweep.display()
                    )));
                }
                let out = check_page_place(&self.out.clone().unwrap_or_else(|| PAGE.into()))?;
                let rows = RunsTable::read(runs, &self.labels)?;
                if rows.longest_name() > LONG_NAME && self.labels.is_empty() {
                    report("long row names: give your own with --label NAME, once for each run in their order");
                }
                let (table, page) = rows.page(folder_of(&out), self.with_timing)?;
                (table, page, out)
            }
        };
        let folder = folder_of(&out);
        std::fs::create_dir_all(folder).map_err(|e| Error::unwritable(folder, &e))?;
        write_named(&out, page.as_bytes())?;
        self.answer.give(
            &json!({ "page": out.display().to_string(), "rows": table_json(&table, folder)["rows"] }),
            || {
                print(&format!("page: {}", out.display()))?;
                print(&table_terminal(&main_columns(&table), terminal_width()))
            },
        )
    }
}

/// Characters of a row's name beyond which names of one's own are suggested.
const LONG_NAME: usize = 40;

/// Returns the table with the main metrics only, as far as it has any: the page has all.
fn main_columns(table: &Table) -> Table {
    table.with_metrics(&[PSNR.key, SSIM.key, PSNR.gap().key])
}

/// Returns the folder of a file.
fn folder_of(file: &Path) -> &Path {
    file.parent().filter(|parent| *parent != Path::new("")).unwrap_or(Path::new("."))
}
