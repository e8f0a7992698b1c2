//! A trainer whose parameters are kept elsewhere, and what is refused there.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use candle_core::{Device, Tensor};

use super::*;
use crate::methods::{DeviceSteps, Extremes, StepReport, Term, not_finite};
use crate::run::load_scene;
use crate::runtime::Accelerator;
use crate::settings::{Preset, build, parse_assignment};

/// Parameters and moments in memory of its own: each step adds 1 to all.
struct Elsewhere {
    kept: f64,
    shown: Vec<candle_core::Var>,
    fetches: Arc<AtomicU64>,
    reports: Vec<StepReport>,
    /// The step that is not finite, which its report tells.
    breaks_at: Option<u64>,
}

impl Elsewhere {
    fn new(model: &Model, fetches: &Arc<AtomicU64>) -> Elsewhere {
        let shown: Vec<_> = model.variables().into_iter().map(|(_, var)| var).collect();
        Elsewhere { kept: 0.0, shown, breaks_at: None, reports: Vec::new(), fetches: fetches.clone() }
    }

    fn report(&self) -> StepReport {
        let term = Term { name: "loss".into(), described: "loss".into(), value: self.kept, weight: 1.0 };
        StepReport::new(vec![term], self.kept, 0.25, Extremes::none(0.0))
    }

    /// Returns what a trainer takes its steps with.
    fn steps(self, model: &Model) -> Steps {
        Steps::Device(Box::new(self), Moments::zero(&model.variables()).unwrap())
    }
}

impl DeviceSteps for Elsewhere {
    fn columns(&self) -> LogColumns {
        LogColumns::default()
    }

    fn step(&mut self, at: StepAt) -> Result<()> {
        assert_eq!((at.step as f64, at.updates as f64), (self.kept, self.kept + 1.0));
        self.kept += 1.0;
        self.reports.push(self.report());
        assert!(self.reports.len() <= self.most_reports());
        Ok(())
    }

    fn reports(&mut self) -> Result<Vec<StepReport>> {
        if let Some(step) = self.breaks_at.filter(|step| *step as f64 <= self.kept) {
            self.breaks_at = None;
            self.reports.clear();
            return Err(not_finite(step, "loss", 0.1));
        }
        Ok(std::mem::take(&mut self.reports))
    }

    fn most_reports(&self) -> usize {
        5
    }

    fn fetch(&mut self) -> Result<Vec<Moments>> {
        self.fetches.fetch_add(1, Ordering::SeqCst);
        let all = |tensor: &Tensor| (tensor.zeros_like()? + self.kept).and_then(|tensor| tensor.contiguous());
        let each = self.shown.iter().map(|var| {
            var.set(&all(var)?)?;
            Ok(Moments { first: all(var)?, second: all(var)? })
        });
        each.collect()
    }
}

#[derive(Debug)]
struct Card;

impl Accelerator for Card {
    fn description(&self) -> String {
        "a card, driver 1".into()
    }

    fn synchronize(&self) -> Result<()> {
        Ok(())
    }
}

fn gpu() -> Runtime {
    Runtime::with_accelerator(Arc::new(Card), "gpu:1".into(), Some(1)).unwrap()
}

fn small(method: &str) -> (Resolved, Scene) {
    let small = [method, "data.width=8", "field.width=16", "train.rays=16", "train.steps=9"];
    let small = small.map(|text| parse_assignment(text).unwrap());
    load_scene(build(Some(Preset::Smoke), None, &small).unwrap(), &()).unwrap()
}

/// The first value of the first variable, as the model shows it.
fn shown(trainer: &Trainer) -> f32 {
    let (_, var) = &trainer.model().unwrap().variables()[0];
    var.flatten_all().unwrap().to_vec1::<f32>().unwrap()[0]
}

#[test]
fn parameters_that_are_kept_elsewhere_are_fetched_when_they_are_looked_at() {
    let (config, scene) = small("method=nerf");
    let cpu = Runtime::new("cpu", Some(1)).unwrap();
    let (model, fetches) = (Model::start(&config, &scene, DType::F32, &cpu).unwrap().0, Arc::default());
    let steps = Elsewhere::new(&model, &fetches).steps(&model);
    let gpu = gpu();
    let inputs = Inputs { config: &config, scene: &scene, dtype: DType::F32, runtime: &gpu };
    let mut trainer = inputs.trainer(model, steps, State { redraws: vec![0; 2], ..State::default() });
    let fetched = || fetches.load(Ordering::SeqCst);

    // Its parameters are the model's until the first step.
    assert!(trainer.model().is_ok());
    assert_eq!((fetched(), trainer.step_count()), (0, 0));
    (0..3).for_each(|_| drop(trainer.step(false).unwrap()));
    assert_eq!(fetched(), 0);
    // Once, however often it is asked for.
    assert_eq!((shown(&trainer), shown(&trainer), fetched()), (3.0, 3.0, 1));

    // A stopped step does not count, and a checkpoint after it has what came before.
    trainer.step(false).unwrap();
    let stop = || Err(Error::Interrupted { signal: 15, message: String::new() });
    assert!(trainer.step_unless(false, false, &stop).is_err());
    let folder = tempfile::tempdir().unwrap();
    let checkpoint = trainer.save(folder.path()).unwrap();
    assert_eq!((fetched(), trainer.step_count()), (2, 4));
    let saved = candle_core::safetensors::load(checkpoint.join("state.safetensors"), &Device::Cpu).unwrap();
    assert_eq!(saved.len(), 3 * Model::parameter_names(&config).len());
    for (name, tensor) in saved {
        let values = tensor.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        assert!(values.iter().all(|value| *value == 4.0), "{name}");
    }
    trainer.save(&folder.path().join("again")).unwrap();
    assert_eq!((shown(&trainer), fetched()), (4.0, 2));

    let state = checkpoint::load_state(&checkpoint).unwrap();
    assert_eq!((state.devices, state.adapters), (vec!["gpu".to_string()], vec!["a card, driver 1".to_string()]));
    assert!(state.instructions.is_empty());
    // It goes on here, and both are named.
    let mut resumed = Trainer::resume(&checkpoint, &config, &scene, DType::F32, &cpu).unwrap();
    resumed.step(false).unwrap();
    let state = resumed.state();
    assert_eq!((state.step, state.devices.join(" "), state.adapters.len()), (5, "gpu cpu".into(), 1));
}

#[test]
fn measurements_of_steps_that_nobody_waits_for_come_together() {
    let (config, scene) = small("method=nerf");
    let cpu = Runtime::new("cpu", Some(1)).unwrap();
    let model = Model::start(&config, &scene, DType::F32, &cpu).unwrap().0;
    let steps = Elsewhere::new(&model, &Arc::default()).steps(&model);
    let gpu = gpu();
    let inputs = Inputs { config: &config, scene: &scene, dtype: DType::F32, runtime: &gpu };
    let mut trainer = inputs.trainer(model, steps, State { redraws: vec![0; 2], ..State::default() });
    let step = |trainer: &mut Trainer, wait: bool| {
        trainer.step_unless(false, wait, &|| Ok(())).unwrap().map(|stats| (stats.step, stats.loss))
    };
    // How many come together depends on their time. Each has the measurements of its own step.
    let reported: Vec<(u64, f64)> = (0..12).filter_map(|_| step(&mut trainer, false)).collect();
    assert!(reported.is_sorted_by(|a, b| a.0 < b.0) && reported.iter().all(|(step, loss)| *step as f64 == *loss));
    assert_eq!(step(&mut trainer, true), Some((13, 13.0)));
    step(&mut trainer, false);
    // A look at the model waits for all. The stepper gave no ray an accumulation: every step was dead.
    assert!(trainer.model().is_ok());
    assert_eq!((trainer.step_count(), trainer.state().empty_steps), (14, 14));
}

/// After a step that broke nothing is saved, however often it is tried.
#[test]
fn a_broken_step_ends_a_training() {
    let (config, scene) = small("method=nerf");
    let cpu = Runtime::new("cpu", Some(1)).unwrap();
    let model = Model::start(&config, &scene, DType::F32, &cpu).unwrap().0;
    let steps = Elsewhere { breaks_at: Some(3), ..Elsewhere::new(&model, &Arc::default()) }.steps(&model);
    let gpu = gpu();
    let inputs = Inputs { config: &config, scene: &scene, dtype: DType::F32, runtime: &gpu };
    let mut trainer = inputs.trainer(model, steps, State { redraws: vec![0; 2], ..State::default() });
    let broken = (0..6).find_map(|_| trainer.step_unless(false, false, &|| Ok(())).err());
    let message = broken.unwrap_or_else(|| trainer.catch_up().unwrap_err()).to_string();
    assert!(message.contains("diverged at step 3"), "{message}");
    let folder = tempfile::tempdir().unwrap();
    for _ in 0..2 {
        assert_eq!(trainer.save(folder.path()).unwrap_err().to_string(), message);
        assert_eq!(trainer.step(false).unwrap_err().to_string(), message);
    }
    assert!(checkpoint::list(folder.path()).unwrap().is_empty());
}

/// A run that starts from another's weights drew none of its own.
#[test]
fn a_restarted_run_has_no_redraws() {
    let (config, scene) = small("method=nerf");
    let cpu = Runtime::new("cpu", Some(1)).unwrap();
    let inputs = Inputs { config: &config, scene: &scene, dtype: DType::F32, runtime: &cpu };
    let model = Model::start(&config, &scene, DType::F32, &cpu).unwrap().0;
    let steps = inputs.steps(&model, None).unwrap();
    let parent = inputs.trainer(model, steps, State { redraws: vec![3, 1], ..State::default() });
    let folder = tempfile::tempdir().unwrap();
    let checkpoint = parent.save(folder.path()).unwrap();
    let redraws = |goes_on: bool| {
        let origin = Origin::Checkpoint { folder: &checkpoint, goes_on };
        Trainer::begin_from(origin, &config, &scene, DType::F32, &cpu).unwrap().redraws().to_vec()
    };
    assert_eq!((redraws(true), redraws(false)), (vec![3, 1], vec![0, 0]));
}

#[test]
fn what_an_accelerator_cannot_train_is_refused() {
    let gpu = gpu();
    let refused = |method: &str| {
        let (config, scene) = small(method);
        let dtype = DType::F32;
        Trainer::new(&config, &scene, dtype, &gpu).err().expect("it is refused").to_string()
    };
    // A card of no crate that this program knows.
    let unknown = refused("method=nerf");
    assert_eq!(unknown, "device gpu: this program cannot train or render on a card, driver 1; use --device cpu");
    if cfg!(feature = "baselines") {
        let method = refused("method=srn");
        assert_eq!(method, "method srn: device gpu does not train or render it; use --device cpu");
        let (config, scene) = small("method=srn");
        assert!(Trainer::check(&config, &scene, DType::F32, &gpu).is_err());
        let (model, _) = Model::start(&config, &scene, DType::F32, &gpu).unwrap();
        assert_eq!(model.renderer(&config, &scene, &gpu).err().unwrap().to_string(), method);
    }
}

#[test]
fn states_of_cpus_name_no_adapter() {
    let mut state = State::default();
    state.touch(&Runtime::new("cpu", Some(1)).unwrap());
    let text = serde_json::to_string(&state).unwrap();
    assert!(!text.contains("adapters") && text.contains(r#""devices":["cpu"]"#), "{text}");
    assert_eq!(serde_json::from_str::<State>(&text).unwrap(), state);
    state.touch(&gpu());
    state.touch(&gpu());
    assert_eq!((state.devices.len(), state.adapters.len()), (2, 1));
    assert_eq!(serde_json::from_str::<State>(&serde_json::to_string(&state).unwrap()).unwrap(), state);
}

#[cfg(not(feature = "gpu"))]
#[test]
fn a_gpu_needs_a_program_that_was_built_with_it() {
    for device in ["gpu", "gpu:2"] {
        let error = crate::open_runtime(device, None).unwrap_err().to_string();
        let built = "this program was built without gpu; build it with --features gpu";
        assert_eq!(error, format!("device {device}: {built}"));
    }
    assert_eq!(crate::open_runtime("cpu", Some(3)).unwrap().threads(), 3);
}
