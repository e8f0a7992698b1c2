//! The training views as the method needs them, and scenes that it does not support.

use crate::base::{Error, Result};
use crate::data::{Camera, Scene};
use crate::runtime::free_memory_mib;
use crate::settings::Config;

use super::geometry::{Viewpoint, depths};
use super::mpi::SourceView;
use super::sweep::padded;

/// Fewest views for training: one that is left out, one whose planes are predicted, and one neighbour.
const FEWEST_VIEWS: usize = 3;

/// Bytes of a stored plane's pixel: RGBA.
const KEPT_BYTES: f64 = 4.0;

/// Bytes per cell of the finest grid while a view is predicted, at the last layers: a layer's input, its product and
/// the normalized result, 8 channels each, and what coarser grids keep.
const PREDICTED_BYTES: f64 = 4.0 * 3.0 * 8.0 + 37.0;

/// Bytes of each input view's colour in the plane sweep, which the blending needs at the end.
const SWEPT_BYTES: f64 = 4.0 * 3.0;

/// The common inputs of training and rendering. Held-out views are no part of it.
#[derive(Clone)]
pub struct Stage {
    /// The training views.
    pub views: Vec<SourceView>,
    /// Depths of every view's planes, the farthest first.
    pub depths: Vec<f64>,
    /// The background colour.
    pub background: Option<[f32; 3]>,
}

impl Stage {
    /// Creates the stage from the training views of `scene`.
    ///
    /// # Errors
    /// If the method does not support the scene.
    pub fn new(config: &Config, scene: &Scene) -> Result<Stage> {
        check(scene)?;
        let shift = config.data.origin_of_pixels().shift();
        let seen = |camera: Camera| Viewpoint { camera, shift };
        let views =
            scene.train.iter().map(|view| SourceView { eye: seen(view.camera), image: view.image.clone() }).collect();
        let (near, far) = bounds(config, scene)?;
        Ok(Stage { views, depths: depths(near, far, config.llff.planes), background: scene.background })
    }
}

impl Stage {
    /// Returns an error for views whose planes need more memory than this machine has free, predicted from `inputs`
    /// views each. All views count, since a path around the scene needs them.
    ///
    /// # Errors
    /// [`Error::Config`] with the needed and the free memory.
    pub fn check_memory(&self, inputs: usize) -> Result<()> {
        let side = |size: usize| padded(size) as f64;
        let cells =
            |view: &SourceView| side(view.eye.camera.width) * side(view.eye.camera.height) * self.depths.len() as f64;
        let (all, largest) =
            self.views.iter().map(cells).fold((0.0, 0f64), |(all, largest), n| (all + n, largest.max(n)));
        let predicted = PREDICTED_BYTES + SWEPT_BYTES * inputs as f64;
        let mib = (all * KEPT_BYTES + largest * predicted) / f64::from(1 << 20);
        match free_memory_mib() {
            Some(free) if mib > free => Err(Error::Config(format!(
                "llff.planes = {}: the planes of {} training views take {:.1} GiB once images from all sides are rendered, and {:.1} \
                 GiB are free here; choose fewer planes, or reduce the images with data.downscale",
                self.depths.len(),
                self.views.len(),
                mib / 1024.0,
                free / 1024.0
            ))),
            _ => Ok(()),
        }
    }
}

/// Returns the depths of the nearest and the farthest plane.
fn bounds(config: &Config, scene: &Scene) -> Result<(f64, f64)> {
    let near = config.llff.near.unwrap_or(scene.near);
    let far = config.llff.far.unwrap_or(scene.far);
    match near > 0.0 && near < far {
        true => Ok((near, far)),
        false => Err(Error::Config(format!(
            "llff.near = {near} and llff.far = {far}, where they are empty the scene's own, make no planes: disparities are even \
             from one to the other; give 0 < llff.near < llff.far"
        ))),
    }
}

fn check(scene: &Scene) -> Result<()> {
    if scene.ndc.is_some() {
        return Err(Error::Config(
            "data.ndc = true does not suit method llff, whose planes are in the scene's own units; set data.ndc=false"
                .into(),
        ));
    }
    if scene.train.len() < FEWEST_VIEWS {
        return Err(Error::Config(format!(
            "method llff learns from views that it leaves out and needs at least {FEWEST_VIEWS} training views; {} leaves {}: hold \
             out fewer (data.holdout, data.validation, data.train_views), or use another method",
            scene.name,
            scene.train.len()
        )));
    }
    if let Some(view) = scene.train.iter().find(|view| view.mask.is_some()) {
        return Err(Error::Config(format!(
            "training view {} has a mask, which method llff does not support: it would show what is under the mask; use nerf, \
             or remove the masks",
            view.name
        )));
    }
    Ok(())
}
