//! The training loop: steps, logs, checkpoints, stops.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::base::{Error, Event, Image, Listener, Result};
use crate::run::{EventWriter, RunDir, Scalars};

use crate::methods::{LogColumns, Term};
use crate::metrics::MeanMetrics;
use crate::settings::registry::{Effect, REGISTRY};
use crate::settings::{Config, value_at};
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
    events: EventWriter,
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

/// Returns the TensorBoard tag of a column. The tag says whether the number is of training rays or of views, so that
/// no two numbers share a name. `scalars.csv` keeps the column names.
fn tag(column: &str, eval_stride: usize) -> String {
    // Over every N-th pixel, the number differs from that of complete views at the end.
    let evaluated = if eval_stride == 1 { "eval" } else { "eval_sparse" };
    match column {
        "test_psnr" => format!("{evaluated}/psnr"),
        "test_psnr_float" => format!("{evaluated}/psnr_float"),
        // An evaluation of training views.
        seen if TRAINING_VIEW_COLUMNS.contains(&seen) => format!("{evaluated}/{seen}"),
        trained => format!("train/{}", trained.replace('.', "/")),
    }
}

/// Returns what identifies a run: its method, scene and seed, and all settings that can change a number and are not at
/// their defaults.
fn settings(config: &Config) -> Vec<(String, toml::Value)> {
    let (own, default) = (config.portable().to_table(), Config::default().portable().to_table());
    let always = ["method", "data.name", "seed", "train.steps"];
    let of_numbers = REGISTRY.settings.iter().filter(|setting| setting.rule.effect == Effect::Numbers);
    let named = always.into_iter().chain(
        of_numbers
            .map(|setting| setting.path.as_str())
            .filter(|path| !always.contains(path) && value_at(&own, path) != value_at(&default, path)),
    );
    named.filter_map(|path| Some((path.to_string(), value_at(&own, path)?.clone()))).collect()
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
    /// Creates a session that continues from the trainer's step: 0, or that of its checkpoint. With `resumed`, an
    /// earlier session may have logged later steps.
    pub fn new(run: &'a RunDir, trainer: Trainer, resumed: bool) -> Result<Session<'a>> {
        let columns = columns(&trainer);
        let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
        let step = trainer.step_count();
        let scalars = Scalars::resume(&run.scalars(), &columns, step)?;
        let mut events = EventWriter::create(&run.tensorboard(), resumed.then_some(step))?;
        let config: &Config = trainer.config();
        let group = Config { seed: 0, ..config.clone() }.hash();
        events.settings(&group, &settings(config))?;
        Ok(Session { run, trainer, scalars, events, stepping: Duration::ZERO, last_terms: Vec::new() })
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

    /// Adds an image to the TensorBoard events at the current step.
    pub fn picture(&mut self, tag: &str, picture: &Image) -> Result<()> {
        self.events.image(self.trainer.step_count(), tag, picture)
    }

    /// Adds the metrics of the final evaluation to the TensorBoard events.
    pub fn evaluated(&mut self, mean: &MeanMetrics) -> Result<()> {
        let known: Vec<(String, f64)> =
            mean.iter().filter_map(|(metric, value)| Some((format!("eval/{}", metric.key), value?))).collect();
        let tagged: Vec<(&str, f64)> = known.iter().map(|(tag, value)| (tag.as_str(), *value)).collect();
        self.events.scalars(self.trainer.step_count(), &tagged)?;
        self.events.finished()
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
        self.scalars.append(stats.step, &named)?;
        let stride = self.trainer.config().train.eval_stride;
        let tags: Vec<String> = values.iter().map(|(name, _)| tag(name, stride)).collect();
        let tagged: Vec<(&str, f64)> = tags.iter().map(String::as_str).zip(values.iter().map(|v| v.1)).collect();
        self.events.scalars(stats.step, &tagged)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_columns_share_a_tag() {
        let of = |column: &str| tag(column, 1);
        assert_eq!(of("psnr"), "train/psnr");
        assert_eq!(of("test_psnr"), "eval/psnr");
        assert_eq!((of("train_psnr"), of("gap")), ("eval/train_psnr".into(), "eval/gap".into()));
        assert_eq!((of("gain.t"), of("loss_coarse")), ("train/gain/t".into(), "train/loss_coarse".into()));
        // Over every fourth pixel the number differs from that of complete views, which has `eval/psnr`.
        assert_eq!((tag("test_psnr", 4), tag("psnr", 4)), ("eval_sparse/psnr".into(), "train/psnr".into()));
    }

    #[test]
    fn settings_are_those_that_tell_runs_apart() {
        let mut config = Config::default();
        config.train.rays += 1;
        let names: Vec<String> = settings(&config).into_iter().map(|(name, _)| name).collect();
        assert_eq!(names, ["method", "data.name", "seed", "train.steps", "train.rays"]);
    }
}
