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

/// Columns of an evaluation during training.
pub const EVALUATION_COLUMNS: [&str; 2] = ["test_psnr", "test_psnr_float"];

/// Columns that it fills if it also measures training views.
pub const TRAINING_VIEW_COLUMNS: [&str; 2] = ["train_psnr", "gap"];

/// What a process measured of its part of a training.
pub struct Session {
    /// Seconds spent on steps, without logs and evaluations.
    pub seconds: f64,
    /// The terms of the loss in the last step; none if it took no step.
    pub last_terms: Vec<Term>,
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
    values.extend(stats.weight_columns.iter().cloned());
    values
}

impl Trainer {
    /// Trains in a run folder from this step, 0 or that of a checkpoint, to the last one. Writes checkpoints every N steps,
    /// every T minutes, before an evaluated step, at a stop and at the end.
    ///
    /// # Errors
    /// [`Error::Interrupted`], with a checkpoint, once `signal` holds a signal's number, which also interrupts a long step.
    /// Those of [`Trainer::step`], of logs and checkpoints, and of `between`.
    pub fn run(
        &mut self,
        run: &RunDir,
        signal: &AtomicUsize,
        events: &dyn Listener,
        between: &mut dyn Between,
    ) -> Result<Session> {
        let train = self.config().train.clone();
        let columns = columns(self);
        let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
        let scalars = Scalars::resume(&run.scalars(), &columns, self.step_count())?;
        let mut journal = Journal { run, scalars, stepping: Duration::ZERO, last_terms: Vec::new(), events, between };
        let mut saved_at = Instant::now();
        // The session starts from a checkpoint, or from step 0, which is a function of the configuration.
        let mut saved_step = self.step_count();
        while self.step_count() < train.steps {
            let next = self.step_count() + 1;
            let last = next == train.steps;
            let log = next.is_multiple_of(train.log_every) || last;
            // Only 0 is a multiple of 0, which means "never" here. The last step's evaluation is the run's.
            let evaluate = next.is_multiple_of(train.eval_every) && !last;
            if evaluate && saved_step != next - 1 {
                // A step's row is written once, with its evaluation. After a stop there, the step is repeated.
                journal.save(self)?;
                (saved_at, saved_step) = (Instant::now(), next - 1);
            }
            let started = Instant::now();
            let stats = match self.step_unless(log, log || evaluate, &|| stop_check(signal)) {
                Err(Error::Interrupted { signal, .. }) => {
                    // A stop within the step, which is repeated.
                    journal.save(self)?;
                    return Err(interrupted(signal, next - 1, run.path()));
                }
                stats => stats?,
            };
            journal.stepping += started.elapsed();
            if let (Some(stats), true) = (&stats, log || evaluate) {
                journal.log(self, stats, evaluate)?;
            }
            journal.measured(stats);
            journal.between.stepped(self)?;
            let by_step = next.is_multiple_of(train.checkpoint_every);
            let minutes = saved_at.elapsed().as_secs_f64() / 60.0;
            let by_time = train.checkpoint_minutes > 0.0 && minutes >= train.checkpoint_minutes;
            let stop = signal.load(Ordering::SeqCst);
            if by_step || by_time || last || stop != 0 {
                journal.save(self)?;
                (saved_at, saved_step) = (Instant::now(), next);
            }
            if stop != 0 && !last {
                return Err(interrupted(stop as i32, next, run.path()));
            }
        }
        Ok(Session { seconds: journal.stepping.as_secs_f64(), last_terms: journal.last_terms })
    }
}

/// What is written and told of a training as it goes on.
struct Journal<'a> {
    run: &'a RunDir,
    scalars: Scalars,
    /// Time spent on steps, without logs and evaluations.
    stepping: Duration,
    /// The terms of the loss in the last step of this session.
    last_terms: Vec<Term>,
    events: &'a dyn Listener,
    between: &'a mut dyn Between,
}

impl Journal<'_> {
    fn log(&mut self, trainer: &Trainer, stats: &StepStats, evaluate: bool) -> Result<()> {
        let mut values = values(stats);
        if evaluate {
            let found = self.between.evaluate(trainer)?;
            values.extend(found.into_iter().map(|(name, value)| (name.to_string(), value)));
        }
        let named: Vec<(&str, f64)> = values.iter().map(|(name, value)| (name.as_str(), *value)).collect();
        self.scalars.append(stats.step, &named)
    }

    fn measured(&mut self, stats: Option<StepStats>) {
        if let Some(stats) = stats {
            self.events.on(Event::Stepped { step: stats.step, loss: stats.loss, psnr: stats.psnr() });
            self.last_terms = stats.report.terms;
        }
    }

    fn save(&mut self, trainer: &mut Trainer) -> Result<()> {
        let started = Instant::now();
        let stats = trainer.catch_up()?;
        self.stepping += started.elapsed();
        self.measured(stats);
        self.scalars.sync()?;
        trainer.save(&self.run.checkpoints())?;
        self.between.saved(trainer.step_count(), self.stepping.as_secs_f64())
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
