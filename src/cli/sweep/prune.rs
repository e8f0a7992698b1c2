//! `augnerf sweep prune`.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::base::{Error, Result};
use crate::cli::answer::Answer;
use crate::cli::progress::{print, print_shown, says_yes};
use crate::sweep::{Left, SweepFolder, prunable, prune};

use super::{RUNS, begun};

pub const EXAMPLES: &str = "Examples:
  augnerf sweep prune smoke --dry-run  # lists what would go
  augnerf sweep prune runs/smoke --yes
  augnerf sweep prune runs/smoke --json --yes

Points stay on disk when a sweep file changes (--extend). Their runs, checkpoints and results are deleted for good.";

#[derive(Args)]
pub struct PruneArguments {
    /// Name of a sweep, or its folder: runs/NAME, or that of --out
    sweep: PathBuf,
    /// List the points and delete nothing
    #[arg(long)]
    dry_run: bool,
    /// Delete without a question
    #[arg(long, short = 'y', conflicts_with = "dry_run")]
    yes: bool,
    #[command(flatten)]
    answer: Answer,
}

impl PruneArguments {
    pub fn run(self) -> Result<()> {
        let named = Path::new(RUNS).join(&self.sweep);
        let folder = if self.sweep.is_dir() || !named.is_dir() { self.sweep.clone() } else { named };
        let folder = SweepFolder::new(&folder);
        // A definition that cannot be read asks for no point at all.
        folder.definition()?;
        let left = prunable(&folder, &begun(&folder, None)?)?;
        if !self.answer.json {
            list(&folder, &left)?;
        }
        let deletes = !left.is_empty() && !self.dry_run;
        if deletes {
            self.ask(left.len())?;
            prune(&folder, &left)?;
        }
        let points: Vec<_> = left.iter().map(|point| json!({ "id": point.id, "label": point.label })).collect();
        let answer = json!({ "folder": folder.path().display().to_string(), "points": points, "deleted": deletes });
        self.answer.give(&answer, || if deletes { print(&format!("deleted: {} points", left.len())) } else { Ok(()) })
    }

    /// Asks on a terminal.
    ///
    /// # Errors
    /// [`Error::Config`]: nobody said yes.
    fn ask(&self, count: usize) -> Result<()> {
        if self.yes {
            return Ok(());
        }
        if self.answer.json || !std::io::stdin().is_terminal() {
            return Err(Error::Config(format!("{count} points would be deleted; say so with --yes")));
        }
        match says_yes(&format!("Delete these {count} points with their runs?"))? {
            true => Ok(()),
            false => Err(Error::Config("nothing is deleted".into())),
        }
    }
}

/// Prints a line for each point, and their size.
fn list(folder: &SweepFolder, left: &[Left]) -> Result<()> {
    let mib = |bytes: u64| format!("{:.1} MiB", bytes as f64 / f64::from(1 << 20));
    for point in left {
        let state = if point.done { "done" } else { "not done" };
        print_shown(&format!("{:8} {} {}  {}", state, point.id, point.label, mib(point.bytes)))?;
    }
    let (shown, bytes) = (folder.path().display(), left.iter().map(|point| point.bytes).sum());
    print_shown(&match left.len() {
        0 => format!("{shown}: every point is one that its sweep.toml asks for"),
        count => format!("{shown}: {count} points that its sweep.toml does not ask for, {}", mib(bytes)),
    })
}
