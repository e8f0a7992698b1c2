//! A run on the page, with its newest weights.

use std::collections::HashMap;
use std::path::Path;
use std::sync::{Arc, Mutex, OnceLock, PoisonError, RwLock};
use std::time::{Duration, Instant};

use candle_core::{Tensor, Var};

use crate::base::{Listener, Result};
use crate::data::{Camera, Scene};
use crate::draw::depth_range;
use crate::methods::Renderer;
use crate::model::Model;
use crate::run::{OpenOptions, Trained, Viewer};
use crate::runtime::Runtime;
use crate::settings::Resolved;

use super::perturbed::{Attack, PerturbedRenderer};
use super::skipping::SkippingRenderer;

/// Height of the picture by which the skipping renderer is compared with the full one.
const CHECKED_ROWS: usize = 64;
/// Height of the first picture, which nobody sees. It tells the range of depth, and how long a ray takes.
const FIRST_ROWS: usize = 24;
/// The most rays of a part. Who waits for a turn waits for some parts.
pub const MOST_RAYS: usize = 64;
/// How many times longer than the clean pass a search takes, before there was one.
const SEARCH_OVER_CLEAN: f64 = 10.0;
/// The least width and height of a picture that is made small to be quick.
const LEAST_SIDE: f64 = 8.0;
/// Where the skipping renderer may take space for empty: an interval of the coarse pass stops less than this fraction of the
/// light. The first one is taken whose picture is the full renderer's.
const LEAST_ALPHAS: [f64; 3] = [3e-2, 1e-2, 1e-3];
/// With a larger fraction of space that is not empty, nothing is gained.
const MOST_OCCUPIED: f64 = 0.9;
/// Greatest mean difference of colours between the two, of 0..=1: a quarter of a step of 8 bits.
const MOST_DIFFERENCE: f64 = 0.25 / 255.0;

/// A run on the page.
pub struct ShownRun {
    /// Its name on the page.
    pub label: String,
    /// Its settings.
    pub config: Resolved,
    /// Its scene.
    pub scene: Scene,
    /// What computes its pictures.
    pub runtime: Runtime,
    /// Steps of the whole training.
    pub steps: u64,
    current: RwLock<Option<Arc<Weights>>>,
    /// Seconds of a ray, for the sites of each attack that was looked at; without sites for the clean pass.
    costs: Mutex<HashMap<Vec<String>, f64>>,
}

/// A run's weights at one step, with what renders them.
pub struct Weights {
    /// Finished steps.
    pub step: u64,
    /// The model.
    pub model: Model,
    /// Renders the clean pass.
    full: Box<dyn Renderer>,
    /// The same without empty space, once that is found and something is gained.
    skipping: OnceLock<SkippingRenderer>,
    /// Renders with the attack's deltas. `None` for methods without fields, and on other devices than the processor.
    pub perturbed: Option<PerturbedRenderer>,
    /// Nearest and farthest depth of the colour scale, in units of `t_vals`.
    pub depths: (f32, f32),
}

impl Weights {
    /// Returns the fastest renderer of the clean pass.
    pub fn renderer(&self) -> &dyn Renderer {
        self.skipping.get().map_or(&*self.full, |skipping| skipping)
    }

    /// Returns the fraction of space that is not empty, if the renderer leaves empty space out.
    pub fn occupied(&self) -> Option<f64> {
        self.skipping.get().map(SkippingRenderer::occupied)
    }
}

impl ShownRun {
    /// Opens the newest checkpoint of a run folder. Its scene is at its old path, or in `data`. Other commands may use the run
    /// meanwhile, a training too: all that is shown is in memory.
    ///
    /// # Errors
    /// Those of [`Trained::open_at`]; weights are not numbers.
    pub fn open(folder: &Path, data: Option<&Path>, runtime: &Runtime, events: &dyn Listener) -> Result<ShownRun> {
        let options = OpenOptions { beside_training: true, ..OpenOptions::CAMERAS };
        let Trained { config, scene, state, model, runtime, .. } =
            Trained::open_at(folder, options, data, runtime, events)?;
        let label =
            folder.file_name().map_or_else(|| folder.display().to_string(), |name| name.to_string_lossy().into_owned());
        let shown = ShownRun::of_training(label, config, scene, runtime);
        shown.show(state.step, model)?;
        Ok(shown)
    }

    /// Creates a run whose weights come later, from a training in this process.
    pub fn of_training(label: String, config: Resolved, scene: Scene, runtime: Runtime) -> ShownRun {
        let steps = config.train.steps;
        ShownRun { label, config, scene, runtime, steps, current: RwLock::default(), costs: Mutex::default() }
    }

    /// Returns the newest weights, if there are some.
    pub fn weights(&self) -> Option<Arc<Weights>> {
        self.current.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Shows the weights after `step` steps.
    ///
    /// # Errors
    /// Weights are not numbers; those of candle.
    pub fn show(&self, step: u64, model: Model) -> Result<()> {
        let weights = self.prepare(step, model)?;
        *self.current.write().unwrap_or_else(PoisonError::into_inner) = Some(Arc::new(weights));
        Ok(())
    }

    /// Shows a copy of the weights of a training that goes on.
    ///
    /// # Errors
    /// Those of [`ShownRun::show`].
    pub fn show_copy(&self, step: u64, model: &Model) -> Result<()> {
        let copied = |(_, var): (String, Var)| var.as_detached_tensor().copy();
        let values = model.variables().into_iter().map(copied).collect::<candle_core::Result<Vec<Tensor>>>()?;
        let copy = Model::from_parameters(&self.config, values)?.at_step(&self.config, step)?;
        self.show(step, copy)
    }

    fn prepare(&self, step: u64, model: Model) -> Result<Weights> {
        let ShownRun { config, scene, runtime, .. } = self;
        let viewer = Viewer { model: &model, config, scene, runtime };
        let full = viewer.renderer()?;
        let like = self.first_camera().with_height(FIRST_ROWS);
        let started = Instant::now();
        let rendered = viewer.render_unless(&*full, &like, MOST_RAYS, &mut || Ok(()))?;
        self.note_cost(None, rendered.acc.len(), started.elapsed());
        let depths = depth_range(&rendered.depth, Some(&rendered.acc)).unwrap_or((scene.near as f32, scene.far as f32));
        let fields = model.fields().ok().filter(|_| runtime.is_cpu());
        let perturbed =
            runtime.install(|| fields.map(|fields| PerturbedRenderer::new(fields, config, scene)).transpose())?;
        Ok(Weights { step, model, full, skipping: OnceLock::new(), perturbed, depths })
    }

    /// Returns the viewer of some of its weights.
    pub fn viewer<'a>(&'a self, weights: &'a Weights) -> Viewer<'a> {
        let ShownRun { config, scene, runtime, .. } = self;
        Viewer { model: &weights.model, config, scene, runtime }
    }

    /// Finds where the newest weights have no density, which takes seconds. From then on pictures leave that out, unless one
    /// would look different or little would be gained. `pause` is called between parts of the work, on the calling thread: it
    /// may wait, or end the work with an error.
    ///
    /// # Errors
    /// Those of `pause` and of candle.
    pub fn find_empty_space(&self, pause: &mut dyn FnMut() -> Result<()>) -> Result<()> {
        let ShownRun { config, scene, runtime, .. } = self;
        let Some(weights) = self.weights().filter(|_| runtime.is_cpu()) else { return Ok(()) };
        let Ok(fields) = weights.model.fields() else { return Ok(()) };
        if fields.occupancy().is_some() {
            // Its renderer leaves it out already.
            return Ok(());
        }
        let Some(mut skipping) = SkippingRenderer::new(fields, config, scene, runtime, pause)? else { return Ok(()) };
        let (viewer, like) = (self.viewer(&weights), self.first_camera().with_height(CHECKED_ROWS));
        let mut render = |renderer: &dyn Renderer| viewer.render_unless(renderer, &like, MOST_RAYS, pause);
        let mut full = None;
        for least_alpha in LEAST_ALPHAS {
            skipping.set_least_alpha(least_alpha);
            if skipping.occupied() > MOST_OCCUPIED {
                break;
            }
            let full = match &full {
                Some(full) => full,
                None => full.insert(render(&*weights.full)?.image.pixels),
            };
            if alike(&render(&skipping)?.image.pixels, full) {
                // Nobody else sets it.
                let _ = weights.skipping.set(skipping);
                break;
            }
        }
        Ok(())
    }

    /// Notes how long so many rays took, the last time.
    pub fn note_cost(&self, attack: Option<&Attack>, rays: usize, spent: Duration) {
        let sites = attack.map(|attack| attack.sites.clone()).unwrap_or_default();
        self.costs().insert(sites, spent.as_secs_f64() / rays as f64);
    }

    fn costs(&self) -> std::sync::MutexGuard<'_, HashMap<Vec<String>, f64>> {
        self.costs.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the camera for a picture that takes at most so many seconds by what pictures took before: with the same size, or
    /// a smaller one.
    pub fn camera_within(&self, camera: &Camera, seconds: f64, attack: Option<&Attack>) -> Camera {
        let costs = self.costs();
        let clean = || costs.get(&Vec::new()).copied().unwrap_or_default();
        let cost = match attack {
            Some(attack) => costs.get(&attack.sites).copied().unwrap_or_else(|| SEARCH_OVER_CLEAN * clean()),
            None => clean(),
        };
        let (width, height) = (camera.width as f64, camera.height as f64);
        let scale = (seconds / (cost * width * height)).sqrt();
        if scale >= 1.0 {
            return *camera;
        }
        // NaN, as for 0 seconds where nothing is known, gets the least.
        let side = |side: f64| (scale * side).max(LEAST_SIDE).min(side).round() as usize;
        camera.with_size(side(width), side(height))
    }

    /// Returns the camera of the first held-out view, or of the first training view.
    pub fn first_camera(&self) -> Camera {
        self.scene.test.first().or(self.scene.train.first()).expect("a scene has views").camera
    }
}

/// Returns whether two pictures differ little enough for the page.
fn alike(a: &[f32], b: &[f32]) -> bool {
    let sum: f64 = a.iter().zip(b).map(|(a, b)| f64::from((a - b).abs())).sum();
    sum / a.len() as f64 <= MOST_DIFFERENCE
}
