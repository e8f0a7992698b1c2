//! One training from its settings to its results, in a run folder of its own.
//!
//! The command line runs one job, a sweep runs many. This module knows neither the screen nor the folders of sweeps.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use candle_core::DType;

use crate::base::files::write_atomic;
use crate::base::{Error, Event, Listener, Result};
use crate::data::Scene;
use crate::field::forget_buffers;
use crate::methods::{LogColumns, Term};
use crate::metrics::Lpips;
use crate::model::Model;
use crate::runtime::{Host, MemoryWatch, Runtime, Timing, host};
use crate::settings::{Config, Regularizer, Resolved};
use crate::train::{Origin, Trainer, checkpoint};

use super::scene_file::RecordedScene;
use super::session::{Session, write_head};
use super::{Existing, Measurement, Pictures, Report, RunDir, Viewer, scene_file, surface_reference};

/// The inputs of a training.
pub struct Setup<'a> {
    /// The settings, resolved with the scene ([`load_scene`](super::load_scene)).
    pub config: Resolved,
    /// The views to train on and to measure at the end.
    pub scene: &'a Scene,
    /// LPIPS networks; without any, the LPIPS columns stay empty.
    pub lpips: &'a [Lpips],
    /// Runtime of the computation.
    pub runtime: Runtime,
}

/// A training that is ready to start or resume.
///
/// ```
/// # mod augnerf { pub use augnerf_base as base; pub use {augnerf_measure::metrics, augnerf_nerf::*}; pub use augnerf_run::*; pub use candle_core; }
/// use std::sync::atomic::AtomicUsize;
///
/// use augnerf::metrics::PSNR;
/// use augnerf::run::{Existing, Job, Setup, load_scene};
/// use augnerf::runtime::Runtime;
/// use augnerf::settings::{Preset, build};
/// # use augnerf::settings::parse_assignment;
/// # let folder = tempfile::tempdir().unwrap();
/// # let folder = folder.path().join("run");
/// # let small = ["data.width=16", "field.width=16", "train.rays=64", "train.steps=4"];
/// # let small = small.map(|text| parse_assignment(text).unwrap());
/// # let set = small;
///
/// let (config, scene) = load_scene(build(Some(Preset::Smoke), None, &set)?, &())?;
/// let setup = Setup { config, scene: &scene, lpips: &[], runtime: Runtime::new("cpu", None)? };
/// // A signal's number in the flag makes it write a checkpoint and stop.
/// let finished = Job::create(&folder, Existing::Refuse, setup)?.train(&(), &AtomicUsize::new(0))?;
/// assert!(finished.report.mean.get(&PSNR).is_some());
/// assert!(folder.join("metrics.json").is_file());
/// # Ok::<(), augnerf::base::Error>(())
/// ```
pub struct Job<'a> {
    experiment: Experiment<'a>,
    trainer: Trainer,
}

/// A training in its folder: the parts of a job except the trainer, which the session takes.
pub(super) struct Experiment<'a> {
    pub(super) run: RunDir,
    pub(super) setup: Setup<'a>,
    earlier: Earlier,
    /// Problems found when the run was resumed.
    notes: Vec<String>,
    started_unix: u64,
    memory: MemoryWatch,
    /// Seconds of the shortest session that draws previews.
    pub(super) previews_from: Option<f64>,
}

/// The sessions before this one.
#[derive(Default)]
struct Earlier {
    /// Their number: 0 in a new run.
    sessions: usize,
    seconds_training: f64,
    seconds_evaluation: f64,
}

impl Earlier {
    /// Returns those of a resumed run. It has no timing if it was killed before its first checkpoint.
    fn of_resumed(timing: Option<Timing>) -> Earlier {
        timing.map_or(Earlier { sessions: 1, ..Earlier::default() }, |timing| Earlier {
            sessions: timing.sessions.max(1),
            seconds_training: timing.seconds_training,
            seconds_evaluation: timing.seconds_evaluation,
        })
    }
}

/// Results of a finished training, besides its files.
pub struct Finished {
    /// The metrics as written.
    pub report: Report,
    /// The evaluated model.
    pub model: Model,
    /// Completed steps, and all steps.
    pub steps: (u64, u64),
    /// Seconds spent on steps in this session.
    pub seconds: f64,
    /// Remarks on regularizers that outweigh the photometric loss in the last step.
    pub heavy_terms: Vec<String>,
}

/// A weighted regularizer that is this many times the photometric loss outweighs it.
const HEAVY: f64 = 10.0;

/// Returns a remark for each regularizer whose weighted value exceeds the photometric loss by far.
fn heavy_terms(config: &Config, columns: &LogColumns, terms: &[Term]) -> Vec<String> {
    let found = |name: &String| terms.iter().find(|term| term.name == *name);
    let photometric: f64 = columns.photometric.iter().filter_map(found).map(|term| term.value).sum();
    let times = |((term, _), column): ((Regularizer, f64), &String)| {
        let Term { value, weight, .. } = found(column)?;
        Some((term, *weight, weight * value / photometric))
    };
    let known = config.regularizer.terms().zip(&columns.further).filter_map(times);
    let heavy = known.filter(|(.., times)| *times > HEAVY);
    heavy
        .map(|(term, weight, times): (Regularizer, f64, f64)| {
            format!(
                "regularizer {}: weight {weight:e} x value is {times:.0} times the photometric loss in the last step; choose a \
                 smaller regularizer.weight, which `augnerf train --balance` measures",
                term.name()
            )
        })
        .collect()
}

/// Watches a run's memory from its start, without the buffers that an earlier run left on the threads.
pub fn watch_memory(runtime: &Runtime) -> MemoryWatch {
    runtime.on_every_thread(forget_buffers);
    MemoryWatch::begin()
}

impl Setup<'_> {
    fn trainer(&self) -> Result<Trainer> {
        Trainer::new(&self.config, self.scene, DType::F32, &self.runtime)
    }

    /// Estimates generously what a run writes: checkpoints, logs, images.
    fn bytes_needed(&self) -> u64 {
        let Setup { config, scene, .. } = self;
        let parameters: usize =
            Model::parameter_names(config).iter().map(|(_, shape)| shape.iter().product::<usize>()).sum();
        // The kept checkpoints, one before an evaluation, and the one being written.
        let checkpoints = parameters * 3 * 4 * (config.train.keep_checkpoints + 2);
        let pixels = scene.test.first().map_or(0, |view| view.camera.width * view.camera.height);
        let pictures = config.eval.pictures.min(scene.test.len()) * pixels * 16;
        let logs = ((config.train.steps / config.train.log_every) as usize).saturating_mul(1024);
        logs.saturating_add(checkpoints + pictures + (1 << 20)) as u64
    }
}

impl<'a> Job<'a> {
    /// Creates a run in `folder`. All checks come before anything is deleted.
    ///
    /// # Errors
    /// The folder holds a run that may not be replaced, or anything else, or cannot be written; the disk has too
    /// little space; settings contradict the scene; every initialization of a field is dead.
    pub fn create(folder: &Path, existing: Existing, setup: Setup<'a>) -> Result<Job<'a>> {
        let memory = watch_memory(&setup.runtime);
        surface_reference(&setup.config, setup.scene)?;
        let trainer = setup.trainer()?;
        let run = RunDir::create(folder, existing, setup.bytes_needed())?;
        Job::begin(run, setup, trainer, Earlier::default(), Vec::new(), memory)
    }

    /// Creates a run in `folder` that starts from existing weights. They become its first checkpoint.
    ///
    /// # Errors
    /// Those of [`Job::create`]; the weights are not of the settings' networks.
    pub fn create_from(folder: &Path, existing: Existing, setup: Setup<'a>, origin: Origin) -> Result<Job<'a>> {
        let memory = watch_memory(&setup.runtime);
        surface_reference(&setup.config, setup.scene)?;
        let trainer = Trainer::begin_from(origin, &setup.config, setup.scene, DType::F32, &setup.runtime)?;
        let run = RunDir::create(folder, existing, setup.bytes_needed())?;
        let job = Job::begin(run, setup, trainer, Earlier::default(), Vec::new(), memory)?;
        write_head(&job.experiment.run, &job.trainer)?;
        job.trainer.save(&job.experiment.run.checkpoints())?;
        Ok(job)
    }

    /// Resumes a locked run ([`RunDir::take`]) at its newest intact checkpoint, or at its start. The settings are the
    /// run's own, resolved with the scene at its current path ([`load_scene_of`](super::load_scene_of)). Damaged
    /// checkpoints are reported in notes at the start of training.
    ///
    /// # Errors
    /// The scene has changed since the run started; a checkpoint has other settings, or none is intact; the folder
    /// cannot be written; the disk has too little space.
    pub fn resume(run: RunDir, setup: Setup<'a>) -> Result<Job<'a>> {
        let memory = watch_memory(&setup.runtime);
        surface_reference(&setup.config, setup.scene)?;
        RecordedScene::of(&run)?.check(setup.scene, &setup.config.data, true)?;
        let earlier = Earlier::of_resumed(run.read_timing()?);
        let (newest, notes) = checkpoint::newest_whole(&run.checkpoints())?;
        let trainer = match newest {
            Some(newest) => {
                let trainer = Trainer::resume(&newest, &setup.config, setup.scene, DType::F32, &setup.runtime)?;
                // A kill may have come between the newest checkpoint and the deletion of the one that it replaces.
                trainer.save(&run.checkpoints())?;
                trainer
            }
            // Killed before its first checkpoint: step 0 is a function of the configuration.
            None => setup.trainer()?,
        };
        Job::begin(run, setup, trainer, earlier, notes, memory)
    }

    /// Starts a session.
    fn begin(
        run: RunDir,
        setup: Setup<'a>,
        trainer: Trainer,
        earlier: Earlier,
        notes: Vec<String>,
        memory: MemoryWatch,
    ) -> Result<Job<'a>> {
        run.check_writable(setup.bytes_needed())?;
        // A resumed run records the current paths of scene and weights for the next time.
        write_atomic(&run.config(), setup.config.to_toml().as_bytes())?;
        scene_file::write(&run.scene_file(), setup.scene)?;
        let started_unix = host::unix_seconds() as u64;
        let experiment = Experiment { run, setup, earlier, notes, started_unix, memory, previews_from: None };
        Ok(Job { experiment, trainer })
    }

    /// Draws the first held-out view beside its ground truth as training goes on, into `renders/preview.png`, unless
    /// `eval.pictures` is 0 or this session takes less than `shortest` seconds. All pictures together take about 3 % of
    /// its time. The evaluation's images replace it.
    pub fn with_previews(mut self, shortest: f64) -> Job<'a> {
        self.experiment.previews_from = Some(shortest).filter(|_| self.experiment.setup.config.eval.pictures > 0);
        self
    }

    /// Returns the number of completed steps.
    pub fn step_count(&self) -> u64 {
        self.trainer.step_count()
    }

    /// Trains to the last step and evaluates.
    ///
    /// # Errors
    /// [`Error::Interrupted`](crate::base::Error::Interrupted), with a checkpoint, once `signal` holds a signal's
    /// number; [`Error::Diverged`](crate::base::Error::Diverged) if training diverges, or collapses and `train.collapse_steps` is
    /// not 0; files cannot be written.
    pub fn train(self, events: &dyn Listener, signal: &AtomicUsize) -> Result<Finished> {
        let Job { experiment, trainer } = self;
        let runtime = experiment.setup.runtime.clone();
        runtime.install(|| experiment.train(trainer, events, signal))
    }
}

impl Experiment<'_> {
    fn train(&self, mut trainer: Trainer, events: &dyn Listener, signal: &AtomicUsize) -> Result<Finished> {
        self.notes.iter().for_each(|note| events.on(Event::Note(note)));
        self.report_redraws(&trainer, events);
        let (first, config) = (trainer.step_count(), &self.setup.config);
        let (steps, rays) = (config.train.steps, config.rays_per_step());
        events.on(Event::TrainingStarted { first, steps, rays });
        let session = Session::run(self, &mut trainer, events, signal);
        events.on(Event::TrainingFinished);
        let Session { stepping, evaluating: between, last_terms, .. } = session?;
        let evaluating = Instant::now();
        let report = self.evaluate(&trainer, events, signal)?;
        self.timing(trainer.step_count(), stepping, between + evaluating.elapsed()).write(&self.run.timing())?;
        // Whoever switches the check of each step off wants the numbers of collapsed trainings, too.
        if self.setup.config.train.collapse_steps > 0 {
            report.check_learned(self.run.path())?;
        }
        let steps = (trainer.step_count(), self.setup.config.train.steps);
        let heavy_terms = heavy_terms(&self.setup.config, &trainer.columns(), &last_terms);
        let seconds = stepping.as_secs_f64();
        Ok(Finished { report, model: trainer.model()?.clone(), steps, seconds, heavy_terms })
    }

    fn report_redraws(&self, trainer: &Trainer, events: &dyn Listener) {
        let config = &self.setup.config;
        for (role, redraws) in Model::parts(config).iter().zip(trainer.redraws()) {
            if *redraws > 0 && trainer.step_count() == 0 {
                let percent = (1e5 * config.train.dead_start_share).round() / 1e3;
                let often = if *redraws == 1 { "once".into() } else { format!("{redraws} times") };
                events.on(Event::Note(&format!(
                    "initialized the {role} network anew {often}, because under {percent} % of its densities were positive"
                )));
            }
        }
    }

    pub(super) fn viewer<'a>(&'a self, trainer: &'a Trainer) -> Result<Viewer<'a>> {
        let Setup { config, scene, runtime, .. } = &self.setup;
        Ok(Viewer { model: trainer.model()?, config, scene, runtime })
    }

    /// Returns an error once there is a signal; the run's newest checkpoint is of `step`.
    pub(super) fn check_signal(&self, signal: &AtomicUsize, step: u64) -> Result<()> {
        let signal = match signal.load(Ordering::SeqCst) {
            0 => return Ok(()),
            signal => signal as i32,
        };
        let message = format!(
            "stopped by signal {signal} at step {step}; nothing is lost: `augnerf resume {}` continues from there",
            self.run.path().display()
        );
        Err(Error::Interrupted { signal, message })
    }

    /// Measures every held-out view and some training views.
    fn evaluate(&self, trainer: &Trainer, events: &dyn Listener, signal: &AtomicUsize) -> Result<Report> {
        let (viewer, state) = (self.viewer(trainer)?, trainer.state());
        let renders = RunDir::renders_in(self.run.path());
        let pictures = Pictures::new(&renders, self.setup.scene, self.setup.config.eval.pictures);
        let (run, folder, lpips) = (&self.run, self.run.path(), self.setup.lpips);
        let measurement = Measurement { run, folder, viewer, state: &state, lpips, events, split: None };
        let report = measurement.write(
            || self.check_signal(signal, trainer.step_count()),
            |index, view, rendered| pictures.write(index, view, rendered),
        )?;
        pictures.finish()?;
        Ok(report)
    }

    pub(super) fn timing(&self, step: u64, training: Duration, evaluation: Duration) -> Timing {
        let Setup { config, runtime, .. } = &self.setup;
        let training = training.as_secs_f64() + self.earlier.seconds_training;
        Timing {
            seconds_training: training,
            seconds_evaluation: evaluation.as_secs_f64() + self.earlier.seconds_evaluation,
            rays_per_second: (training > 0.0).then(|| config.rays_of_steps(step) / training),
            peak_memory_mib: self.memory.peak_mib().filter(|_| runtime.is_alone()),
            device: runtime.name().to_string(),
            threads: runtime.threads(),
            host: Host::current(),
            started_unix: self.started_unix,
            finished_unix: host::unix_seconds() as u64,
            sessions: self.earlier.sessions.saturating_add(1),
        }
    }
}
