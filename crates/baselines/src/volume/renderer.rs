//! Rendering of a neural volume.

use crate::base::Result;
use crate::data::{Rays, Scene};
use crate::grids::march::{March, Pace};
use crate::methods::{RenderedRays, Renderer};
use crate::settings::Config;

use candle_core::Tensor;

use super::cube::Cube;
use super::decoder::Decoded;
use super::learner::WHITE;
use super::parameters::NeuralVolume;

/// Marches rays through a volume that was decoded once, with even steps.
pub struct VolumeRenderer {
    cube: Cube,
    decoded: Decoded,
    step: f64,
    background: [f32; 3],
}

impl VolumeRenderer {
    /// Creates a renderer with the current parameters and the code's mean.
    pub fn new(volume: &NeuralVolume, config: &Config, scene: &Scene) -> Result<VolumeRenderer> {
        Ok(VolumeRenderer {
            cube: volume.cube,
            decoded: volume.decode(&volume.code().0.detach(), true)?,
            step: config.nv.step_length(),
            background: scene.background.unwrap_or_default(),
        })
    }
}

impl Renderer for VolumeRenderer {
    fn render(&self, rays: &Rays) -> Result<RenderedRays> {
        let lines = self.cube.lines(&rays.origins, &rays.viewdirs)?;
        let march = March { lines, step: self.step, pace: Pace::Even };
        let out = march.forward(&self.decoded.template, self.decoded.warp.as_ref())?;
        let acc = out.narrow(1, 3, 1)?;
        let background = Tensor::new(&self.background, out.device())?.to_dtype(out.dtype())?;
        let behind = (1.0 - &acc)?.broadcast_mul(&background)?;
        let rgb = ((out.narrow(1, 0, 3)? / WHITE)? + behind)?.clamp(0.0, 1.0)?;
        // From the volume's lengths to the scene's, and from those to lengths of `directions`.
        let distance = (out.narrow(1, 4, 1)? * self.cube.half)?;
        let depth = (distance / rays.direction_norm.to_dtype(out.dtype())?)?.squeeze(1)?;
        Ok(RenderedRays { rgb, depth, acc: acc.squeeze(1)? })
    }
}
