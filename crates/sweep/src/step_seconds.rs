//! `step_seconds.json`: seconds of a step, for budgets in seconds. All seconds of a sweep come from one clock, since
//! times of two machines or days do not compare.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use serde::{Deserialize, Serialize};

use crate::base::files::{read_json, write_json};
use crate::base::{Error, Result};
use crate::settings::Config;

use super::budget::{Clock, StepCosts};
use super::folder::{STEP_SECONDS, SweepFolder};

/// Content of the file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct StepSeconds {
    /// What they were measured on, or `None` before anything is.
    #[serde(flatten)]
    clock: Option<Clock>,
    /// Seconds by the shapes of steps.
    seconds: BTreeMap<String, f64>,
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

    fn of(&self, config: &Config) -> Option<f64> {
        self.seconds.get(&config.step_shape()).copied()
    }
}

/// Uses the seconds of a step next to the sweep's tables if all needed ones are there; otherwise measures all of them.
/// A sweep that is created again, on another day or machine, then gets the same steps and points.
pub struct PublishedCosts<'a> {
    path: PathBuf,
    known: StepSeconds,
    measure: &'a dyn StepCosts,
    used: AtomicBool,
}

impl<'a> PublishedCosts<'a> {
    /// Reads those of the tables in `results`.
    ///
    /// # Errors
    /// The file holds no seconds.
    pub fn beside(results: &Path, measure: &'a dyn StepCosts) -> Result<PublishedCosts<'a>> {
        let path = results.join(STEP_SECONDS);
        Ok(PublishedCosts { known: StepSeconds::read(&path)?, path, measure, used: AtomicBool::new(false) })
    }

    /// Returns a note that the file was used and what it was measured on, or `None` if it was not used.
    pub fn note(&self) -> Option<String> {
        let clock = self.known.clock.as_ref().map_or(String::new(), |clock| format!(", measured on {clock}"));
        let used = self.used.load(Ordering::SeqCst);
        used.then(|| format!("budgets in seconds: step times of {}{clock}", self.path.display()))
    }
}

impl StepCosts for PublishedCosts<'_> {
    fn prepare(&self, configs: &[&Config]) -> Result<()> {
        let all = !configs.is_empty() && configs.iter().all(|config| self.known.of(config).is_some());
        self.used.store(all, Ordering::SeqCst);
        if all { Ok(()) } else { self.measure.prepare(configs) }
    }

    fn seconds_per_step(&self, config: &Config) -> Result<f64> {
        match self.known.of(config).filter(|_| self.used.load(Ordering::SeqCst)) {
            Some(seconds) => Ok(seconds),
            None => self.measure.seconds_per_step(config),
        }
    }

    fn clock(&self) -> Option<Clock> {
        if self.used.load(Ordering::SeqCst) { self.known.clock.clone() } else { self.measure.clock() }
    }
}

/// Uses the seconds of a step that were measured when the sweep was created, so that an extended sweep keeps its
/// points. The caller holds the folder's lock.
pub struct KeptCosts<'a> {
    path: PathBuf,
    known: Mutex<StepSeconds>,
    measure: &'a dyn StepCosts,
}

impl<'a> KeptCosts<'a> {
    pub fn new(folder: &SweepFolder, measure: &'a dyn StepCosts) -> Result<KeptCosts<'a>> {
        let path = folder.step_seconds();
        let known = StepSeconds::read(&path)?;
        Ok(KeptCosts { path, known: Mutex::new(known), measure })
    }
}

impl StepCosts for KeptCosts<'_> {
    /// Measures new shapes together with the kept ones, and converts them to seconds of the kept clock.
    fn prepare(&self, configs: &[&Config]) -> Result<()> {
        let mut known = self.known.lock().expect("no panic while measuring");
        if configs.iter().all(|config| known.of(config).is_some()) {
            return Ok(());
        }
        self.measure.prepare(configs)?;
        let mut measured = BTreeMap::new();
        for config in configs {
            measured.insert(config.step_shape(), self.measure.seconds_per_step(config)?);
        }
        let both = || measured.iter().filter_map(|(shape, now)| Some((known.seconds.get(shape)?, now)));
        let (kept, now) = both().fold((0.0, 0.0), |(kept, sum), (before, now)| (kept + before, sum + now));
        let pace = if now > 0.0 { kept / now } else { 1.0 };
        if known.seconds.is_empty() {
            known.clock = self.measure.clock();
        }
        for (shape, seconds) in measured {
            known.seconds.entry(shape).or_insert(seconds * pace);
        }
        write_json(&self.path, &*known)
    }

    fn seconds_per_step(&self, config: &Config) -> Result<f64> {
        let known = self.known.lock().expect("no panic while measuring").of(config);
        known.map_or_else(|| self.measure.seconds_per_step(config), Ok)
    }
}

/// Costs that are unknown.
pub struct Unknown;

impl StepCosts for Unknown {
    fn seconds_per_step(&self, _: &Config) -> Result<f64> {
        Err(Error::Config("not measured".into()))
    }
}
