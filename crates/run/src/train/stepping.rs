//! Steps that were taken and whose reports are still to come.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use crate::base::{Error, Result};
use crate::methods::{StepAt, Stepper, StopCheck};

use super::health;
use super::stats::StepStats;

/// Seconds of steps whose reports come together, about: a stop and the display of progress wait for them.
const SECONDS_TOGETHER: f64 = 0.25;

/// A stepper with the steps that it has not reported yet.
pub(super) struct Stepping {
    stepper: Box<dyn Stepper>,
    waiting: VecDeque<StepAt>,
    /// When the first of them was taken.
    waiting_since: Instant,
    /// Steps after which reports are due.
    every: usize,
    /// Successive steps that were dead; see [`health::count_dead`].
    dead_steps: u64,
    /// A step came after the last fetch.
    moved: bool,
    /// What broke a step: its parameters and later ones are not those of the steps that were counted.
    broken: Option<String>,
}

/// Returns how many steps of so many seconds have their reports together, at most `most`.
fn together(seconds: f64, most: usize) -> usize {
    ((SECONDS_TOGETHER / seconds) as usize).min(most).max(1)
}

impl Stepping {
    pub(super) fn new(stepper: Box<dyn Stepper>, dead_steps: u64) -> Stepping {
        let (waiting, waiting_since) = (VecDeque::new(), Instant::now());
        Stepping { stepper, waiting, waiting_since, every: 1, dead_steps, moved: false, broken: None }
    }

    pub(super) fn stepper(&self) -> &dyn Stepper {
        &*self.stepper
    }

    pub(super) fn stepper_mut(&mut self) -> &mut dyn Stepper {
        &mut *self.stepper
    }

    pub(super) fn dead_steps(&self) -> u64 {
        self.dead_steps
    }

    /// Takes a step.
    pub(super) fn step(&mut self, at: StepAt, stop_check: &StopCheck) -> Result<()> {
        self.check()?;
        if self.waiting.is_empty() {
            self.waiting_since = Instant::now();
        }
        self.moved = true;
        let is_stopped = AtomicBool::new(false);
        let check = || stop_check().inspect_err(|_| is_stopped.store(true, Ordering::Relaxed));
        let taken = self.stepper.step(at, &check);
        // A step that was stopped is as if it had not begun.
        if is_stopped.into_inner() { taken } else { self.noted(taken) }?;
        self.waiting.push_back(at);
        Ok(())
    }

    /// Returns whether the reports should be asked for.
    pub(super) fn is_due(&self) -> bool {
        self.waiting.len() >= self.every
    }

    /// Waits for the reports of all steps, and returns the last one's. `collapse_steps` is the limit of dead steps.
    pub(super) fn catch_up(&mut self, collapse_steps: u64) -> Result<Option<StepStats>> {
        self.check()?;
        if self.waiting.is_empty() {
            return Ok(None);
        }
        let reported = self.read_reports(collapse_steps);
        self.noted(reported)
    }

    fn read_reports(&mut self, collapse_steps: u64) -> Result<Option<StepStats>> {
        let reports = self.stepper.reports()?;
        assert_eq!(reports.len(), self.waiting.len(), "every step has a report");
        let each = self.waiting_since.elapsed().as_secs_f64() / self.waiting.len() as f64;
        self.every = together(each, self.stepper.most_reports());
        let mut last = None;
        for (report, at) in reports.into_iter().zip(self.waiting.drain(..)) {
            let stats = StepStats::new(at, report);
            self.dead_steps = health::count_dead(self.dead_steps, &stats, collapse_steps)?;
            last = Some(stats);
        }
        Ok(last)
    }

    /// Brings the newest parameters and moments here.
    pub(super) fn fetch(&mut self, collapse_steps: u64) -> Result<()> {
        self.catch_up(collapse_steps)?;
        if self.moved {
            self.stepper.fetch()?;
            self.moved = false;
        }
        Ok(())
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
