//! Multiplane images of whole views, predicted once for weights and views and kept in 8 bits.

use std::sync::{Arc, PoisonError};

use candle_core::{DType, Tensor};
use sha2::{Digest, Sha256};

use crate::base::{Error, Image, Result};
use crate::data::vector::Vec3;
use crate::grids::mix::mix;
use crate::grids::over::Passing;
use crate::grids::planes::corners;

use super::geometry::{Eye, inputs_of};
use super::network::MpiNetwork;
use super::sweep::{Window, sweep};

/// What LLFF adds to stored alphas.
const ALPHA_FLOOR: f64 = 1e-8;

/// A view that planes are made of.
#[derive(Clone)]
pub struct Seen {
    /// Its camera.
    pub eye: Eye,
    /// Its picture.
    pub image: Arc<Image>,
}

impl Seen {
    fn is(&self, other: &Seen) -> bool {
        self.eye == other.eye && Arc::ptr_eq(&self.image, &other.image)
    }
}

/// Their cameras.
pub fn eyes(views: &[Seen]) -> Vec<Eye> {
    views.iter().map(|view| view.eye).collect()
}

/// One view's planes.
pub struct Mpi {
    /// Whose pixels they have.
    pub eye: Eye,
    /// RGBA, `[planes, height, width, 4]`, the farthest plane first, each number cut off to 8 bits.
    pub planes: Vec<u8>,
}

/// What a ray meets of a multiplane image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Met {
    /// Colour times what it counts.
    pub rgb: [f64; 3],
    /// Sum of weights.
    pub acc: f64,
    /// Sum of weights times the ray's t.
    pub depth: f64,
}

/// A number of 0..=1 in 8 bits, as LLFF writes it: cut off, not rounded.
pub fn stored(value: f64) -> u8 {
    (255.0 * value.clamp(0.0, 1.0)) as u8
}

impl Mpi {
    /// From RGBA of a window around a whole view, `[planes, height, width, 4]`: what is beyond the view is cut off.
    ///
    /// # Errors
    /// Those of candle.
    pub fn new(eye: Eye, rgba: &Tensor) -> Result<Mpi> {
        let (_, height, width, _) = rgba.dims4()?;
        let (rows, columns) = (eye.camera.height, eye.camera.width);
        let values = rgba.to_dtype(DType::F32)?.flatten_all()?.to_vec1::<f32>()?;
        let lines = values.chunks_exact(4 * width).enumerate().filter(|(line, _)| line % height < rows);
        let planes =
            lines.flat_map(|(_, line)| line[..4 * columns].iter().map(|value| stored((*value).into()))).collect();
        Ok(Mpi { eye, planes })
    }

    /// What a ray meets, from the nearest plane on.
    pub fn meet(&self, origin: Vec3, direction: Vec3, depths: &[f64], places: &mut [([f64; 2], f64)]) -> Met {
        self.eye.hits(origin, direction, depths, |k, pixel, t| places[k] = (pixel, t));
        let (width, height) = (self.eye.camera.width, self.eye.camera.height);
        let (mut met, mut passing) = (Met::default(), Passing::default());
        for (plane, (pixel, t)) in self.planes.chunks_exact(4 * width * height).zip(&*places).rev() {
            let (mut colour, mut alpha) = ([0f64; 3], 0.0);
            for (pixel, share) in corners(*pixel, width, height) {
                let [r, g, b, a]: [u8; 4] = std::array::from_fn(|c| plane[4 * pixel + c]);
                [r, g, b].iter().zip(&mut colour).for_each(|(c, sum)| *sum += share * f64::from(*c) / 255.0);
                alpha += share * (f64::from(a) / 255.0 + ALPHA_FLOOR).min(1.0);
            }
            if alpha > 0.0 {
                let weight = passing.weight(alpha);
                met.rgb.iter_mut().zip(colour).for_each(|(sum, c)| *sum += weight * c);
                met.acc += weight;
                met.depth += weight * t;
            }
        }
        met
    }
}

/// The multiplane images of a scene's training views.
pub struct Mpis {
    /// One of each view.
    pub all: Vec<Mpi>,
    /// Depths of the planes, the farthest first.
    pub depths: Vec<f64>,
}

/// Multiplane images with all that they were made of.
pub struct Kept {
    weights: [u8; 32],
    depths: Vec<f64>,
    views: Vec<Seen>,
    mpis: Arc<Mpis>,
}

impl MpiNetwork {
    /// The multiplane images of all `views`, by these weights as they are now. What was predicted before is handed out again
    /// where weights, views and depths are the same: a picture after another costs no second prediction.
    ///
    /// # Errors
    /// Weights that are not numbers; those of candle.
    pub fn mpis(&self, views: &[Seen], depths: &[f64]) -> Result<Arc<Mpis>> {
        let weights = self.digest()?;
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = &*kept {
            let same_views = known.views.len() == views.len() && known.views.iter().zip(views).all(|(a, b)| a.is(b));
            if known.weights == weights && known.depths == depths && same_views {
                return Ok(known.mpis.clone());
            }
        }
        // Before the new ones take their memory.
        *kept = None;
        let all = (0..views.len()).map(|view| self.predict(views, view, depths)).collect::<Result<_>>()?;
        let mpis = Arc::new(Mpis { all, depths: depths.to_vec() });
        *kept = Some(Kept { weights, depths: depths.to_vec(), views: views.to_vec(), mpis: mpis.clone() });
        Ok(mpis)
    }

    /// The multiplane image of one view: threads share the work of each operation.
    ///
    /// # Errors
    /// Weights that are not numbers; those of candle.
    pub fn predict(&self, views: &[Seen], view: usize, depths: &[f64]) -> Result<Mpi> {
        let eyes = eyes(views);
        let eye = eyes[view];
        let seen: Vec<(&Eye, &Image)> = inputs_of(&eyes, view, self.inputs(), None)
            .into_iter()
            .map(|input| (&views[input].eye, &*views[input].image))
            .collect();
        let window = Window::whole(eye.camera.width, eye.camera.height);
        let volume = sweep(&eye, &seen, depths, window, self.dtype(), self.device())?;
        let raw = self.weights(false).forward(&volume)?;
        let sum = raw.sum_all()?.to_dtype(DType::F64)?.to_scalar::<f64>()?;
        if !sum.is_finite() {
            return Err(Error::Diverged(format!(
                "the planes of training view {view} are not numbers: the weights are broken; delete the newest checkpoint to fall \
                 back on the one before it"
            )));
        }
        Mpi::new(eye, &mix(&raw, &volume)?)
    }

    /// A hash of all weights.
    fn digest(&self) -> Result<[u8; 32]> {
        let mut digest = Sha256::new();
        for (_, var) in self.variables() {
            let values = var.as_detached_tensor().flatten_all()?.to_dtype(DType::F64)?.to_vec1::<f64>()?;
            let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
            digest.update(bytes);
        }
        Ok(digest.finalize().into())
    }
}
