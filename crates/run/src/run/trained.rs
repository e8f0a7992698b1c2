//! A trained run, opened from its folder.

use std::path::Path;

use candle_core::DType;
use serde::Deserialize;
use serde_json::{Map, Value};

use crate::base::files::read_json;
use crate::base::{Error, Listener, Result};
use crate::data::{Photos, Scene, View};
use crate::draw::write_png8;
use crate::methods::SiteSummary;
use crate::metrics::{Lpips, OneColour};
use crate::model::Model;
use crate::runtime::Runtime;
use crate::settings::{Config, EvalSplit, Resolved};
use crate::train::checkpoint::{self, State};

use super::protocol::OF_PIXELS;
use super::{DepthErrors, Protocol, RenderedView, Report, RunDir, Viewer, load_scene_of, surface_reference};

/// Views that a run is measured on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    /// The held-out views.
    Test,
    /// The validation views: `data.eval_split = "val"`.
    Val,
    /// All training views, as the training saw them.
    Train,
}

/// The checkpoint of a run to open, and the views to measure in place of the held-out ones. By default the newest
/// checkpoint and the run's own views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OpenOptions {
    /// Step of the checkpoint.
    pub step: Option<u64>,
    /// The views.
    pub split: Option<Split>,
    /// Opens the run without its lock, so that a training may go on. A checkpoint that is replaced meanwhile gives way to its
    /// successor.
    pub beside_training: bool,
    /// How much of the photos is read. If the run has no evaluation, or for other views, all are: its protocol names them.
    pub photos: Photos,
}

impl OpenOptions {
    /// For what needs cameras, and few photos if any.
    pub const CAMERAS: OpenOptions =
        OpenOptions { step: None, split: None, beside_training: false, photos: Photos::Later };
}

/// The newest checkpoint of a run, with its scene, ready to render and measure.
///
/// The run's folder is locked while this value lives, so that no training deletes the checkpoint, but for
/// [`OpenOptions::beside_training`]. A folder that this process cannot write is opened as well.
///
/// ```
/// # mod augnerf { pub use augnerf_base as base; pub use augnerf_nerf::*; pub use augnerf_run::*; pub use candle_core; }
/// use augnerf::run::Trained;
/// use augnerf::runtime::Runtime;
/// # use std::sync::atomic::AtomicUsize;
/// # use augnerf::run::{Existing, Job, Setup, load_scene};
/// # use augnerf::settings::{Preset, build, parse_assignment};
/// # let dir = tempfile::tempdir().unwrap();
/// # let folder = dir.path().join("run");
/// # let runtime = Runtime::new("cpu", None)?;
/// # let small = ["data.width=16", "field.width=16", "train.rays=64", "train.steps=4"];
/// # let small = small.map(|text| parse_assignment(text).unwrap());
/// # let (config, scene) = load_scene(build(Some(Preset::Smoke), None, &small)?, &())?;
/// # let setup = Setup { config, scene: &scene, lpips: &[], runtime };
/// # Job::create(&folder, Existing::Refuse, setup)?.train(&(), &AtomicUsize::new(0))?;
///
/// let trained = Trained::open(&folder, None, &Runtime::new("cpu", None)?, &())?;
/// assert_eq!((trained.state.step, trained.protocol().text("scene").as_str()), (4, "builtin"));
/// let report = trained.evaluate(&[], &())?;
/// assert_eq!(report.views.len(), trained.scene.test.len());
/// # Ok::<(), augnerf::base::Error>(())
/// ```
pub struct Trained {
    /// The run's folder.
    pub run: RunDir,
    /// The settings of the training.
    pub config: Resolved,
    /// Its scene, loaded: training and held-out views.
    pub scene: Scene,
    /// Counters and provenance at the checkpoint, with this program and device added.
    pub state: State,
    /// The evaluated model and its parts.
    pub model: Model,
    /// Runtime of the computation.
    pub runtime: Runtime,
    /// The views in place of the run's own.
    split: Option<Split>,
    /// The protocol of the run's evaluation.
    recorded: Option<Map<String, Value>>,
}

/// Returns the protocol of a run's evaluation, if it has one.
fn recorded(run: &RunDir) -> Option<Map<String, Value>> {
    #[derive(Deserialize)]
    struct Metrics {
        protocol: Map<String, Value>,
    }
    let [metrics, _] = RunDir::metrics_in(run.path());
    read_json(&metrics, "").ok().flatten().map(|Metrics { protocol }| protocol)
}

/// Loads a checkpoint's counters and model.
fn load(checkpoint: &Path, config: &Config, runtime: &Runtime) -> Result<(State, Model)> {
    let state = checkpoint::load_state(checkpoint)?;
    let model = checkpoint::load_model(checkpoint, config, DType::F32, runtime.device())?;
    checkpoint::check_config(checkpoint, &state, config)?;
    Ok((state, model))
}

impl Trained {
    /// Opens the run folder `run`. Its scene is at its old path, or in `data` if it has moved.
    ///
    /// # Errors
    /// [`Error::Checkpoint`](crate::base::Error::Checkpoint): no run or checkpoint, a damaged checkpoint, or one of
    /// other settings. [`Error::InUse`](crate::base::Error::InUse): another process holds the run.
    /// [`Error::Data`](crate::base::Error::Data): the scene cannot be read, or has changed since the run started.
    pub fn open(run: &Path, data: Option<&Path>, runtime: &Runtime, events: &dyn Listener) -> Result<Trained> {
        Trained::open_at(run, OpenOptions::default(), data, runtime, events)
    }

    /// Opens another checkpoint, or measures other views.
    ///
    /// # Errors
    /// Those of [`Trained::open`]; the step has no checkpoint; the scene has no validation views.
    pub fn open_at(
        run: &Path,
        options: OpenOptions,
        data: Option<&Path>,
        runtime: &Runtime,
        events: &dyn Listener,
    ) -> Result<Trained> {
        let run = if options.beside_training { RunDir::open(run)? } else { RunDir::take_to_read(run)? };
        let mut config = run.read_config()?;
        if let Some(dir) = data {
            config.data.dir = dir.to_string_lossy().into_owned();
        }
        let (mut state, model) = loop {
            let chosen = match options.step {
                Some(step) => checkpoint::of_step(&run.checkpoints(), step)?,
                None => checkpoint::latest(&run.checkpoints())?,
            };
            match load(&chosen, &config, runtime) {
                Err(_) if options.beside_training && !chosen.exists() => {}
                loaded => break loaded?,
            }
        };
        state.touch(runtime);
        match options.split {
            None => {}
            Some(Split::Test) => config.data.eval_split = EvalSplit::Test,
            Some(Split::Val) => config.data.eval_split = EvalSplit::Val,
            // The training views are measured once.
            Some(Split::Train) => config.eval.train_views = Some(0),
        }
        let recorded = recorded(&run);
        let is_told = options.beside_training || recorded.is_some() && options.split.is_none();
        let photos = if is_told { options.photos } else { Photos::Read };
        let (config, mut scene) = runtime.install(|| load_scene_of(&run, config, photos, events))?;
        if options.split == Some(Split::Train) {
            scene.test = scene.train.clone();
        }
        let (runtime, split) = (runtime.clone(), options.split);
        Ok(Trained { run, config, scene, state, model, runtime, split, recorded })
    }

    /// Returns a viewer that renders views.
    pub fn viewer(&self) -> Viewer<'_> {
        let Trained { config, scene, model, runtime, .. } = self;
        Viewer { model, config, scene, runtime }
    }

    /// Returns the provenance of its numbers.
    pub fn protocol(&self) -> Protocol {
        let mut protocol = named(self.split, Protocol::new(&self.config, &self.scene, &self.state));
        if let (false, Some(recorded)) = (self.scene.is_read(), &self.recorded) {
            // Epochs follow from the scene unless a mask is unread; those of another step are others.
            let is_missing = protocol.get("epochs").is_null() && recorded.get("steps") == Some(protocol.get("steps"));
            let epochs = is_missing.then_some("epochs");
            OF_PIXELS
                .into_iter()
                .chain(epochs)
                .for_each(|column| protocol.set(column, recorded.get(column).cloned().unwrap_or_default()));
        }
        protocol
    }

    /// Measures every held-out view, some training views, and the surface if configured. Writes `metrics.json` and
    /// `metrics.csv` into the run's folder.
    ///
    /// # Errors
    /// The scene cannot have the surface; weights are not numbers; files cannot be written.
    pub fn evaluate(&self, lpips: &[Lpips], events: &dyn Listener) -> Result<Report> {
        self.evaluate_into(self.run.path(), lpips, events)
    }

    /// Does the same with the files in another folder, such as for a run on a read-only disk.
    ///
    /// # Errors
    /// Those of [`Trained::evaluate`].
    pub fn evaluate_into(&self, folder: &Path, lpips: &[Lpips], events: &dyn Listener) -> Result<Report> {
        surface_reference(&self.config, &self.scene)?;
        let Trained { run, state, split, .. } = self;
        let measurement = Measurement { run, folder, viewer: self.viewer(), state, lpips, events, split: *split };
        self.runtime.install(|| measurement.write(|| Ok(()), |_, _, _| Ok(())))
    }
}

/// One evaluation of a run.
pub(super) struct Measurement<'a> {
    pub run: &'a RunDir,
    /// Folder of the output files.
    pub folder: &'a Path,
    pub viewer: Viewer<'a>,
    pub state: &'a State,
    pub lpips: &'a [Lpips],
    pub events: &'a dyn Listener,
    /// The views in place of the held-out ones.
    pub split: Option<Split>,
}

/// Returns the protocol of an evaluation of these views. Training views are not a split that settings name.
fn named(split: Option<Split>, mut protocol: Protocol) -> Protocol {
    if split == Some(Split::Train) {
        protocol.set("split", "train".into());
    }
    protocol
}

impl Measurement<'_> {
    /// Measures and writes. `stop_check` may end it with an error before a view or a part of the surface; `each`
    /// receives each measured view.
    pub fn write(
        &self,
        stop_check: impl Fn() -> Result<()>,
        mut each: impl FnMut(usize, &View, &RenderedView) -> Result<()>,
    ) -> Result<Report> {
        let attack = SiteSummary::read(&self.run.scalars(), self.state.step)?;
        let (mut errors, mut one_colour) = (DepthErrors::default(), OneColour::default());
        let views = self.viewer.evaluate(self.lpips, self.events, &stop_check, |index, view, rendered| {
            errors.views.extend(self.viewer.depth_errors(view, rendered));
            one_colour.add(&rendered.image, &view.image, view.mask.as_deref());
            each(index, view, rendered)
        })?;
        let training_views = self.viewer.evaluate_training_views(self.lpips, self.events, &stop_check)?;
        let surface = self.viewer.surface(self.events, &stop_check)?;
        let protocol = Protocol::new(self.viewer.config, self.viewer.scene, self.state).with_lpips(self.lpips);
        let protocol = named(self.split, protocol);
        let (chamfer, picture) = surface.map_or((None, None), |surface| (surface.chamfer, surface.picture));
        if let Some(picture) = picture {
            let path = RunDir::surface_picture_in(self.folder);
            let renders = path.parent().expect("it is in a folder");
            std::fs::create_dir_all(renders).map_err(|e| Error::unwritable(renders, &e))?;
            write_png8(&path, &picture)?;
        }
        let report = Report::new(views, training_views, chamfer, protocol, attack);
        let report = Report { is_one_colour: one_colour.holds(), ..report };
        let [json, csv] = RunDir::metrics_in(self.folder);
        errors.write(&RunDir::depth_errors_in(self.folder))?;
        report.write(&json, &csv)?;
        Ok(report)
    }
}
