//! What takes the steps of a training: a method's learner with Adam on a device of candle, or an accelerator.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use super::Moments;
use super::descent::Descent;
use super::health::count_dead;
use super::stats::StepStats;
use crate::base::{Error, Result};
use crate::losses::LossTerm;
use crate::methods::{DeviceSteps, LogColumns, StepAt, StepReport, StopCheck, no_sites};
use crate::perturb::Site;
use crate::settings::Config;

/// Seconds of steps whose reports come together, about: a stop and the display of progress wait for them.
const SECONDS_TOGETHER: f64 = 0.25;

/// Takes steps, and has those that it has not reported yet.
pub(super) struct Stepper {
    steps: Steps,
    /// Successive dead steps that end the training; see [`count_dead`].
    collapse_steps: u64,
    dead_steps: u64,
    waiting: VecDeque<StepAt>,
    /// When the first of them was taken.
    waiting_since: Instant,
    /// The report of a learner's last step.
    report: Option<StepReport>,
    /// Steps after which reports are due.
    every: usize,
    /// A step came after the last fetch.
    moved: bool,
    /// What broke a step: its parameters and later ones are not those of the steps that were counted.
    broken: Option<String>,
}

/// Where the steps are computed.
pub(super) enum Steps {
    /// The model's variables are its parameters.
    Learner(Box<Descent>),
    /// Parameters and moments are kept on a device. The moments here are those of the last fetch.
    Device(Box<dyn DeviceSteps>, Vec<Moments>),
}

/// Returns how many steps of so many seconds have their reports together, at most `most`.
fn together(seconds: f64, most: usize) -> usize {
    ((SECONDS_TOGETHER / seconds) as usize).min(most).max(1)
}

impl Stepper {
    pub(super) fn new(steps: Steps, config: &Config, dead_steps: u64) -> Stepper {
        Stepper {
            steps,
            collapse_steps: config.train.collapse_steps,
            dead_steps,
            waiting: VecDeque::new(),
            report: None,
            waiting_since: Instant::now(),
            every: 1,
            moved: false,
            broken: None,
        }
    }

    pub(super) fn columns(&self) -> LogColumns {
        match &self.steps {
            Steps::Learner(descent) => descent.columns(),
            Steps::Device(steps, _) => steps.columns(),
        }
    }

    pub(super) fn add_term(&mut self, term: LossTerm, weight: f64) -> Result<()> {
        match &mut self.steps {
            Steps::Learner(descent) => descent.learner.add_term(term, weight),
            Steps::Device(..) => Err(Error::Config(format!(
                "the term '{}' is your own, which device gpu does not compute; use cpu",
                term.name()
            ))),
        }
    }

    pub(super) fn add_site(&mut self, site: Arc<dyn Site>) -> Result<()> {
        match &mut self.steps {
            Steps::Learner(descent) => descent.learner.add_site(site),
            Steps::Device(..) => Err(no_sites(&*site)),
        }
    }

    pub(super) fn dead_steps(&self) -> u64 {
        self.dead_steps
    }

    /// Takes a step: loss, gradients and update. Its random numbers depend on seed and step only. A long step calls
    /// `stop_check` regularly, and ends with its error. It then has changed no parameter and no moment. A device may
    /// return before it is done.
    ///
    /// # Errors
    /// [`Error::Diverged`], for a term, a gradient or a parameter that is not finite; those of the check.
    pub(super) fn step(&mut self, at: StepAt, stop_check: &StopCheck) -> Result<()> {
        self.check()?;
        if self.waiting.is_empty() {
            self.waiting_since = Instant::now();
        }
        self.moved = true;
        let is_stopped = AtomicBool::new(false);
        let check = || stop_check().inspect_err(|_| is_stopped.store(true, Ordering::Relaxed));
        let taken = match &mut self.steps {
            Steps::Learner(descent) => descent.step(at, &check).map(|report| self.report = Some(report)),
            Steps::Device(steps, _) => check().and_then(|()| steps.step(at)),
        };
        // A step that was stopped is as if it had not begun.
        if is_stopped.into_inner() { taken } else { self.noted(taken) }?;
        self.waiting.push_back(at);
        Ok(())
    }

    /// Returns whether the reports should be asked for.
    pub(super) fn is_due(&self) -> bool {
        self.waiting.len() >= self.every
    }

    /// Waits for the reports of all steps, and returns the last one's.
    pub(super) fn catch_up(&mut self) -> Result<Option<StepStats>> {
        self.check()?;
        if self.waiting.is_empty() {
            return Ok(None);
        }
        let reported = self.read_reports();
        self.noted(reported)
    }

    fn read_reports(&mut self) -> Result<Option<StepStats>> {
        let (reports, most): (Vec<StepReport>, usize) = match &mut self.steps {
            Steps::Learner(_) => (self.report.take().into_iter().collect(), 1),
            Steps::Device(steps, _) => (steps.reports()?, steps.most_reports()),
        };
        assert_eq!(reports.len(), self.waiting.len(), "every step has a report");
        let each = self.waiting_since.elapsed().as_secs_f64() / self.waiting.len() as f64;
        self.every = together(each, most);
        let mut last = None;
        for (report, at) in reports.into_iter().zip(self.waiting.drain(..)) {
            let stats = StepStats::new(at, report);
            self.dead_steps = count_dead(self.dead_steps, &stats, self.collapse_steps)?;
            last = Some(stats);
        }
        Ok(last)
    }

    /// Brings the newest parameters into the model's variables, and moments here.
    pub(super) fn fetch(&mut self) -> Result<()> {
        self.catch_up()?;
        if let (Steps::Device(steps, moments), true) = (&mut self.steps, self.moved) {
            *moments = steps.fetch()?;
        }
        self.moved = false;
        Ok(())
    }

    /// Returns Adam's moments at the last [`Stepper::fetch`], in the order of the model's variables.
    pub(super) fn moments(&self) -> &[Moments] {
        match &self.steps {
            Steps::Learner(descent) => descent.adam.moments(),
            Steps::Device(_, moments) => moments,
        }
    }

    /// Keeps the error of a step that broke.
    fn noted<T>(&mut self, taken: Result<T>) -> Result<T> {
        if let Err(error) = &taken {
            self.broken = Some(error.to_string());
        }
        taken
    }

    fn check(&self) -> Result<()> {
        self.broken.as_ref().map_or(Ok(()), |broken| Err(Error::Diverged(broken.clone())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_steps_are_reported_together() {
        assert_eq!([0.0, 0.01, 0.05, 0.2, 9.0].map(|seconds| together(seconds, 16)), [16, 16, 5, 1, 1]);
        assert_eq!(together(0.01, 1), 1);
    }
}
