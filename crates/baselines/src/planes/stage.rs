//! The training views as the method sees them, and what it refuses.

use crate::base::{Error, Result};
use crate::data::{Camera, Scene};
use crate::runtime::free_memory_mib;
use crate::settings::Config;

use super::geometry::{Viewpoint, depths};
use super::mpi::SourceView;
use super::sweep::padded;

/// Views that learning takes at the least: one that is left out, one whose planes are predicted, one beside it.
const FEWEST_VIEWS: usize = 3;

/// Bytes of a plane's pixel that stays: RGBA.
const KEPT_BYTES: f64 = 4.0;

/// Bytes of a cell of the finest lattice while a view is predicted, at the last layers: a layer's input, its product and the
/// normalised result, 8 channels each, and what coarser lattices keep.
const PREDICTED_BYTES: f64 = 4.0 * 3.0 * 8.0 + 37.0;

/// And of each input view's colour in the plane sweep, which the mixture needs at the end.
const SWEPT_BYTES: f64 = 4.0 * 3.0;

/// What learning and painting have in common. Views that are held out are no part of it.
#[derive(Clone)]
pub struct Stage {
    /// The training views.
    pub views: Vec<SourceView>,
    /// Depths of every view's planes, the farthest first.
    pub depths: Vec<f64>,
    /// What is behind everything.
    pub background: Option<[f32; 3]>,
}

impl Stage {
    /// Of the training views of `scene`.
    ///
    /// # Errors
    /// A scene that the method has no use for.
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
    /// Refuses views whose planes take more memory than this machine has free, predicted of `inputs` views each. Those of all
    /// views are counted, which a path around the scene needs.
    ///
    /// # Errors
    /// [`Error::Config`] with what is needed and what is free.
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
                "llff.planes = {}: the planes of {} training views take {:.1} GiB once pictures from all sides are rendered, and {:.1} \
                 GiB are free here; choose fewer planes, or shrink the pictures by data.downscale",
                self.depths.len(),
                self.views.len(),
                mib / 1024.0,
                free / 1024.0
            ))),
            _ => Ok(()),
        }
    }
}

/// Depths of the nearest and the farthest plane.
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
            "data.ndc = true does not suit method llff, whose planes stand in the scene itself; set data.ndc=false"
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
            "training view {} has a mask, and method llff would show what is under it: its colours are those of whole views; use nerf, \
             or remove the masks",
            view.name
        )));
    }
    Ok(())
}
