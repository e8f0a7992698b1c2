//! Trains and measures points.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::AtomicUsize;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use candle_core::DType;

use crate::base::{Error, Event, Listener, Result};
use crate::data::corruption::corrupt;
use crate::data::{self, Scene};
use crate::metrics::Lpips;
use crate::report::{PointResult, label};
use crate::revision::revision;
use crate::run::{
    Existing, Finished, Job, Report, RunDir, SMOOTHNESS_SIDE, Setup, SmoothnessReport, Viewer, check_spacing, columns,
    locate_scene, smoothness_box, watch_memory,
};
use crate::runtime::{Host, Runtime};
use crate::settings::{Config, CorruptionConfig, CorruptionKind, DataConfig, Resolved, TrainConfig};
use crate::space::Lattice;
use crate::train::Trainer;

use super::claim::Progress;
use super::layout::Refused;
use super::point_folder::PointFolder;
use super::points::Point;
use super::runner::Work;
use super::step_seconds::{Clock, StepSeconds};

/// Protocol column that names the box over which `l1`, `tv` and related metrics are integrals.
const SMOOTHNESS_DOMAIN: &str = "smoothness_domain";
/// Most scenes that are named.
const NAMED: usize = 3;
/// Most scenes in memory; points come scene by scene.
const SCENES: usize = 2;
/// Seconds that each training is timed for if a budget depends on its steps. The timing starts at the initial weights
/// and ends with the training if that is shorter. Steps of fields become shorter as space empties, since points of no
/// density pass no gradient. On the chair, eight seconds of NeRF gave 64 ms a step, but its 3,000 steps took 44 ms
/// each. Steps of SRN, Neural Volumes and LLFF stayed as long as at the start.
const CALIBRATION: f64 = 100.0;
/// The same for an estimate that is only printed.
const ESTIMATE: f64 = 0.0;
/// Number of turns.
const TURNS: usize = 25;
/// Least steps a training.
const LEAST_STEPS: usize = 4;
/// Seconds after which an estimate needs no further step, however few there are.
const ENOUGH: f64 = 2.0;

/// The state that the trainings of a sweep share.
pub struct Trainings<'a> {
    /// The runtime that costs are measured with; it has all threads.
    pub runtime: Runtime,
    /// Backbones of LPIPS.
    pub lpips: Vec<Lpips>,
    /// Source of the LPIPS weights; recorded in each run's settings.
    pub lpips_weights: String,
    /// The sweep's metrics include smoothness.
    pub smoothness: bool,
    /// Receives progress of loading, training and measuring.
    pub events: &'a dyn Listener,
    scenes: Mutex<Vec<(String, Arc<Scene>)>>,
}

impl<'a> Trainings<'a> {
    /// Creates the state with no scene loaded.
    pub fn new(
        runtime: Runtime,
        (lpips, lpips_weights): (Vec<Lpips>, String),
        smoothness: bool,
        events: &'a dyn Listener,
    ) -> Trainings<'a> {
        Trainings { runtime, lpips, lpips_weights, smoothness, events, scenes: Mutex::default() }
    }

    /// Returns the scene of a configuration, and the configuration resolved by it.
    pub fn scene(&self, config: Config) -> Result<(Resolved, Arc<Scene>)> {
        let (config, scene) = self.clean_scene(config)?;
        let corruption = config.data.corruption;
        if !corruption.is_on() {
            return Ok((config, scene));
        }
        let mut corrupted = Scene::clone(&scene);
        corrupt(&mut corrupted, &corruption, config.seed)?;
        Ok((config, Arc::new(corrupted)))
    }

    /// Returns the same with the scene before any corruption.
    fn clean_scene(&self, config: Config) -> Result<(Resolved, Arc<Scene>)> {
        let config = locate_scene(config)?;
        let clean = DataConfig { corruption: CorruptionConfig::default(), ..config.data.clone() };
        let key = toml::to_string(&clean).expect("settings are plain data");
        let mut scenes = self.scenes.lock().unwrap_or_else(PoisonError::into_inner);
        let scene = match scenes.iter().position(|(known, _)| *known == key) {
            Some(index) => scenes[index].1.clone(),
            None => {
                let mut scene = data::load(&clean, 0, self.events)?;
                scene.name.clone_from(&config.data.name);
                if scenes.len() >= SCENES {
                    scenes.remove(0);
                }
                scenes.push((key, Arc::new(scene)));
                scenes[scenes.len() - 1].1.clone()
            }
        };
        drop(scenes);
        check_spacing(&config, &scene)?;
        let kind = config.data.kind;
        Ok((config.resolve(kind, scene.extent())?, scene))
    }

    /// Checks that points with data can start: settings that depend on each other or on the scene, such as the rays of a
    /// step. Configurations that differ by the seed alone are checked once. `refused` has the rows that already cannot.
    ///
    /// # Errors
    /// [`Error::Config`], for all rows that cannot. [`Error::Data`], if no scene can be read. If others can, it is
    /// said: its points fail, and no other is lost.
    pub fn check_points(&self, points: &[Point], mut refused: Refused) -> Result<()> {
        let mut configs = Vec::new();
        let mut known = BTreeSet::new();
        for point in points.iter().filter(|point| point.no_data.is_none()) {
            let mut config = point.config.clone();
            (config.seed, config.train.dead_start_share) = (0, 0.0);
            if known.insert((config.hash(), point.on_cpu)) {
                configs.push((point, config));
            }
        }
        let scenes: BTreeSet<&str> = configs.iter().map(|(point, _)| point.scene.as_str()).collect();
        if !configs.is_empty() {
            let scenes = match scenes.len() {
                many if many > NAMED => format!("{many} scenes"),
                _ => scenes.into_iter().collect::<Vec<_>>().join(", "),
            };
            let note = format!("checking {} configurations of {} points on {scenes}", configs.len(), points.len());
            self.events.on(Event::Note(&note));
        }
        let (mut readable, mut unreadable) = (false, BTreeMap::new());
        for (point, config) in configs {
            let rows: Vec<String> = point.places.iter().map(|place| label(&place.row, &place.axes)).collect();
            let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
            match refused.unless(self.check(config, point.on_cpu), &rows, &point.scene) {
                Ok(_) => readable = true,
                Err(error @ Error::Data(_)) => _ = unreadable.entry(point.scene.clone()).or_insert(error),
                Err(error) => self.events.on(Event::Note(&format!("{} cannot start here: {error}", point.cell()))),
            }
        }
        refused.check()?;
        for (scene, error) in unreadable {
            if !readable {
                return Err(error);
            }
            self.events.on(Event::Note(&format!("scene {scene} cannot be read, and its points will fail: {error}")));
        }
        Ok(())
    }

    /// Checks that a configuration can start on its device. Colours are none of the checks, so that images are not corrupted for
    /// them. The error says so if the processor could train the row.
    fn check(&self, config: Config, on_cpu: bool) -> Result<()> {
        let moved = config.data.corruption.kind == CorruptionKind::Poses;
        let (config, scene) = if moved { self.scene(config) } else { self.clean_scene(config) }?;
        let check = |runtime: &Runtime| Trainer::check(&config, &scene, DType::F32, runtime);
        check(&on_device(&self.runtime, on_cpu)).map_err(|error| match error {
            Error::Config(text) if !self.runtime.is_cpu() && check(&self.runtime.on_cpu()).is_ok() => {
                Error::Config(format!("{text}, or give the row device = \"cpu\" in the sweep's file"))
            }
            other => other,
        })
    }

    /// Returns a trainer at step 0, for measurements.
    fn trainer(&self, config: &Config, runtime: &Runtime) -> Result<(Trainer, Arc<Scene>, Resolved)> {
        let (config, scene) = self.scene(config.clone())?;
        Ok((Trainer::new(&config, &scene, DType::F32, runtime)?, scene, config))
    }
}

/// Returns the runtime of a point beside others on `runtime`.
fn on_device(runtime: &Runtime, on_cpu: bool) -> Runtime {
    if on_cpu { runtime.on_cpu() } else { runtime.clone() }
}

/// Cost of a point on this machine.
#[derive(Clone, Copy, Debug)]
pub struct Cost {
    /// Seconds of a training step.
    pub seconds_per_step: f64,
    /// Seconds of the evaluation at the end.
    pub seconds_evaluation: f64,
    /// Highest resident memory while measuring, or `None` if the system does not report it.
    pub peak_memory_mib: Option<f64>,
}

impl Cost {
    /// Returns the cost of a point whose steps and views take `ratio` times as long.
    pub(super) fn scaled(self, ratio: f64) -> Cost {
        let ratio = if ratio.is_finite() && ratio > 0.0 { ratio } else { 1.0 };
        Cost {
            seconds_per_step: ratio * self.seconds_per_step,
            seconds_evaluation: ratio * self.seconds_evaluation,
            peak_memory_mib: self.peak_memory_mib,
        }
    }

    /// Returns the seconds of a point with `steps` steps.
    pub fn seconds(&self, steps: u64) -> f64 {
        self.seconds_per_step * steps as f64 + self.seconds_evaluation
    }
}

impl Trainings<'_> {
    /// Measures a few real steps and part of a held-out view, and scales to the views of an evaluation.
    pub fn cost(&self, point: &Point) -> Result<Cost> {
        let runtime = &on_device(&self.runtime, point.on_cpu);
        let memory = watch_memory(runtime);
        let seconds_per_step = self.estimated_step(&point.config, runtime)?;
        let (trainer, scene, config) = self.trainer(&point.config, runtime)?;
        let mut seconds_evaluation = 0.0;
        if let Some(view) = scene.test.first() {
            // Each thread gets some rows of the image, as in the complete image.
            let mut camera = view.camera;
            let rows = (2 * runtime.threads() * config.eval.chunk).div_ceil(camera.width);
            camera.height = rows.min(view.camera.height);
            let viewer = Viewer { model: trainer.model()?, config: &config, scene: &scene, runtime };
            let renderer = viewer.renderer()?;
            let timed = || -> Result<f64> {
                let started = Instant::now();
                viewer.render_with(&*renderer, &camera)?;
                Ok(started.elapsed().as_secs_f64())
            };
            // On the second call, the renderer's preparation for a view is already done.
            let (first, rows_alone) = (timed()?, timed()?);
            let rays = (view.camera.height as f64 / camera.height as f64) * rows_alone;
            let preparing = (first - rows_alone).max(0.0);
            let views = (scene.test.len() + config.seen_views(&scene).len()) as f64;
            let TrainConfig { steps, eval_every, eval_stride, .. } = config.train;
            let between = steps.saturating_sub(1).checked_div(eval_every).unwrap_or(0) as f64;
            let sparse = rays / (eval_stride * eval_stride) as f64;
            seconds_evaluation = views * (rays + preparing + between * (sparse + preparing));
        }
        Ok(Cost { seconds_per_step, seconds_evaluation, peak_memory_mib: memory.peak_mib() })
    }
}

impl Trainings<'_> {
    /// Returns the seconds of the first steps of each training, as many steps as take `least` seconds.
    fn time_steps(&self, configs: &[&Config], least: f64, runtime: &Runtime) -> Result<Vec<Vec<f64>>> {
        let trainers: Result<Vec<Trainer>> =
            configs.iter().map(|config| Ok(self.trainer(config, runtime)?.0)).collect();
        let mut trainers = trainers?;
        let steps: Vec<usize> = configs.iter().map(|config| config.train.steps as usize).collect();
        let timed = |index: usize| {
            let started = Instant::now();
            trainers[index].step(false)?;
            runtime.synchronize()?;
            Ok(started.elapsed().as_secs_f64())
        };
        time_in_turns(&steps, timed, least)
    }
}

impl Trainings<'_> {
    /// Measures the seconds of a step of each training, for budgets.
    pub fn step_seconds(&self, configs: &[&Config]) -> Result<StepSeconds> {
        let minutes = (CALIBRATION * configs.len() as f64 / 60.0).ceil();
        self.events.on(Event::Note(&format!(
            "timing the steps of {} trainings, which budgets in seconds need; this takes about {minutes} min, or longer where \
             {LEAST_STEPS} steps of a training take longer",
            configs.len()
        )));
        let seconds = self.time_steps(configs, CALIBRATION, &self.runtime)?;
        let clock = Clock {
            processor: Host::current().cpu.unwrap_or_else(|| "unknown".into()),
            device: self.runtime.name().to_string(),
            threads: self.runtime.threads(),
            code_revision: revision().to_string(),
        };
        let means = seconds.iter().map(|steps| mean_without_hiccups(steps));
        let mut seconds: StepSeconds = configs.iter().copied().zip(means).collect();
        seconds.clock = Some(clock);
        Ok(seconds)
    }

    /// Estimates the same from a few steps, for numbers that are only printed.
    pub fn estimated_step_seconds(&self, configs: &[&Config]) -> Result<StepSeconds> {
        configs.iter().map(|config| Ok((*config, self.estimated_step(config, &self.runtime)?))).collect()
    }

    /// Returns the median of a few steps, of which the first are slow.
    fn estimated_step(&self, config: &Config, runtime: &Runtime) -> Result<f64> {
        Ok(median(&self.time_steps(&[config], ESTIMATE, runtime)?[0]))
    }
}

/// Times steps of trainings in turn, so that a busy minute affects all of them. Ends when each training has taken
/// `least` seconds or all of its steps. A turn is a fraction of these seconds, or one step if that takes longer.
/// `step` returns the seconds of a step. Returns those of each training's steps.
fn time_in_turns(steps: &[usize], mut step: impl FnMut(usize) -> Result<f64>, least: f64) -> Result<Vec<Vec<f64>>> {
    let mut seconds = vec![Vec::new(); steps.len()];
    let mut left = vec![least; steps.len()];
    loop {
        let mut any = false;
        for (index, own) in seconds.iter_mut().enumerate() {
            let mut turn = 0.0;
            let too_few = |own: &[f64]| own.len() < LEAST_STEPS && (least > 0.0 || own.iter().sum::<f64>() < ENOUGH);
            while too_few(own) || (own.len() < steps[index] && left[index] > 0.0) {
                any = true;
                let taken = step(index)?;
                own.push(taken);
                left[index] -= taken;
                turn += taken;
                if turn >= least / TURNS as f64 {
                    break;
                }
            }
        }
        if !any {
            return Ok(seconds);
        }
    }
}

/// Returns the mean over medians of successive steps, one median a turn. It follows changes in the course of a
/// training, but ignores single steps that the machine interrupted.
fn mean_without_hiccups(seconds: &[f64]) -> f64 {
    let medians = seconds.chunks(seconds.len().div_ceil(TURNS)).map(|steps| median(steps) * steps.len() as f64);
    medians.sum::<f64>() / seconds.len() as f64
}

/// Returns the median; of an even number of values, the lower of the two.
fn median(seconds: &[f64]) -> f64 {
    let mut seconds = seconds.to_vec();
    seconds.sort_by(f64::total_cmp);
    seconds[(seconds.len() - 1) / 2]
}

impl Work for Trainings<'_> {
    fn run(
        &self,
        point: &Point,
        folder: &PointFolder,
        runtime: &Runtime,
        progress: &Progress,
        stop: &AtomicUsize,
    ) -> Result<PointResult> {
        let runtime = &on_device(runtime, point.on_cpu);
        let mut config = point.config.clone();
        config.eval.lpips_weights.clone_from(&self.lpips_weights);
        let (config, scene) = self.scene(config)?;
        let setup = Setup { config: config.clone(), scene: &scene, lpips: &self.lpips, runtime: runtime.clone() };
        let path = folder.run();
        let job = if RunDir::is_vacant(&path)? {
            // No run yet, or one that was killed before its first file.
            Job::create(&path, Existing::Replace, setup)?
        } else {
            // Any other problem is an error: the run may hold hours of training.
            let run = RunDir::take(&path)?;
            let found = run.read_config()?;
            if found.hash() != config.hash() {
                return Err(Error::Checkpoint(format!(
                    "{} holds a run of other settings ({} instead of {}); delete it to train the point again",
                    path.display(),
                    found.hash(),
                    config.hash()
                )));
            }
            Job::resume(run, setup)?
        };
        let noting = |event: Event| {
            match event {
                Event::TrainingStarted { first, steps, .. } => progress.begin(first, steps),
                Event::Stepped { step, .. } => progress.stepped(step),
                _ => {}
            }
            self.events.on(event);
        };
        let finished = job.train(&noting, stop)?;
        // Such a training ends here with an error, unless its numbers are wanted.
        if let Err(lost) = finished.report.check_learned(&path) {
            self.events.on(Event::Note(&format!("{lost}; it counts, because train.collapse_steps is 0")));
        }
        self.result(&config, &scene, &path, runtime, &finished)
    }
}

impl Trainings<'_> {
    fn result(
        &self,
        config: &Resolved,
        scene: &Scene,
        path: &std::path::Path,
        runtime: &Runtime,
        finished: &Finished,
    ) -> Result<PointResult> {
        let Finished { report, model, .. } = finished;
        let Report { protocol, .. } = report;
        let mut told = columns(protocol);
        let mut metrics: Vec<(String, Option<f64>)> =
            report.mean.iter().map(|(metric, value)| (metric.key.to_string(), value)).collect();
        if self.smoothness && config.representation().has_derivatives_at_points() {
            // All rows use one sampling grid, independent of their training settings.
            let lattice = Lattice { domain: smoothness_box(scene), side: SMOOTHNESS_SIDE };
            let smoothness = SmoothnessReport::measure(model, scene, &lattice, protocol.clone(), runtime, self.events)?;
            smoothness.write(&RunDir::open(path)?.smoothness())?;
            let evaluated = smoothness.fields.last().expect("there is a field");
            metrics.extend(numbers(&evaluated.smoothness));
            told.push((SMOOTHNESS_DOMAIN.into(), evaluated.domain.clone()));
        }
        debug_assert_eq!(protocol.text("config_hash"), config.hash());
        let inactive_levels = report.inactive_levels().into_iter().map(String::from).collect();
        Ok(PointResult { metrics, protocol: told, inactive_levels })
    }
}

/// Returns the fields of a flat struct of numbers.
fn numbers(row: &impl serde::Serialize) -> Vec<(String, Option<f64>)> {
    let serde_json::Value::Object(fields) = serde_json::to_value(row).expect("plain data") else {
        unreachable!("rows are structs")
    };
    fields.into_iter().map(|(name, value)| (name, value.as_f64())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_timed_for_seconds_and_one_hiccup_does_not_count() {
        let mut taken = 0;
        let slow_once = |_| {
            taken += 1;
            Ok(if taken == 7 { 0.120 } else { 0.002 })
        };
        let seconds = time_in_turns(&[1000], slow_once, 0.301).unwrap().remove(0);
        assert_eq!(seconds.len(), 92);
        assert!((mean_without_hiccups(&seconds) - 0.002).abs() < 1e-12);
        // A turn has as many fast steps as fit into the time of a slow one.
        let step = |index: usize| Ok([0.001, 0.040][index]);
        let both = time_in_turns(&[1000, 1000], step, 0.32).unwrap();
        assert!(both[0].len() > 30 * both[1].len(), "{} {}", both[0].len(), both[1].len());
        // A training that ends before is timed completely.
        let short = time_in_turns(&[20, 1000], step, 0.32).unwrap();
        assert_eq!(short[0].len(), 20);
        assert!(short[1].len() >= 8, "{}", short[1].len());
        // A step that takes seconds is still timed several times.
        let mut order = Vec::new();
        let each = time_in_turns(
            &[1000, 1],
            |index| {
                order.push(index);
                Ok(1.0)
            },
            0.001,
        )
        .unwrap();
        assert_eq!((each[0].len(), each[1].len()), (LEAST_STEPS, LEAST_STEPS));
        assert_eq!(order, [0, 1].repeat(LEAST_STEPS), "one of each in turn");
        assert_eq!(super::median(&[3.0, 1.0, 2.0, 9.0]), 2.0);
        // An estimate needs no more than two seconds of it.
        let steps = |seconds: f64| time_in_turns(&[1000], |_| Ok(seconds), ESTIMATE).unwrap()[0].len();
        assert_eq!([60.0, 1.0, 0.1].map(steps), [1, 2, LEAST_STEPS]);
    }

    #[test]
    fn what_becomes_faster_is_timed_in_its_mean() {
        let falling: Vec<f64> = (0..100).map(|step| if step < 24 { 4.0 } else { 1.0 }).collect();
        assert_eq!(mean_without_hiccups(&falling), 1.72);
        let mut hiccup = falling.clone();
        hiccup[50] = 1000.0;
        assert_eq!(mean_without_hiccups(&hiccup), 1.72);
        assert_eq!(mean_without_hiccups(&[1.0, 2.0]), 1.5, "few steps are used as they are");
    }
}
