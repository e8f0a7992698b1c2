//! `augnerf sweep power`.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use crate::base::{Error, Result};
use crate::cli::answer::Answer;
use crate::cli::progress::print_shown;
use crate::cli::whole;
use crate::metrics::{Metric, PSNR};
use crate::report::power::{LEAST_SEEDS, MOST_SEEDS, POWER, Spread, spreads};
use crate::sweep::{Selection, Source, View};

use super::opened::Opened;

pub const EXAMPLES: &str = "Examples:
  augnerf sweep power runs/pilot                             # for the margin that the sweep states
  augnerf sweep power runs/pilot --difference 0.3            # for 0.3 dB
  augnerf sweep power runs/study --difference 0.3 --tests 4  # corrected over four comparisons";

#[derive(Args)]
pub struct PowerArguments {
    /// Folder of a sweep or of its results: runs/NAME or results/NAME
    folder: PathBuf,
    /// Difference to detect, in the metric's unit [default: the margin that the sweep states]
    #[arg(long, allow_negative_numbers = true)]
    difference: Option<f64>,
    /// Metric
    #[arg(long, default_value = PSNR.key)]
    metric: String,
    /// Row that all others are compared with [default: their baselines]
    #[arg(long, value_name = "ROW")]
    baseline: Option<String>,
    /// Comparisons that p is corrected over [default: those of the scene's table]
    #[arg(long, value_name = "N", value_parser = whole::<u16>(1..=u16::MAX.into()))]
    tests: Option<u16>,
    /// Folder of the scenes
    #[arg(long, env = "AUGNERF_DATA", value_name = "DIR")]
    data_root: Option<PathBuf>,
    #[command(flatten)]
    answer: Answer,
}

impl PowerArguments {
    pub fn run(self) -> Result<()> {
        let sweep = Opened::read(&self.folder, self.data_root.as_deref())?;
        let metrics = vec![self.metric.clone()];
        let selection = Selection { baseline: self.baseline.clone(), metrics, ..Selection::default() };
        // Metrics over common pixels are those of all rows of the sweep.
        let source = Source { folder: None, ..sweep.source()? };
        let table = View::new(&sweep.name, &[source], selection)?.table()?;
        let metric = Metric::find(&self.metric).expect("the view has it");
        let difference = self.difference(sweep.definition.equivalence.get(&self.metric).copied())?;
        let spreads = spreads(&table, difference, self.tests.map(usize::from));
        if spreads.is_empty() {
            return Err(Error::Config("no row has a baseline; name one with --baseline".into()));
        }
        let answer = json!({ "metric": self.metric, "difference": difference, "power": POWER, "rows": spreads });
        self.answer.give(&answer, || {
            print_shown(&format!(
                "{}: seeds that detect a difference of {} in {:.0} of 100 studies with this standard deviation, p {}; no means \
                 are shown",
                self.metric,
                with_unit(difference.to_string(), metric),
                100.0 * POWER,
                match self.tests {
                    Some(tests) => format!("corrected over {tests} comparisons"),
                    None => "corrected over the scene's rows".into(),
                }
            ))?;
            spreads.iter().try_for_each(|spread| print_shown(&text(spread, metric)))
        })
    }

    fn difference(&self, stated: Option<f64>) -> Result<f64> {
        let difference = self.difference.or(stated).ok_or_else(|| {
            Error::Config(format!("the sweep states no margin for {}; choose one with --difference", self.metric))
        })?;
        match difference.is_finite() && difference > 0.0 {
            true => Ok(difference),
            false => Err(Error::Config(format!("--difference {difference}: out of range; choose a number above 0"))),
        }
    }
}

fn text(spread: &Spread, metric: &Metric) -> String {
    let Spread { scene, label, baseline, seeds, deviation, tests: _, seeds_needed } = spread;
    let needed = match seeds_needed {
        _ if *seeds < LEAST_SEEDS => format!("an estimate needs at least {LEAST_SEEDS}"),
        None => format!("more than {MOST_SEEDS} are needed"),
        Some(needed) => format!("{needed} needed"),
    };
    let found = match deviation {
        None => needed,
        Some(deviation) => format!("standard deviation {}; {needed}", with_unit(two_figures(*deviation), metric)),
    };
    format!("{scene}: {label} minus {baseline}, seeds so far {seeds}: {found}")
}

fn with_unit(number: String, metric: &Metric) -> String {
    format!("{number} {}", metric.unit).trim_end().to_string()
}

/// Formats a number with two significant figures.
fn two_figures(value: f64) -> String {
    let digits = if value > 0.0 { (1.0 - value.log10().floor()).clamp(0.0, 9.0) as usize } else { 0 };
    format!("{value:.digits$}")
}
