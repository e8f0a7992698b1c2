//! `augnerf sweep cancel`.

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use crate::base::Result;
use crate::cli::answer::Answer;
use crate::cli::progress::print;
use crate::sweep::SweepFolder;
use crate::sweep::slurm::{Queue, Slurm, Task};

use super::begun;

pub const EXAMPLES: &str = "Examples:
  augnerf sweep cancel runs/tab1_llff
  augnerf sweep cancel runs/tab1_llff --json

Running points write a checkpoint and stop. `augnerf sweep submit` resumes them.";

#[derive(Args)]
pub struct CancelArguments {
    /// Folder of a sweep: runs/NAME, or that of --out
    folder: PathBuf,
    #[command(flatten)]
    answer: Answer,
}

impl CancelArguments {
    pub fn run(self) -> Result<()> {
        let folder = SweepFolder::new(&self.folder);
        begun(&folder, None)?;
        let queue = Slurm::of(&folder).cancel()?;
        let task = |task: &Task| json!({ "job": task.job, "point": task.index, "state": task.state });
        let cancelled: Vec<_> = queue.tasks.iter().map(task).collect();
        let shown = self.folder.display().to_string();
        self.answer.give(&json!({ "folder": shown, "cancelled": cancelled }), || self.tell(&queue))
    }

    fn tell(&self, queue: &Queue) -> Result<()> {
        if queue.tasks.is_empty() {
            return print(&format!("{}: nothing in the queue", self.folder.display()));
        }
        let mut counts: BTreeMap<String, usize> = BTreeMap::new();
        for task in &queue.tasks {
            let what = if task.index.is_some() { "points" } else { "tables" };
            *counts.entry(format!("{what} of job {} {}", task.job, task.state)).or_default() += 1;
        }
        counts.iter().try_for_each(|(what, count)| print(&format!("cancelled: {count} {what}")))?;
        print("running points write a checkpoint and stop; resume with `augnerf sweep submit` or `augnerf sweep run`")
    }
}
