//! The cube of the scene that a volume fills.

use std::sync::Arc;

use candle_core::{DType, Tensor};

use crate::base::{Error, Result};
use crate::grids::march::Line;
use crate::settings::Config;

/// Its middle and half its side, in scene units. The volume's own coordinates are -1 to 1 in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cube {
    pub(super) middle: [f64; 3],
    pub(super) half: f64,
}

impl Cube {
    /// Returns the cube of a configuration.
    ///
    /// # Errors
    /// [`Error::Config`] if it is open.
    pub(super) fn of(config: &Config) -> Result<Cube> {
        let (middle, half) = config.nv.cube().ok_or_else(|| {
            Error::Config(
                "nv.bounds is empty, and this capture's cameras look at no common point: give two corners, in scene units, \
                 of the box that the volume is to fill, as nv.bounds=[[-1, -1, -1], [1, 1, 1]]"
                    .into(),
            )
        })?;
        Ok(Cube { middle, half })
    }

    /// Returns rays from tensors of origins and unit directions, each `[rays, 3]`.
    pub(super) fn lines(&self, origins: &Tensor, viewdirs: &Tensor) -> Result<Arc<[Line]>> {
        let [origins, directions] = [origins, viewdirs].map(|tensor| tensor.to_dtype(DType::F64)?.to_vec2::<f64>());
        let line = |(origin, direction): (Vec<f64>, Vec<f64>)| {
            let (origin, direction) = ([0, 1, 2].map(|i| origin[i]), [0, 1, 2].map(|i| direction[i]));
            // Unit vectors in f32 have length 1 only to 1e-7.
            let length = direction.iter().map(|d| d * d).sum::<f64>().sqrt();
            Line {
                origin: [0, 1, 2].map(|i| (origin[i] - self.middle[i]) / self.half),
                direction: direction.map(|d| d / length),
            }
        };
        Ok(origins?.into_iter().zip(directions?).map(line).collect())
    }
}
