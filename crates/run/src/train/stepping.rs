//! Steps that were taken and whose reports are still to come.

use std::collections::VecDeque;
use std::time::Instant;

use crate::base::Result;
use crate::methods::{StepAt, Stepper, StopCheck};

use super::health;
use super::stats::StepStats;

/// Seconds after which reports are due: a stop and the display of progress wait no longer.
const REPORTS_WITHIN: f64 = 0.25;

/// A stepper with the steps that it has not reported yet.
pub(super) struct Stepping {
    pub(super) stepper: Box<dyn Stepper>,
    waiting: VecDeque<StepAt>,
    /// When the first of them was taken.
    waiting_since: Instant,
    /// Steps after which reports are due.
    every: usize,
    /// Successive steps that were dead; see [`health::count_dead`].
    pub(super) dead_steps: u64,
    /// A step came after the last fetch.
    moved: bool,
}

impl Stepping {
    pub(super) fn new(stepper: Box<dyn Stepper>, dead_steps: u64) -> Stepping {
        let (waiting, waiting_since) = (VecDeque::new(), Instant::now());
        Stepping { stepper, waiting, waiting_since, every: 1, dead_steps, moved: false }
    }

    /// Takes a step.
    pub(super) fn step(&mut self, at: StepAt, stop_check: &StopCheck) -> Result<()> {
        if self.waiting.is_empty() {
            self.waiting_since = Instant::now();
        }
        self.moved = true;
        self.stepper.step(at, stop_check)?;
        self.waiting.push_back(at);
        Ok(())
    }

    /// Returns whether the reports should be asked for.
    pub(super) fn is_due(&self) -> bool {
        self.waiting.len() >= self.every
    }

    /// Waits for the reports of all steps, and returns the last one's. `collapse_steps` is the limit of dead steps.
    pub(super) fn catch_up(&mut self, collapse_steps: u64) -> Result<Option<StepStats>> {
        if self.waiting.is_empty() {
            return Ok(None);
        }
        let reports = self.stepper.reports()?;
        let each = self.waiting_since.elapsed().as_secs_f64() / self.waiting.len() as f64;
        self.every = ((REPORTS_WITHIN / each) as usize).clamp(1, self.stepper.most_reports());
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
        if std::mem::take(&mut self.moved) {
            self.stepper.fetch()?;
        }
        Ok(())
    }
}
