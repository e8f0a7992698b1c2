//! Local Light Field Fusion (Mildenhall et al. 2019), with its network trained on the scene: "LLFF (trained on the
//! scene)".
//!
//! Each training view becomes a multiplane image: a stack of planes of colour and alpha, evenly spaced in disparity. A
//! 3D network predicts it from the plane sweep of the view and its nearest neighbours. An image is blended from the
//! planes of the views nearest to its camera. The published LLFF uses one network that was trained on other scenes with
//! a perceptual loss, and is not available. Here the same architecture is trained on this scene's training views only.
//! Each step leaves one view out, and renders it from the planes of its neighbours, predicted without it. Held-out
//! views are never an input.
//!
//! Multiplane images are kept in 8 bits, as by the authors: `views * planes * height * width * 4` bytes. That is 24 MB
//! per view at 504 x 376 and 32 planes, and 412 MB for the 17 training views of fern. The prediction of a complete view
//! also holds the channels of its finest grid, about 1.2 GB there.

mod blend;
mod geometry;
mod learner;
mod mpi;
mod network;
mod predict;
mod renderer;
mod stage;
mod sweep;
mod windows;

#[cfg(test)]
mod tests;

use crate::base::Result;
use crate::data::Scene;
use crate::settings::Config;

pub use learner::PlanesLearner;
pub use network::MpiNetwork;
pub use renderer::PlanesRenderer;

impl MpiNetwork {
    /// Returns a renderer of `scene` with the current weights.
    ///
    /// # Errors
    /// If the method does not support the scene; those of candle.
    pub fn renderer(&self, config: &Config, scene: &Scene) -> Result<PlanesRenderer> {
        let stage = stage::Stage::new(config, scene)?;
        let mpis = self.mpis(&stage.views, &stage.depths)?;
        let eyes = mpi::eyes(&stage.views);
        Ok(PlanesRenderer { mpis, eyes, blend: config.llff.blend, background: stage.background })
    }
}
