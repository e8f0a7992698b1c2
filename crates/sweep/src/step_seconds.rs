//! `step_seconds.json`: seconds of a step, for budgets in seconds. All seconds of a sweep come from one clock, since
//! times of two machines or days do not compare.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::base::files::{read_json, write_json};
use crate::base::{Error, Result};
use crate::settings::Config;

use super::folder::STEP_SECONDS;

/// Measures the seconds of a step of each of some configurations. They are compared with one another, so they should
/// come from one clock.
pub type MeasureSteps<'a> = dyn Fn(&[&Config]) -> Result<StepSeconds> + 'a;

/// The machine and program that seconds were measured on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Clock {
    /// The CPU's model, or `unknown`.
    pub processor: String,
    /// The device, as `cpu`.
    pub device: String,
    /// Number of threads.
    pub threads: usize,
    /// Revision of the code.
    pub code_revision: String,
}

impl std::fmt::Display for Clock {
    /// Writes `12th Gen Intel(R) Core(TM) i5 (cpu, 2 threads, revision 21b6470)`.
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let Clock { processor, device, threads, code_revision } = self;
        write!(f, "{processor} ({device}, {threads} threads, revision {code_revision})")
    }
}

/// Seconds of a training step; the content of the file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StepSeconds {
    /// What they were measured on, or `None` if it is unknown.
    #[serde(flatten)]
    pub clock: Option<Clock>,
    /// Seconds by the shapes of steps.
    seconds: BTreeMap<String, f64>,
}

impl<'a> FromIterator<(&'a Config, f64)> for StepSeconds {
    fn from_iter<T: IntoIterator<Item = (&'a Config, f64)>>(seconds: T) -> StepSeconds {
        let seconds = seconds.into_iter().map(|(config, seconds)| (config.step_shape(), seconds)).collect();
        StepSeconds { clock: None, seconds }
    }
}

impl StepSeconds {
    /// Reads the file; empty if it does not exist.
    fn read(path: &Path) -> Result<StepSeconds> {
        let file: StepSeconds = read_json(path, "delete it")?.unwrap_or_default();
        if let Some((shape, seconds)) =
            file.seconds.iter().find(|(_, seconds)| !(seconds.is_finite() && **seconds > 0.0))
        {
            let found = format!("a step of {shape} takes {seconds} s, which is impossible");
            return Err(Error::Checkpoint(format!("cannot use {}: {found}; delete it", path.display())));
        }
        Ok(file)
    }

    /// Returns the seconds of a step of a configuration's shape, if they are known.
    pub fn of(&self, config: &Config) -> Option<f64> {
        self.seconds.get(&config.step_shape()).copied()
    }

    /// Returns the seconds of `configs` next to the tables in `results`, or `None` if any is missing there. A sweep
    /// that is created again, on another day or machine, then gets the same steps and points.
    ///
    /// # Errors
    /// The file holds no seconds.
    pub fn published(results: &Path, configs: &[&Config]) -> Result<Option<StepSeconds>> {
        let file = StepSeconds::read(&results.join(STEP_SECONDS))?;
        let known: Option<StepSeconds> = configs.iter().map(|config| Some((*config, file.of(config)?))).collect();
        Ok(known.map(|known| StepSeconds { clock: file.clock, ..known }))
    }

    /// Returns the seconds of `configs` that the file `path` keeps, so that an extended sweep keeps its points. If any is
    /// missing, all are measured, and new ones are converted to seconds of the kept clock. The caller holds the folder's
    /// lock.
    pub(super) fn kept(path: &Path, configs: &[&Config], measure: &MeasureSteps) -> Result<StepSeconds> {
        let mut kept = StepSeconds::read(path)?;
        if configs.iter().all(|config| kept.of(config).is_some()) {
            return Ok(kept);
        }
        let measured = measure(configs)?;
        let both = measured.seconds.iter().filter_map(|(shape, now)| Some((kept.seconds.get(shape)?, now)));
        let (before, now) = both.fold((0.0, 0.0), |(sum, now_sum), (before, now)| (sum + before, now_sum + now));
        let pace = if now > 0.0 { before / now } else { 1.0 };
        if kept.seconds.is_empty() {
            kept.clock = measured.clock;
        }
        for (shape, seconds) in measured.seconds {
            kept.seconds.entry(shape).or_insert(seconds * pace);
        }
        write_json(path, &kept)?;
        Ok(kept)
    }
}
