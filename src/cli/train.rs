//! `augnerf train` and `augnerf resume`.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use candle_core::{DType, Device};
use clap::Args;

use crate::config::Config;
use crate::data::{Image, Scene};
use crate::error::{Error, Result};
use crate::evaluate::{Protocol, Report, Viewer};
use crate::metrics::{Lpips, MeanMetrics};
use crate::model::Model;
use crate::output::{Host, RunDir, Timing, host, peak_memory_mib, write_atomic};
use crate::train::{
    AttackSummary, EVALUATION_COLUMNS, Observer, Outcome, Session, StepStats, Trainer, checkpoint, interrupted,
};

use super::eval::{self, load_lpips};
use super::experiment::{Experiment, load_scene};
use super::progress::{Screen, TrainingBar, print};
use super::render::Pictures;
use super::{Machine, Sources};

#[derive(Args)]
pub struct TrainArguments {
    #[command(flatten)]
    experiment: Experiment,
    /// Run folder [default: runs/SCENE-METHOD-HASH]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Replace the run that the folder holds
    #[arg(long)]
    overwrite: bool,
    /// Print the resolved configuration and stop
    #[arg(long)]
    print_config: bool,
    #[command(flatten)]
    machine: Machine,
}

#[derive(Args)]
pub struct ResumeArguments {
    /// Run folder
    run: PathBuf,
    #[command(flatten)]
    sources: Sources,
    #[command(flatten)]
    machine: Machine,
}

impl TrainArguments {
    pub fn run(self) -> Result<()> {
        let device = self.machine.device()?;
        let screen = Screen::new(self.machine.quiet);
        let mut config = self.experiment.config()?;
        let lpips = load_lpips(&config.eval.lpips_weights, &device)?;
        let scene = load_scene(&mut config, &screen)?;
        if self.print_config {
            print(config.to_toml().trim_end());
            return Ok(());
        }
        let folder = self.out.clone().unwrap_or_else(|| default_folder(&config));
        // Whatever can be refused is refused before --overwrite deletes anything.
        let trainer = Trainer::new(&config, &scene, DType::F32, &device)?;
        let needed = bytes_needed(&config, &scene);
        let run = RunDir::create(&folder, self.overwrite, needed)?;
        run.check_writable(needed)?;
        write_atomic(&run.config(), config.to_toml().as_bytes())?;
        let device_name = self.machine.device.unwrap_or_else(|| "cpu".into());
        let quiet = self.machine.quiet;
        Job { run, config, scene, lpips, device, device_name, quiet, screen, earlier: None, resumed: false }
            .train(trainer)
    }
}

impl ResumeArguments {
    pub fn run(self) -> Result<()> {
        let screen = Screen::new(self.machine.quiet);
        let mut run = RunDir::open(&self.run)?;
        run.lock()?;
        run.clean()?;
        let mut config = eval::run_config(&run)?;
        let earlier = read_timing(&run)?;
        let device_name = self.machine.device.clone();
        let device_name = device_name
            .or_else(|| earlier.as_ref().map(|timing| timing.device.clone()))
            .unwrap_or_else(|| "cpu".into());
        let device = self.machine.device_or(&device_name)?;
        if let Some(dir) = &self.sources.data {
            config.data.dir = dir.to_string_lossy().into_owned();
        }
        config.eval.lpips_weights = self.sources.weights.or(&config);
        let lpips = load_lpips(&config.eval.lpips_weights, &device)?;
        let scene = load_scene(&mut config, &screen)?;
        run.check_writable(bytes_needed(&config, &scene))?;
        // Where scene and weights are now, for the next time.
        write_atomic(&run.config(), config.to_toml().as_bytes())?;
        let trainer = match checkpoint::list(&run.checkpoints())?.pop() {
            Some((_, newest)) => Trainer::resume(&newest, &config, &scene, DType::F32, &device)?,
            // Killed before its first checkpoint: step 0 is a function of the configuration.
            None => Trainer::new(&config, &scene, DType::F32, &device)?,
        };
        screen.say(&format!("{} goes on at step {}", self.run.display(), trainer.step_count()));
        let quiet = self.machine.quiet;
        Job { run, config, scene, lpips, device, device_name, quiet, screen, earlier, resumed: true }.train(trainer)
    }
}

fn default_folder(config: &Config) -> PathBuf {
    let terms = config.regularizer.kind.iter().map(|term| format!("-{}", term.name()));
    let method = std::iter::once(config.method.name().to_string()).chain(terms).collect::<String>();
    Path::new("runs").join(format!("{}-{method}-{}", config.data.name, config.hash()))
}

/// A generous estimate of what a run writes: checkpoints, logs, pictures.
fn bytes_needed(config: &Config, scene: &Scene) -> u64 {
    let parameters: usize =
        Model::parameter_names(config).iter().map(|(_, shape)| shape.iter().product::<usize>()).sum();
    let checkpoints = parameters * 3 * 4 * (config.train.keep_checkpoints + 1);
    let pixels = scene.test.first().map_or(0, |view| view.camera.width * view.camera.height);
    let pictures = config.eval.pictures.min(scene.test.len()) * pixels * 16;
    let logs = (config.train.steps / config.train.log_every) as usize * 1024;
    (checkpoints + pictures + logs + (1 << 20)) as u64
}

fn read_timing(run: &RunDir) -> Result<Option<Timing>> {
    let path = run.timing();
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(Error::unreadable(&path, &error)),
    };
    let damaged = |error| Error::Checkpoint(format!("cannot read {}: {error}; delete it to go on", path.display()));
    serde_json::from_slice(&bytes).map(Some).map_err(damaged)
}

/// Everything that a training needs once its settings are known.
struct Job {
    run: RunDir,
    config: Config,
    scene: Scene,
    lpips: Vec<Lpips>,
    device: Device,
    device_name: String,
    quiet: bool,
    screen: Screen,
    /// Timing of the sessions before this one.
    earlier: Option<Timing>,
    /// The run was begun by an earlier session.
    resumed: bool,
}

impl Job {
    fn train(self, trainer: Trainer) -> Result<()> {
        let started_unix = host::unix_seconds() as u64;
        for (role, redraws) in Model::roles(&self.config).iter().zip(trainer.redraws()) {
            if *redraws > 0 && trainer.step_count() == 0 {
                let share = self.config.train.dead_start_share;
                self.screen.say(&format!(
                    "the {role} field started dead (under {share} of densities positive) and was drawn again {redraws} x"
                ));
            }
        }
        let signal = catch_signals()?;
        let first = trainer.step_count();
        let mut watcher = Watcher {
            bar: TrainingBar::new(self.quiet, first, self.config.train.steps, self.config.train.rays),
            job: &self,
            started_unix,
            seconds_evaluation: 0.0,
        };
        let mut session = Session::new(&self.run, trainer, self.resumed)?;
        let outcome = session.run(&signal, &mut watcher);
        watcher.bar.finish();
        if let Outcome::Stopped { signal } = outcome? {
            return Err(interrupted(signal, session.trainer().step_count(), self.run.path()));
        }
        let evaluating = Instant::now();
        let (report, picture) = self.evaluate(session.trainer(), &signal)?;
        if let Some(picture) = picture {
            session.picture("view", &picture)?;
        }
        let seconds = evaluating.elapsed().as_secs_f64() + watcher.seconds_evaluation;
        self.timing(session.trainer().step_count(), session.seconds(), seconds, started_unix)
            .write(&self.run.timing())?;
        self.summarise(&report, session.seconds());
        Ok(())
    }

    fn viewer<'a>(&'a self, trainer: &'a Trainer) -> Viewer<'a> {
        Viewer { model: trainer.model(), config: &self.config, scene: &self.scene, device: &self.device }
    }

    /// Measures every held-out view; returns the first one's picture, too, where pictures are made.
    fn evaluate(&self, trainer: &Trainer, signal: &AtomicUsize) -> Result<(Report, Option<Image>)> {
        let attack = AttackSummary::read(&self.run.scalars(), trainer.step_count())?;
        let renders = self.run.renders();
        let pictures = Pictures::new(&renders, &self.scene, self.config.eval.pictures);
        let mut picture = None;
        let views = self.viewer(trainer).evaluate(&self.lpips, &self.screen, |index, view, rendered| {
            let beside = pictures.write(index, view, rendered)?;
            picture = picture.take().or(beside);
            match signal.load(Ordering::SeqCst) {
                0 => Ok(()),
                signal => Err(interrupted(signal as i32, trainer.step_count(), self.run.path())),
            }
        })?;
        pictures.finish()?;
        let report = Report {
            mean: MeanMetrics::from_views(&views),
            views,
            protocol: Protocol::new(&self.config, &self.scene, trainer.step_count(), trainer.redraws()),
            attack,
        };
        report.write(&self.run.metrics_json(), &self.run.metrics_csv())?;
        Ok((report, picture))
    }

    fn timing(&self, step: u64, training: f64, evaluation: f64, started_unix: u64) -> Timing {
        let earlier = |get: fn(&Timing) -> f64| self.earlier.as_ref().map_or(0.0, get);
        let training = training + earlier(|timing| timing.seconds_training);
        Timing {
            seconds_training: training,
            seconds_evaluation: evaluation + earlier(|timing| timing.seconds_evaluation),
            rays_per_second: (training > 0.0).then(|| step as f64 * self.config.train.rays as f64 / training),
            peak_memory_mib: peak_memory_mib(),
            device: self.device_name.clone(),
            threads: rayon::current_num_threads(),
            host: Host::current(),
            started_unix,
            finished_unix: host::unix_seconds() as u64,
            sessions: self.earlier.as_ref().map_or(usize::from(self.resumed), |timing| timing.sessions) + 1,
        }
    }

    fn summarise(&self, report: &Report, seconds: f64) {
        let mean = &report.mean;
        let number = |value: Option<f64>, digits: usize| value.map_or("-".into(), |value| format!("{value:.digits$}"));
        self.screen.say(&format!(
            "{} held-out views: PSNR {} dB  SSIM {}  LPIPS(squeeze) {}  ({} steps, {seconds:.0} s)",
            self.scene.test.len(),
            number(mean.psnr, 2),
            number(mean.ssim, 3),
            number(mean.lpips_squeeze, 3),
            self.config.train.steps,
        ));
        let inactive: Vec<&str> =
            report.attack.iter().filter(|level| level.inactive).map(|level| level.level).collect();
        if !inactive.is_empty() {
            self.screen.say(&format!("inactive levels (no effect on the loss): {}", inactive.join(", ")));
        }
        self.screen.say(&format!("results: {}", self.run.path().display()));
    }
}

/// Draws training, evaluates in between, keeps `timing.json` current.
struct Watcher<'a> {
    bar: TrainingBar,
    job: &'a Job,
    started_unix: u64,
    /// Seconds spent on evaluations during training.
    seconds_evaluation: f64,
}

impl Observer for Watcher<'_> {
    fn stepped(&mut self, stats: &StepStats) {
        self.bar.stepped(stats.step, stats.loss, stats.psnr());
    }

    fn evaluate(&mut self, trainer: &Trainer) -> Result<Vec<(&'static str, f64)>> {
        let started = Instant::now();
        let views = self.job.viewer(trainer).evaluate(&[], &(), |_, _, _| Ok(()))?;
        self.seconds_evaluation += started.elapsed().as_secs_f64();
        let mean = MeanMetrics::from_views(&views);
        let step = trainer.step_count();
        if let Some(psnr) = mean.psnr {
            self.bar.say(&format!("step {step}: held-out PSNR {psnr:.2} dB"));
        }
        let values = EVALUATION_COLUMNS.into_iter().zip([mean.psnr, mean.psnr_float]);
        Ok(values.filter_map(|(name, value)| value.map(|value| (name, value))).collect())
    }

    fn saved(&mut self, step: u64, seconds: f64) -> Result<()> {
        self.job.timing(step, seconds, self.seconds_evaluation, self.started_unix).write(&self.job.run.timing())
    }
}

/// A flag that the first Ctrl-C or SIGTERM sets; the second one ends the program at once.
fn catch_signals() -> Result<Arc<AtomicUsize>> {
    use signal_hook::consts::{SIGINT, SIGTERM};
    let flag = Arc::new(AtomicUsize::new(0));
    let asked = Arc::new(std::sync::atomic::AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        let failed = |e: std::io::Error| Error::Output(format!("cannot catch signal {signal}: {e}"));
        signal_hook::flag::register_conditional_shutdown(signal, 128 + signal, asked.clone()).map_err(failed)?;
        signal_hook::flag::register_usize(signal, flag.clone(), signal as usize).map_err(failed)?;
        signal_hook::flag::register(signal, asked.clone()).map_err(failed)?;
    }
    Ok(flag)
}
