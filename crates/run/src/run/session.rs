//! The training loop: steps, logs, checkpoints, stops.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::base::{Error, Event, Listener, Result};
use crate::run::{RunDir, Scalars};

use crate::methods::{LogColumns, Term};
use crate::train::{StepStats, Trainer};

/// Work between steps.
pub trait Between {
    /// Evaluates during training; returns scalars to log. A run can resume from the step before the trainer's, so a
    /// signal may end the evaluation with [`interrupted`].
    fn evaluate(&mut self, trainer: &Trainer) -> Result<Vec<(&'static str, f64)>>;
    /// Runs after each step.
    fn stepped(&mut self, _trainer: &Trainer) -> Result<()> {
        Ok(())
    }
    /// Runs after a checkpoint; this session has spent `seconds` on steps.
    fn saved(&mut self, step: u64, seconds: f64) -> Result<()>;
}

/// How a session ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All steps are done.
    Finished,
    /// A signal stopped the session; a checkpoint was written.
    Stopped {
        /// The signal's number.
        signal: i32,
    },
}

/// Columns of an evaluation during training.
pub const EVALUATION_COLUMNS: [&str; 2] = ["test_psnr", "test_psnr_float"];

/// Columns that it fills if it also measures training views.
pub const TRAINING_VIEW_COLUMNS: [&str; 2] = ["train_psnr", "gap"];

/// A training session of one process in one run folder.
pub struct Session<'a> {
    run: &'a RunDir,
    trainer: Trainer,
    scalars: Scalars,
    /// Time spent on steps, without logs and evaluations.
    stepping: Duration,
    /// The terms of the loss in the last step of this session.
    last_terms: Vec<Term>,
}

/// Returns the columns of `scalars.csv` after `step`.
fn columns(trainer: &Trainer) -> Vec<String> {
    let LogColumns { photometric, further } = trainer.columns();
    let config = trainer.config();
    let when = |holds: bool, names: &'static [&str]| if holds { names } else { &[] };
    let evaluates = config.train.eval_every > 0;
    let evaluation = when(evaluates, &EVALUATION_COLUMNS);
    let seen = when(evaluates && config.eval.train_views != Some(0), &TRAINING_VIEW_COLUMNS);
    let named = |names: &[&str]| names.iter().map(|name| name.to_string()).collect::<Vec<_>>();
    [named(&["learning_rate", "loss"]), photometric, named(&["psnr"]), named(evaluation), named(seen), further].concat()
}

/// Writes the header of `scalars.csv`, for a run that may be measured before its first step.
pub(super) fn write_head(run: &RunDir, trainer: &Trainer) -> Result<()> {
    let columns = columns(trainer);
    let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
    Scalars::create(&run.scalars(), &columns).map(drop)
}

/// Returns one row of the logs.
fn values(stats: &StepStats) -> Vec<(String, f64)> {
    let mut values = vec![("learning_rate".to_string(), stats.learning_rate), ("loss".into(), stats.loss)];
    let mut terms = stats.terms.iter().map(|term| (term.name.clone(), term.value));
    values.extend(terms.next());
    values.extend(stats.psnr().map(|psnr| ("psnr".into(), psnr)));
    values.extend(terms);
    for site in &stats.sites {
        values.extend(site.columns());
    }
    values.extend(stats.of_weights.iter().cloned());
    values
}

impl<'a> Session<'a> {
    /// Creates a session that continues from the trainer's step: 0, or that of its checkpoint.
    pub fn new(run: &'a RunDir, trainer: Trainer) -> Result<Session<'a>> {
        let columns = columns(&trainer);
        let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
        let scalars = Scalars::resume(&run.scalars(), &columns, trainer.step_count())?;
        Ok(Session { run, trainer, scalars, stepping: Duration::ZERO, last_terms: Vec::new() })
    }

    /// Returns the trainer at the current step.
    pub fn trainer(&self) -> &Trainer {
        &self.trainer
    }

    /// Returns the seconds spent on steps in this session.
    pub fn seconds(&self) -> f64 {
        self.stepping.as_secs_f64()
    }

    /// Returns the terms of the loss in the last step of this session; none before its first.
    pub fn last_terms(&self) -> &[Term] {
        &self.last_terms
    }

    /// Trains to the last step, or until `signal` holds a signal's number, which also interrupts a long step. Writes
    /// checkpoints every N steps, every T minutes, before an evaluated step, at a stop and at the end.
    pub fn run(&mut self, signal: &AtomicUsize, events: &dyn Listener, between: &mut dyn Between) -> Result<Outcome> {
        let train = self.trainer.config().train.clone();
        let mut saved_at = Instant::now();
        // The session starts from a checkpoint, or from step 0, which is a function of the configuration.
        let mut saved_step = self.trainer.step_count();
        while self.trainer.step_count() < train.steps {
            let next = self.trainer.step_count() + 1;
            let last = next == train.steps;
            let log = next.is_multiple_of(train.log_every) || last;
            // Only 0 is a multiple of 0, which means "never" here. The last step's evaluation is the run's.
            let evaluate = next.is_multiple_of(train.eval_every) && !last;
            if evaluate && saved_step != next - 1 {
                // A step's row is written once, with its evaluation. After a stop there, the step is repeated.
                self.save(events, between)?;
                (saved_at, saved_step) = (Instant::now(), next - 1);
            }
            let started = Instant::now();
            let stats = match self.trainer.step_unless(log, log || evaluate, &|| stop_check(signal)) {
                Err(Error::Interrupted { signal, .. }) => {
                    // A stop within the step, which is repeated.
                    self.save(events, between)?;
                    return Ok(Outcome::Stopped { signal });
                }
                stats => stats?,
            };
            self.stepping += started.elapsed();
            if let (Some(stats), true) = (&stats, log || evaluate) {
                self.log(stats, evaluate, between)?;
            }
            self.measured(stats, events);
            between.stepped(&self.trainer)?;
            let by_step = next.is_multiple_of(train.checkpoint_every);
            let minutes = saved_at.elapsed().as_secs_f64() / 60.0;
            let by_time = train.checkpoint_minutes > 0.0 && minutes >= train.checkpoint_minutes;
            let stop = signal.load(Ordering::SeqCst);
            if by_step || by_time || last || stop != 0 {
                self.save(events, between)?;
                (saved_at, saved_step) = (Instant::now(), next);
            }
            if stop != 0 && !last {
                return Ok(Outcome::Stopped { signal: stop as i32 });
            }
        }
        Ok(Outcome::Finished)
    }

    fn log(&mut self, stats: &StepStats, evaluate: bool, between: &mut dyn Between) -> Result<()> {
        let mut values = values(stats);
        if evaluate {
            values.extend(between.evaluate(&self.trainer)?.into_iter().map(|(name, value)| (name.to_string(), value)));
        }
        let named: Vec<(&str, f64)> = values.iter().map(|(name, value)| (name.as_str(), *value)).collect();
        self.scalars.append(stats.step, &named)
    }

    fn measured(&mut self, stats: Option<StepStats>, events: &dyn Listener) {
        if let Some(stats) = stats {
            events.on(Event::Stepped { step: stats.step, loss: stats.loss, psnr: stats.psnr() });
            self.last_terms = stats.terms;
        }
    }

    fn save(&mut self, events: &dyn Listener, between: &mut dyn Between) -> Result<()> {
        let started = Instant::now();
        let stats = self.trainer.catch_up()?;
        self.stepping += started.elapsed();
        self.measured(stats, events);
        self.scalars.sync()?;
        self.trainer.save(&self.run.checkpoints())?;
        between.saved(self.trainer.step_count(), self.seconds())
    }
}

/// Returns an error once there is a signal.
pub(super) fn stop_check(signal: &AtomicUsize) -> Result<()> {
    match signal.load(Ordering::SeqCst) {
        0 => Ok(()),
        signal => Err(Error::Interrupted { signal: signal as i32, message: format!("signal {signal} within a step") }),
    }
}

/// Returns the error with which a stopped session ends the program.
pub fn interrupted(signal: i32, step: u64, run: &std::path::Path) -> Error {
    Error::Interrupted {
        signal,
        message: format!(
            "stopped by signal {signal} at step {step}; nothing is lost: `augnerf resume {}` continues from there",
            run.display()
        ),
    }
}
