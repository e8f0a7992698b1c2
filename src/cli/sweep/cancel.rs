//! `augnerf sweep cancel`.

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::Args;

use crate::base::Result;
use crate::cli::progress::print;
use crate::sweep::SweepFolder;
use crate::sweep::slurm::Slurm;

use super::begun;

pub const EXAMPLES: &str = "Example:
  augnerf sweep cancel runs/tab1_llff                      what ran goes on with `augnerf sweep submit`";

#[derive(Args)]
pub struct CancelArguments {
    /// Folder of a sweep: runs/NAME, or what --out named
    folder: PathBuf,
}

impl CancelArguments {
    pub fn run(self) -> Result<()> {
        let folder = SweepFolder::new(&self.folder);
        begun(&folder, None)?;
        let queue = Slurm::of(&folder).cancel()?;
        if queue.tasks.is_empty() {
            return print(&format!("nothing of {} is in the queue", self.folder.display()));
        }
        let mut counts: BTreeMap<String, usize> = BTreeMap::new();
        for task in &queue.tasks {
            let what = if task.index.is_some() { "points" } else { "tables" };
            *counts.entry(format!("{what} of job {} {}", task.job, task.state)).or_default() += 1;
        }
        counts.iter().try_for_each(|(what, count)| print(&format!("cancelled: {count} {what}")))?;
        print("what ran stops with a checkpoint; `augnerf sweep submit` and `augnerf sweep run` go on from there")
    }
}
