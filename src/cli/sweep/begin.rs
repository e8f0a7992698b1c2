//! `augnerf sweep begin`.

use clap::Args;
use serde_json::json;

use crate::base::Result;
use crate::cli::Compute;
use crate::cli::answer::Answer;
use crate::cli::progress::print;
use crate::sweep::Trainings;

use super::{Changes, Location, begin_folder};

pub const EXAMPLES: &str = "Examples:
  augnerf sweep begin sweeps/checks/smoke.toml   # creates runs/smoke
  augnerf sweep run-point runs/smoke --index 3   # then runs one point, on any machine
  augnerf sweep begin sweeps/checks/smoke.toml --seeds 0,1,2 --out runs/three";

#[derive(Args)]
pub struct BeginArguments {
    #[command(flatten)]
    location: Location,
    #[command(flatten)]
    changes: Changes,
    /// Accept a changed sweep file; keep the old points on disk
    #[arg(long)]
    extend: bool,
    #[command(flatten)]
    answer: Answer,
    #[command(flatten)]
    compute: Compute,
}

impl BeginArguments {
    pub fn run(self) -> Result<()> {
        let definition = self.changes.definition(&self.location)?;
        let (folder, points) = self.compute.run(|runtime, console| {
            let trainings = Trainings::new(runtime.clone(), (Vec::new(), String::new()), false, console);
            begin_folder(&self.location, &definition, self.extend, (&trainings, &trainings), console)
        })?;
        let last = points.len().saturating_sub(1);
        let folder = folder.path().display().to_string();
        self.answer.give(&json!({ "folder": folder, "points": points.len() }), || {
            print(&format!(
                "{folder}: {} points, --index 0 to {last} of `augnerf sweep run-point {folder} --index N`",
                points.len()
            ))
        })
    }
}
