//! Multiplane images of complete views, kept in 8 bits.

use std::sync::{Arc, OnceLock};

use candle_core::{DType, Tensor};

use crate::base::{Image, Result};
use crate::data::vector::Vec3;
use crate::grids::alpha_over::Passing;
use crate::grids::planes::corners;

use super::geometry::Viewpoint;

/// Constant that LLFF adds to stored alphas.
const ALPHA_FLOOR: f64 = 1e-8;

/// A view from which planes are predicted.
#[derive(Clone)]
pub struct SourceView {
    /// Its camera.
    pub eye: Viewpoint,
    /// Its image.
    pub image: Arc<Image>,
}

impl SourceView {
    /// Returns whether it is the same image with the same camera.
    pub fn is(&self, other: &SourceView) -> bool {
        self.eye == other.eye && Arc::ptr_eq(&self.image, &other.image)
    }
}

/// Returns the cameras of views.
pub fn eyes(views: &[SourceView]) -> Vec<Viewpoint> {
    views.iter().map(|view| view.eye).collect()
}

/// One view's planes.
pub struct Mpi {
    /// The camera whose pixels they have.
    pub eye: Viewpoint,
    /// RGBA, `[planes, height, width, 4]`, the farthest plane first, each number truncated to 8 bits.
    pub planes: Vec<u8>,
}

/// The composited sample of a multiplane image along a ray.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MpiSample {
    /// Weighted sum of colours.
    pub rgb: [f64; 3],
    /// Sum of weights.
    pub acc: f64,
    /// Sum of weights times the ray's t.
    pub depth: f64,
}

/// Returns a number of 0..=1 in 8 bits, as LLFF writes it: truncated, not rounded.
pub fn stored(value: f64) -> u8 {
    (255.0 * value.clamp(0.0, 1.0)) as u8
}

impl Mpi {
    /// Creates a multiplane image from RGBA of a window around a complete view, `[planes, height, width, 4]`. What is
    /// beyond the view is cut off.
    pub fn new(eye: Viewpoint, rgba: &Tensor) -> Result<Mpi> {
        let (_, height, width, _) = rgba.dims4()?;
        let (rows, columns) = (eye.camera.height, eye.camera.width);
        let values = rgba.to_dtype(DType::F32)?.flatten_all()?.to_vec1::<f32>()?;
        let lines = values.chunks_exact(4 * width).enumerate().filter(|(line, _)| line % height < rows);
        let planes =
            lines.flat_map(|(_, line)| line[..4 * columns].iter().map(|value| stored((*value).into()))).collect();
        Ok(Mpi { eye, planes })
    }

    /// Composites the planes along a ray, from the nearest on.
    pub fn sample(&self, origin: Vec3, direction: Vec3, depths: &[f64], places: &mut [([f64; 2], f64)]) -> MpiSample {
        self.eye.hits(origin, direction, depths, |k, pixel, t| places[k] = (pixel, t));
        let (width, height) = (self.eye.camera.width, self.eye.camera.height);
        let (mut sample, mut passing) = (MpiSample::default(), Passing::default());
        for (plane, (pixel, t)) in self.planes.chunks_exact(4 * width * height).zip(&*places).rev() {
            let (mut colour, mut alpha) = ([0f64; 3], 0.0);
            for (pixel, share) in corners(*pixel, width, height) {
                let [r, g, b, a]: [u8; 4] = std::array::from_fn(|c| plane[4 * pixel + c]);
                [r, g, b].iter().zip(&mut colour).for_each(|(c, sum)| *sum += share * f64::from(*c) / 255.0);
                alpha += share * (f64::from(a) / 255.0 + ALPHA_FLOOR).min(1.0);
            }
            if alpha > 0.0 {
                let weight = passing.weight(alpha);
                sample.rgb.iter_mut().zip(colour).for_each(|(sum, c)| *sum += weight * c);
                sample.acc += weight;
                sample.depth += weight * t;
            }
        }
        sample
    }
}

/// Predicts the multiplane image of one of some views, given its index and the depths.
pub type Predict = Box<dyn Fn(&[SourceView], usize, &[f64]) -> Result<Mpi> + Send + Sync>;

/// The multiplane images of a scene's training views with fixed weights. Each is predicted when it is first needed: an
/// image needs only those near its camera.
pub struct Mpis {
    /// The views from which they are predicted.
    pub views: Vec<SourceView>,
    /// Depths of the planes, the farthest first.
    pub depths: Vec<f64>,
    predict: Predict,
    predicted: Vec<OnceLock<Mpi>>,
}

impl Mpis {
    /// Creates the images, none of them predicted.
    pub fn new(views: &[SourceView], depths: &[f64], predict: Predict) -> Mpis {
        let predicted = views.iter().map(|_| OnceLock::new()).collect();
        Mpis { views: views.to_vec(), depths: depths.to_vec(), predict, predicted }
    }

    /// Predicts the image of a view, unless it is there.
    ///
    /// # Errors
    /// Those of the prediction.
    pub fn make(&self, view: usize) -> Result<()> {
        if self.predicted[view].get().is_none() {
            self.keep(view, (self.predict)(&self.views, view, &self.depths)?);
        }
        Ok(())
    }

    /// Stores the image of a view, unless it is there. Another thread may have stored the same numbers first.
    pub fn keep(&self, view: usize, mpi: Mpi) {
        let _ = self.predicted[view].set(mpi);
    }

    /// Returns the image of a view.
    ///
    /// # Errors
    /// If it was not made: rays are rendered from an origin that was not prepared.
    pub fn of(&self, view: usize) -> Result<&Mpi> {
        let missing = || candle_core::Error::Msg(format!("the planes of training view {view} are not prepared"));
        Ok(self.predicted[view].get().ok_or_else(missing)?)
    }
}

/// Multiplane images with what they depend on.
pub struct CachedMpis {
    /// Hash of the network's weights.
    pub weights: [u8; 32],
    /// The images.
    pub mpis: Arc<Mpis>,
}
