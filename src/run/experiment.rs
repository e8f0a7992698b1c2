//! One experiment from its settings to its results: scene, run folder, training, evaluation.
//!
//! The command line runs one, a sweep runs many; neither the other's screen nor its folders are
//! known here.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use candle_core::{DType, Device};

use crate::base::files::write_atomic;
use crate::base::{Error, Image, Progress, Result};
use crate::data::{self, Scene};
use crate::methods::{AttackSummary, Model};
use crate::metrics::{Backbone, Lpips, MeanMetrics};
use crate::run::{
    BUILTIN, EVALUATION_COLUMNS, Observer, Outcome, Pictures, Protocol, Report, RunDir, Session, Viewer, interrupted,
    surface_reference,
};
use crate::runtime::{Host, Timing, host, peak_memory_mib};
use crate::settings::{Config, Located, Resolved, scene_name};
use crate::train::{StepStats, Trainer, checkpoint};

/// Who is told how an experiment goes.
pub trait Reporter: Sync {
    /// A line worth reading.
    fn say(&self, line: &str);
    /// Training goes from step `first` to `total`, `rays` rays each.
    fn begin(&self, first: u64, total: u64, rays: usize);
    /// A step is done. Called for every step.
    fn stepped(&self, stats: &StepStats);
    /// No more steps follow.
    fn trained(&self);
    /// Draws loading and evaluation.
    fn progress(&self) -> &dyn Progress;
}

/// Where an experiment is computed.
#[derive(Clone)]
pub struct Machine {
    /// The device.
    pub device: Device,
    /// What the user called it.
    pub name: String,
}

/// A training that is ready to start or to go on.
pub struct Job<'a> {
    desk: Desk<'a>,
    trainer: Trainer,
}

/// Everything of a job but the trainer, which the session takes.
struct Desk<'a> {
    run: RunDir,
    config: Resolved,
    scene: &'a Scene,
    lpips: &'a [Lpips],
    machine: Machine,
    /// Timing of the sessions before this one.
    earlier: Option<Timing>,
    /// The run was begun by an earlier session.
    resumed: bool,
    started_unix: u64,
}

/// What a finished experiment gives besides its files.
pub struct Finished {
    /// The metrics as written.
    pub report: Report,
    /// The networks.
    pub model: Model,
    /// Seconds spent on steps in this session.
    pub seconds: f64,
}

/// Finds the kind of scene and where it lies, and fills what depends on that.
pub fn locate_scene(mut config: Config) -> Result<Located> {
    let kind = data::detect(&config.data)?;
    if !config.data.dir.is_empty() {
        // Found again from any working directory; `.` gets its real name.
        let dir = Path::new(&config.data.dir);
        let dir = std::fs::canonicalize(dir).map_err(|e| Error::unreadable(dir, &e))?;
        config.data.dir = dir.to_string_lossy().into_owned();
    }
    let mesh = &mut config.eval.mesh;
    if mesh.resolution > 0 && !mesh.reference.is_empty() && mesh.reference != BUILTIN {
        let file = Path::new(&mesh.reference);
        let file = std::fs::canonicalize(file).map_err(|e| Error::unreadable(file, &e))?;
        mesh.reference = file.to_string_lossy().into_owned();
    }
    if config.data.name.is_empty() {
        config.data.name = scene_name(&config.data.dir);
    }
    config.locate(kind)
}

/// Locates and loads the scene of a configuration, which it resolves.
pub fn load_scene(config: Config, progress: &dyn Progress) -> Result<(Resolved, Scene)> {
    let located = locate_scene(config)?;
    let mut scene = data::load(&located.data, located.seed, progress)?;
    scene.name.clone_from(&located.data.name);
    Ok((located.resolve(scene.near, scene.far), scene))
}

/// The resolved configuration of a run.
pub fn run_config(run: &RunDir) -> Result<Config> {
    let path = run.config();
    let text = std::fs::read_to_string(&path)
        .map_err(|e| Error::Checkpoint(format!("cannot read {}: {e}", path.display())))?;
    Config::from_toml(&text, &path.display().to_string())
}

/// Every LPIPS backbone whose weights the folder holds; none for an empty name.
pub fn load_lpips(dir: &str, device: &Device) -> Result<Vec<Lpips>> {
    if dir.is_empty() {
        return Ok(Vec::new());
    }
    let dir = Path::new(dir);
    let found = Lpips::available(dir)?;
    if found.is_empty() {
        let names: Vec<&str> = Backbone::ALL.iter().map(|backbone| backbone.name()).collect();
        return Err(Error::Data(format!(
            "--lpips-weights {}: no backbone ({}) is complete there; each needs its linear layers (NAME_lin_v0.1.pth) \
             and its features",
            dir.display(),
            names.join(", ")
        )));
    }
    let loaded = found.into_iter().map(|backbone| Lpips::load(dir, backbone, device)).collect::<Result<Vec<_>>>()?;
    Ok(loaded.into_iter().flatten().collect())
}

impl<'a> Job<'a> {
    /// A new run of a configuration in `folder`. What can be refused is refused before
    /// `overwrite` deletes anything.
    pub fn create(
        folder: &Path,
        overwrite: bool,
        config: Resolved,
        (scene, lpips): (&'a Scene, &'a [Lpips]),
        machine: Machine,
    ) -> Result<Job<'a>> {
        surface_reference(&config, scene)?;
        let trainer = Trainer::new(&config, scene, DType::F32, &machine.device)?;
        let needed = bytes_needed(&config, scene);
        let run = RunDir::create(folder, overwrite, needed)?;
        run.check_writable(needed)?;
        write_atomic(&run.config(), config.to_toml().as_bytes())?;
        let desk = Desk {
            run,
            config,
            scene,
            lpips,
            machine,
            earlier: None,
            resumed: false,
            started_unix: host::unix_seconds() as u64,
        };
        Ok(Job { desk, trainer })
    }

    /// The newest checkpoint of a locked run, or its start. `config` is the run's own, resolved
    /// with the scene where it lies now.
    pub fn resume(
        run: RunDir,
        config: Resolved,
        (scene, lpips): (&'a Scene, &'a [Lpips]),
        machine: Machine,
    ) -> Result<Job<'a>> {
        surface_reference(&config, scene)?;
        let earlier = read_timing(&run)?;
        run.check_writable(bytes_needed(&config, scene))?;
        // Where scene and weights are now, for the next time.
        write_atomic(&run.config(), config.to_toml().as_bytes())?;
        let trainer = match checkpoint::list(&run.checkpoints())?.pop() {
            Some((_, newest)) => Trainer::resume(&newest, &config, scene, DType::F32, &machine.device)?,
            // Killed before its first checkpoint: step 0 is a function of the configuration.
            None => Trainer::new(&config, scene, DType::F32, &machine.device)?,
        };
        let desk = Desk {
            run,
            config,
            scene,
            lpips,
            machine,
            earlier,
            resumed: true,
            started_unix: host::unix_seconds() as u64,
        };
        Ok(Job { desk, trainer })
    }

    /// Steps finished so far.
    pub fn step_count(&self) -> u64 {
        self.trainer.step_count()
    }

    /// Trains to the last step and evaluates. A signal stops it with a checkpoint and
    /// [`Error::Interrupted`].
    pub fn train(self, reporter: &dyn Reporter, signal: &AtomicUsize) -> Result<Finished> {
        let Job { desk, trainer } = self;
        desk.report_redraws(&trainer, reporter);
        reporter.begin(trainer.step_count(), desk.config.train.steps, desk.config.train.rays);
        let mut watcher = Watcher { desk: &desk, reporter, signal, seconds_evaluation: 0.0 };
        let mut session = Session::new(&desk.run, trainer, desk.resumed)?;
        let outcome = session.run(signal, &mut watcher);
        reporter.trained();
        if let Outcome::Stopped { signal } = outcome? {
            return Err(interrupted(signal, session.trainer().step_count(), desk.run.path()));
        }
        let evaluating = Instant::now();
        let (report, picture) = desk.evaluate(session.trainer(), reporter, signal)?;
        if let Some(picture) = picture {
            session.picture("view", &picture)?;
        }
        let seconds = evaluating.elapsed().as_secs_f64() + watcher.seconds_evaluation;
        desk.timing(session.trainer().step_count(), session.seconds(), seconds).write(&desk.run.timing())?;
        Ok(Finished { report, model: session.trainer().model().clone(), seconds: session.seconds() })
    }
}

/// A generous estimate of what a run writes: checkpoints, logs, pictures.
fn bytes_needed(config: &Config, scene: &Scene) -> u64 {
    let parameters: usize =
        Model::parameter_names(config).iter().map(|(_, shape)| shape.iter().product::<usize>()).sum();
    // Those that are kept, one more before an evaluation, and the one that is being written.
    let checkpoints = parameters * 3 * 4 * (config.train.keep_checkpoints + 2);
    let pixels = scene.test.first().map_or(0, |view| view.camera.width * view.camera.height);
    let pictures = config.eval.pictures.min(scene.test.len()) * pixels * 16;
    let logs = (config.train.steps / config.train.log_every) as usize * 1024;
    (checkpoints + pictures + logs + (1 << 20)) as u64
}

/// What earlier sessions of a run took; none before its first checkpoint.
pub fn read_timing(run: &RunDir) -> Result<Option<Timing>> {
    let path = run.timing();
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(Error::unreadable(&path, &error)),
    };
    let damaged = |error| Error::Checkpoint(format!("cannot read {}: {error}; delete it to go on", path.display()));
    serde_json::from_slice(&bytes).map(Some).map_err(damaged)
}

impl Desk<'_> {
    fn report_redraws(&self, trainer: &Trainer, reporter: &dyn Reporter) {
        for (role, redraws) in Model::roles(&self.config).iter().zip(trainer.redraws()) {
            if *redraws > 0 && trainer.step_count() == 0 {
                let share = self.config.train.dead_start_share;
                reporter.say(&format!(
                    "the {role} field started dead (under {share} of densities positive) and was drawn again {redraws} x"
                ));
            }
        }
    }

    fn viewer<'a>(&'a self, trainer: &'a Trainer) -> Viewer<'a> {
        Viewer { model: trainer.model(), config: &self.config, scene: self.scene, device: &self.machine.device }
    }

    /// Nothing, or the error of a run whose newest checkpoint is of `step`, once there is a signal.
    fn going(&self, signal: &AtomicUsize, step: u64) -> Result<()> {
        match signal.load(Ordering::SeqCst) {
            0 => Ok(()),
            signal => Err(interrupted(signal as i32, step, self.run.path())),
        }
    }

    /// Measures every held-out view; returns the first one's picture, too, where pictures are made.
    fn evaluate(
        &self,
        trainer: &Trainer,
        reporter: &dyn Reporter,
        signal: &AtomicUsize,
    ) -> Result<(Report, Option<Image>)> {
        let attack = AttackSummary::read(&self.run.scalars(), trainer.step_count())?;
        let renders = self.run.renders();
        let pictures = Pictures::new(&renders, self.scene, self.config.eval.pictures);
        let going = || self.going(signal, trainer.step_count());
        let mut picture = None;
        let views =
            self.viewer(trainer).evaluate(self.lpips, reporter.progress(), going, |index, view, rendered| {
                let beside = pictures.write(index, view, rendered)?;
                picture = picture.take().or(beside);
                Ok(())
            })?;
        pictures.finish()?;
        let surface = self.viewer(trainer).surface(reporter.progress(), |line| reporter.say(line), going)?;
        let protocol = Protocol::new(&self.config, self.scene, &trainer.state());
        let report = Report::new(views, surface, protocol, attack);
        report.write(&self.run.metrics_json(), &self.run.metrics_csv())?;
        Ok((report, picture))
    }

    fn timing(&self, step: u64, training: f64, evaluation: f64) -> Timing {
        let earlier = |get: fn(&Timing) -> f64| self.earlier.as_ref().map_or(0.0, get);
        let training = training + earlier(|timing| timing.seconds_training);
        Timing {
            seconds_training: training,
            seconds_evaluation: evaluation + earlier(|timing| timing.seconds_evaluation),
            rays_per_second: (training > 0.0).then(|| step as f64 * self.config.train.rays as f64 / training),
            peak_memory_mib: peak_memory_mib(),
            device: self.machine.name.clone(),
            threads: rayon::current_num_threads(),
            host: Host::current(),
            started_unix: self.started_unix,
            finished_unix: host::unix_seconds() as u64,
            sessions: self.earlier.as_ref().map_or(usize::from(self.resumed), |timing| timing.sessions) + 1,
        }
    }
}

/// Passes training on to the reporter, evaluates in between, keeps `timing.json` current.
struct Watcher<'a> {
    desk: &'a Desk<'a>,
    reporter: &'a dyn Reporter,
    signal: &'a AtomicUsize,
    /// Seconds spent on evaluations during training.
    seconds_evaluation: f64,
}

impl Observer for Watcher<'_> {
    fn stepped(&mut self, stats: &StepStats) {
        self.reporter.stepped(stats);
    }

    fn evaluate(&mut self, trainer: &Trainer) -> Result<Vec<(&'static str, f64)>> {
        let started = Instant::now();
        let saved = trainer.step_count() - 1;
        let going = || self.desk.going(self.signal, saved);
        let views = self.desk.viewer(trainer).evaluate(&[], &(), going, |_, _, _| Ok(()))?;
        self.seconds_evaluation += started.elapsed().as_secs_f64();
        let mean = MeanMetrics::from_views(&views);
        let step = trainer.step_count();
        if let Some(psnr) = mean.psnr {
            self.reporter.say(&format!("step {step}: held-out PSNR {psnr:.2} dB"));
        }
        let values = EVALUATION_COLUMNS.into_iter().zip([mean.psnr, mean.psnr_float]);
        Ok(values.filter_map(|(name, value)| value.map(|value| (name, value))).collect())
    }

    fn saved(&mut self, step: u64, seconds: f64) -> Result<()> {
        self.desk.timing(step, seconds, self.seconds_evaluation).write(&self.desk.run.timing())
    }
}
