//! `augnerf sweep best`.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use crate::base::Result;
use crate::cli::answer::Answer;
use crate::cli::progress::print_shown;
use crate::metrics::{Metric, PSNR};
use crate::sweep::{Best, best};

use super::opened::Opened;

pub const EXAMPLES: &str = "Examples:
  augnerf sweep best runs/tab4_fern                # by PSNR
  augnerf sweep best runs/tab4_fern --metric ssim
  augnerf sweep best results/paper/tab4_fern --json";

#[derive(Args)]
pub struct BestArguments {
    /// Folder of a sweep or of its results: runs/NAME or results/NAME
    folder: PathBuf,
    /// Metric, as the mean over seeds
    #[arg(long, value_name = "METRIC", default_value = PSNR.key)]
    metric: String,
    /// Compare rows that differ in an uncontrolled setting, such as the revision
    #[arg(long)]
    force: bool,
    /// Folder of the scenes
    #[arg(long, env = "AUGNERF_DATA", value_name = "DIR")]
    data_root: Option<PathBuf>,
    #[command(flatten)]
    answer: Answer,
}

impl BestArguments {
    pub fn run(self) -> Result<()> {
        let sweep = Opened::read(&self.folder, self.data_root.as_deref())?;
        let spec = sweep.definition.table(&sweep.name, &sweep.points);
        let found = best(&sweep.folder, &spec, &sweep.points, &sweep.outputs()?, &self.metric, self.force)?;
        self.answer.give(&json!({ "best": found }), || found.iter().try_for_each(|best| print_shown(&text(best))))
    }
}

fn text(best: &Best) -> String {
    let metric = Metric::find(&best.metric).expect("checked");
    let next =
        best.next.as_ref().map_or(String::new(), |(label, mean)| format!(" (next: {label}, {})", metric.text(*mean)));
    let mut lines = vec![format!(
        "{}: {}, {} {}, mean of {} seeds{next}",
        best.scene,
        best.label,
        best.metric,
        metric.with_unit(best.mean),
        best.seeds.len()
    )];
    lines.extend(best.against_baseline.iter().map(|sentence| format!("  {sentence}")));
    let settings: Vec<String> = best.settings.iter().map(|(name, value)| format!("{name} = {value}")).collect();
    if !settings.is_empty() {
        lines.push(format!("  {}", settings.join(", ")));
    }
    let seed = |seed: &crate::sweep::BestSeed| {
        let place = seed.run.as_ref().map_or(format!("point {}", seed.id), |run| run.display().to_string());
        format!("  seed {}: {}  {place}", seed.seed, metric.text(seed.value))
    };
    lines.extend(best.seeds.iter().map(seed));
    if !best.unfinished.is_empty() {
        lines.push(format!("  skipped, with unfinished points: {}", best.unfinished.join(", ")));
    }
    if best.no_better_than_one_colour {
        let (of_one, all) = (best.seeds_of_one_colour, best.seeds.len());
        lines.push(format!(
            "  no better than one colour with {of_one} of {all} seeds: PSNR is no higher than floor_psnr"
        ));
    }
    lines.push(match best.on_validation {
        true => format!(
            "  chosen among {} rows on validation views (split {})",
            best.candidates, best.split
        ),
        false => format!(
            "  chosen among {} rows on the reported views (split {}), so its number is biased upwards; choose on validation \
             views with data.validation or data.eval_split = \"val\"",
            best.candidates, best.split
        ),
    });
    lines.join("\n")
}
