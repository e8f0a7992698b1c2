//! `augnerf sweep collect`.

use std::path::PathBuf;

use clap::Args;

use crate::base::{Error, Result};
use crate::cli::answer::Answer;
use crate::cli::progress::print;
use crate::report::Record;
use crate::report::tables::{Table, table_terminal};
use crate::sweep::{Sweep, TableOptions, View, check_name};

use super::{RESULTS, RUNS, check_any_data, check_done, collect, name_of, open, read_all, table_json, terminal_width};

pub const EXAMPLES: &str = "Examples:
  augnerf sweep collect runs/tab4_fern  # tables and figures, in results/
  augnerf sweep collect runs/a --merge runs/b --out figures/both

--merge needs --out. Other rows, metrics or another baseline need a sweep file of their own, and their own points: \
`augnerf sweep run FILE --name OTHER`. Rows of committed results cannot be chosen so.
Exit codes: 0 all points are done; else the tables are written, and 7 points failed, 11 points are not done yet, 8 scenes are \
missing, 9 rows are not comparable.";

#[derive(Args)]
#[command(next_help_heading = "Experiment")]
pub struct CollectArguments {
    /// Folder of a sweep: runs/NAME, or that of --out; with --merge also results/NAME
    folder: PathBuf,
    /// Folder of another sweep, whose rows are appended; repeatable
    #[arg(long, value_name = "FOLDER")]
    merge: Vec<PathBuf>,
    /// Mark rows that differ in an uncontrolled setting, such as the revision, instead of stopping
    #[arg(long)]
    force: bool,
    /// Folder of the scenes
    #[arg(long, env = "AUGNERF_DATA", value_name = "DIR")]
    data_root: Option<PathBuf>,
    /// Folder for tables and figures [default: results/NAME of runs/NAME, otherwise FOLDER/results]
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out: Option<PathBuf>,
    /// Name of the sweep in tables [default: the folder's]
    #[arg(long, help_heading = "Output")]
    name: Option<String>,
    /// Add training time and memory to the tables
    #[arg(long, help_heading = "Output")]
    with_timing: bool,
    #[command(flatten)]
    answer: Answer,
}

impl CollectArguments {
    pub fn run(self) -> Result<()> {
        let mut sweep = open(&self.folder, self.data_root.as_deref())?;
        if let Some(name) = &self.name {
            check_name("the sweep's name", name).map_err(Error::Config)?;
            sweep.name.clone_from(name);
        }
        let (table, results, records) = match self.merge.is_empty() {
            true => {
                let Some(runs) = sweep.runs.clone() else {
                    return Err(Error::Config(format!(
                        "{}: a results folder, not points; use it with --merge FOLDER --out DIR, or write its tables again \
                         with `augnerf verify --update`",
                        self.folder.display()
                    )));
                };
                let results = self.results(&sweep.name)?;
                check_any_data(&sweep.outputs.records)?;
                let table = collect((&mut sweep, &runs), &results, self.options())?;
                (table, results, sweep.outputs.records)
            }
            false => self.merged(sweep)?,
        };
        self.answer.give(&table_json(&table, &results), || {
            print(&table_terminal(&table, terminal_width()))?;
            print(&format!("tables: {}", results.display()))
        })?;
        check_done(&records)
    }

    fn options(&self) -> TableOptions {
        TableOptions { force: self.force, with_timing: self.with_timing }
    }

    /// Returns the folder of the complete sweep's tables.
    fn results(&self, name: &str) -> Result<PathBuf> {
        let path = std::path::absolute(&self.folder).map_err(|e| Error::unreadable(&self.folder, &e))?;
        let runs = path.parent().filter(|parent| parent.file_name().is_some_and(|name| name == RUNS));
        Ok(self.out.clone().unwrap_or_else(|| match runs {
            Some(runs) => runs.with_file_name(RESULTS).join(name),
            None => path.join(RESULTS),
        }))
    }

    /// Writes one table of several sweeps, and returns the records of its points.
    fn merged(&self, mut first: Sweep) -> Result<(Table, PathBuf, Vec<Record>)> {
        let Some(results) = self.out.clone() else {
            return Err(Error::Config("--merge needs a folder of its own; name it with --out".into()));
        };
        first.read_outputs()?;
        let mut sweeps = vec![first];
        sweeps.extend(read_all(&self.merge, self.data_root.as_deref())?);
        let view = View::merged(&name_of(&results)?, &sweeps)?;
        Ok((view.write(&results, self.options())?, results, view.records().to_vec()))
    }
}
