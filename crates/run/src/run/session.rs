//! The training loop: steps, logs, checkpoints, stops.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::base::{Error, Event, Listener, Result};
use crate::methods::{LogColumns, Term};
use crate::metrics::{MeanMetrics, Metric, PSNR, PSNR_FLOAT};
use crate::train::{StepStats, Trainer};

use super::job::{Experiment, Setup};
use super::preview::{self, Preview};
use super::{Pictures, RunDir, Scalars};

/// Columns of an evaluation during training.
const EVALUATION_COLUMNS: [&str; 2] = ["test_psnr", "test_psnr_float"];

/// Columns that it fills if it also measures training views.
const TRAINING_VIEW_COLUMNS: [&str; 2] = ["train_psnr", "gap"];

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

/// A process's part of a training: its steps, and what is written and told of them.
pub(super) struct Session<'a> {
    experiment: &'a Experiment<'a>,
    events: &'a dyn Listener,
    signal: &'a AtomicUsize,
    scalars: Scalars,
    preview: Option<Preview>,
    /// Time spent on steps, without logs and evaluations.
    pub stepping: Duration,
    /// Time spent on evaluations and previews between steps.
    pub evaluating: Duration,
    /// The terms of the loss in the last step; none if it took no step.
    pub last_terms: Vec<Term>,
}

impl<'a> Session<'a> {
    /// Trains in the experiment's folder from the trainer's step, 0 or that of a checkpoint, to the last one.
    ///
    /// # Errors
    /// [`Error::Interrupted`], with a checkpoint, once `signal` holds a signal's number, which also interrupts a long step.
    /// Those of [`Trainer::step`], of evaluations, logs and checkpoints.
    pub fn run(
        experiment: &'a Experiment,
        trainer: &mut Trainer,
        events: &'a dyn Listener,
        signal: &'a AtomicUsize,
    ) -> Result<Session<'a>> {
        let (first, columns) = (trainer.step_count(), columns(trainer));
        let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
        let steps = (first, trainer.config().train.steps);
        let mut session = Session {
            experiment,
            events,
            signal,
            scalars: Scalars::resume(&experiment.run.scalars(), &columns, first)?,
            preview: experiment.previews_from.map(|shortest| Preview::new(steps, shortest)),
            stepping: Duration::ZERO,
            evaluating: Duration::ZERO,
            last_terms: Vec::new(),
        };
        session.train(trainer).map(|()| session)
    }

    /// Takes the steps. Writes checkpoints every N steps, every T minutes, before an evaluated step, at a stop and at the
    /// end.
    fn train(&mut self, trainer: &mut Trainer) -> Result<()> {
        let (experiment, signal, train) = (self.experiment, self.signal, trainer.config().train.clone());
        let mut saved_at = Instant::now();
        // The session starts from a checkpoint, or from step 0, which is a function of the configuration.
        let mut saved_step = trainer.step_count();
        while trainer.step_count() < train.steps {
            let next = trainer.step_count() + 1;
            let last = next == train.steps;
            let log = next.is_multiple_of(train.log_every) || last;
            // Only 0 is a multiple of 0, which means "never" here. The last step's evaluation is the run's.
            let evaluate = next.is_multiple_of(train.eval_every) && !last;
            if evaluate && saved_step != next - 1 {
                // A step's row is written once, with its evaluation. After a stop there, the step is repeated.
                self.save(trainer)?;
                (saved_at, saved_step) = (Instant::now(), next - 1);
            }
            let started = Instant::now();
            let stop_check = || experiment.check_signal(signal, next - 1);
            let stats = match trainer.step_unless(log, log || evaluate, &stop_check) {
                Err(stopped @ Error::Interrupted { .. }) => {
                    // A stop within the step, which is repeated.
                    self.save(trainer)?;
                    return Err(stopped);
                }
                stats => stats?,
            };
            self.stepping += started.elapsed();
            if let (Some(stats), true) = (&stats, log || evaluate) {
                self.log(trainer, stats, evaluate)?;
            }
            self.measured(stats);
            self.draw_preview(trainer)?;
            let by_step = next.is_multiple_of(train.checkpoint_every);
            let minutes = saved_at.elapsed().as_secs_f64() / 60.0;
            let by_time = train.checkpoint_minutes > 0.0 && minutes >= train.checkpoint_minutes;
            let is_stopped = signal.load(Ordering::SeqCst) != 0;
            if by_step || by_time || last || is_stopped {
                self.save(trainer)?;
                (saved_at, saved_step) = (Instant::now(), next);
            }
            if is_stopped && !last {
                experiment.check_signal(signal, next)?;
            }
        }
        Ok(())
    }

    fn log(&mut self, trainer: &Trainer, stats: &StepStats, evaluate: bool) -> Result<()> {
        let mut values = values(stats);
        if evaluate {
            values.extend(self.evaluate(trainer)?);
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

    /// Writes a checkpoint, and keeps `timing.json` current.
    fn save(&mut self, trainer: &mut Trainer) -> Result<()> {
        let started = Instant::now();
        let stats = trainer.catch_up()?;
        self.stepping += started.elapsed();
        self.measured(stats);
        self.scalars.sync()?;
        let run = &self.experiment.run;
        trainer.save(&run.checkpoints())?;
        self.experiment.timing(trainer.step_count(), self.stepping, self.evaluating).write(&run.timing())
    }

    /// Evaluates between steps; returns scalars to log. The run resumes from the step before the trainer's, so a signal
    /// may end the evaluation.
    fn evaluate(&mut self, trainer: &Trainer) -> Result<Vec<(String, f64)>> {
        let started = Instant::now();
        let step = trainer.step_count();
        let stop_check = || self.experiment.check_signal(self.signal, step - 1);
        let viewer = self.experiment.viewer(trainer)?;
        let [views, seen] = viewer.evaluate_sparsely(trainer.config().train.eval_stride, stop_check)?;
        self.evaluating += started.elapsed();
        let mut mean = MeanMetrics::from_views(&views);
        mean.set_train(&seen);
        if let Some(psnr) = mean.get(&PSNR) {
            let seen = mean.get(PSNR.train()).map_or(String::new(), |seen| format!(", of training views {seen:.2} dB"));
            self.events.on(Event::Note(&format!("step {step}: held-out PSNR {psnr:.2} dB{seen}")));
        }
        let metrics: [&Metric; 4] = [&PSNR, &PSNR_FLOAT, PSNR.train(), PSNR.gap()];
        let columns = EVALUATION_COLUMNS.into_iter().chain(TRAINING_VIEW_COLUMNS).zip(metrics);
        Ok(columns.filter_map(|(name, metric)| Some((name.to_string(), mean.get(metric)?))).collect())
    }

    /// Draws the first held-out view, and says where the session's first picture is. An error of a picture ends the
    /// pictures, not the training.
    fn draw_preview(&mut self, trainer: &Trainer) -> Result<()> {
        let Some(preview) = &mut self.preview else { return Ok(()) };
        let Some(allowance) = preview.allowance(trainer.step_count()) else { return Ok(()) };
        let started = Instant::now();
        let (Setup { scene, config, .. }, step) = (&self.experiment.setup, trainer.step_count());
        let renders = RunDir::renders_in(self.experiment.run.path());
        let pictures = Pictures::new(&renders, scene, config.eval.pictures);
        let viewer = self.experiment.viewer(trainer)?;
        let stop_check = &mut || self.experiment.check_signal(self.signal, step);
        let drawn = preview::draw(&viewer, &pictures, allowance, stop_check);
        let (is_first, spent) = (preview.spent == 0.0, started.elapsed());
        preview.spent += spent.as_secs_f64();
        match drawn {
            Ok(true) if is_first => self.events.on(Event::Note(&format!(
                "step {step}: the first preview is {}; at the end, the evaluation writes {} in its place",
                pictures.preview_path().display(),
                renders.join(format!("{}_beside.png", scene.test[0].name)).display()
            ))),
            // The session stops after this step.
            Ok(_) | Err(Error::Interrupted { .. }) => {}
            Err(error) => {
                self.preview = None;
                self.events.on(Event::Note(&format!("no picture of the unfinished training: {error}")));
            }
        }
        self.evaluating += spent;
        Ok(())
    }
}
