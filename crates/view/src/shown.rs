//! A run on the page, with its newest weights.

use std::path::Path;
use std::sync::{Arc, RwLock};

use candle_core::{Tensor, Var};

use crate::base::{Listener, Result};
use crate::data::{Camera, Scene};
use crate::draw::depth_range;
use crate::methods::Renderer;
use crate::model::Model;
use crate::run::{OpenOptions, Trained, Viewer};
use crate::runtime::Runtime;
use crate::settings::Resolved;

use super::perturbed::PerturbedRenderer;
use super::skipping::SkippingRenderer;

/// Height of the picture by which the skipping renderer is compared with the full one, and the range of depth is found.
const CHECKED_ROWS: usize = 64;
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
}

/// A run's weights at one step, with what renders them.
pub struct Weights {
    /// Finished steps.
    pub step: u64,
    /// The model.
    pub model: Model,
    /// Renders the clean pass.
    pub renderer: Box<dyn Renderer>,
    /// Renders with the attack's deltas. `None` for methods without fields, and on other devices than the processor.
    pub perturbed: Option<PerturbedRenderer>,
    /// The fraction of space that is not empty, if the renderer leaves empty space out.
    pub occupied: Option<f64>,
    /// Nearest and farthest depth of the colour scale, in units of `t_vals`.
    pub depths: (f32, f32),
}

impl ShownRun {
    /// Opens the newest checkpoint of a run folder. Its scene is at its old path, or in `data`. Other commands may use the run
    /// meanwhile, a training too: all that is shown is in memory.
    ///
    /// # Errors
    /// Those of [`Trained::open_at`]; weights are not numbers.
    pub fn open(folder: &Path, data: Option<&Path>, runtime: &Runtime, events: &dyn Listener) -> Result<ShownRun> {
        let options = OpenOptions { beside_training: true, ..OpenOptions::default() };
        let Trained { config, scene, state, model, runtime, .. } =
            Trained::open_at(folder, options, data, runtime, events)?;
        let label =
            folder.file_name().map_or_else(|| folder.display().to_string(), |name| name.to_string_lossy().into_owned());
        let shown = ShownRun::of_training(label, config, scene, runtime);
        shown.show(state.step, model, true)?;
        Ok(shown)
    }

    /// Creates a run whose weights come later, from a training in this process.
    pub fn of_training(label: String, config: Resolved, scene: Scene, runtime: Runtime) -> ShownRun {
        let steps = config.train.steps;
        ShownRun { label, config, scene, runtime, steps, current: RwLock::new(None) }
    }

    /// Returns the newest weights, if there are some.
    pub fn weights(&self) -> Option<Arc<Weights>> {
        self.current.read().unwrap_or_else(std::sync::PoisonError::into_inner).clone()
    }

    /// Shows the weights after `step` steps. `skips` allows a renderer that leaves empty space out, which takes seconds to make.
    ///
    /// # Errors
    /// Weights are not numbers; those of candle.
    pub fn show(&self, step: u64, model: Model, skips: bool) -> Result<()> {
        let weights = self.runtime.install(|| self.prepare(step, model, skips))?;
        *self.current.write().unwrap_or_else(std::sync::PoisonError::into_inner) = Some(Arc::new(weights));
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
        self.show(step, copy, false)
    }

    fn prepare(&self, step: u64, model: Model, skips: bool) -> Result<Weights> {
        let ShownRun { config, scene, runtime, .. } = self;
        let viewer = Viewer { model: &model, config, scene, runtime };
        let full = viewer.renderer()?;
        let like = self.first_camera().with_height(CHECKED_ROWS);
        let rendered = viewer.render_with(&*full, &like)?;
        let depths = depth_range(&rendered.depth, Some(&rendered.acc)).unwrap_or((scene.near as f32, scene.far as f32));
        let fields = model.fields().ok().filter(|_| runtime.is_cpu());
        let perturbed = fields.map(|fields| PerturbedRenderer::new(fields, config, scene)).transpose()?;
        let skipping =
            fields.filter(|_| skips).map(|fields| SkippingRenderer::new(fields, config, scene)).transpose()?.flatten();
        let skipping =
            skipping.map(|skipping| faithful(skipping, &viewer, &like, &rendered.image.pixels)).transpose()?.flatten();
        let (renderer, occupied): (Box<dyn Renderer>, _) = match skipping {
            Some(skipping) => {
                let occupied = skipping.occupied();
                (Box::new(skipping), Some(occupied))
            }
            None => (full, None),
        };
        Ok(Weights { step, model, renderer, perturbed, occupied, depths })
    }

    /// Returns the camera of the first held-out view, or of the first training view.
    pub fn first_camera(&self) -> Camera {
        self.scene.test.first().or(self.scene.train.first()).expect("a scene has views").camera
    }
}

/// Returns the renderer with the most empty space whose picture from `like` is as the full renderer's, if there is one.
fn faithful(
    mut skipping: SkippingRenderer,
    viewer: &Viewer,
    like: &Camera,
    full: &[f32],
) -> Result<Option<SkippingRenderer>> {
    for least_alpha in LEAST_ALPHAS {
        skipping.set_least_alpha(least_alpha);
        if skipping.occupied() > MOST_OCCUPIED {
            return Ok(None);
        }
        if alike(&viewer.render_with(&skipping, like)?.image.pixels, full) {
            return Ok(Some(skipping));
        }
    }
    Ok(None)
}

/// Returns whether two pictures differ little enough for the page.
fn alike(a: &[f32], b: &[f32]) -> bool {
    let sum: f64 = a.iter().zip(b).map(|(a, b)| f64::from((a - b).abs())).sum();
    sum / a.len() as f64 <= MOST_DIFFERENCE
}
