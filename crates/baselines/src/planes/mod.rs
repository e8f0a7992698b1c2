//! Local Light Field Fusion (Mildenhall et al. 2019), its network trained on the scene: "LLFF (trained on the scene)".
//!
//! Each training view becomes a multiplane image: a stack of planes of colour and alpha at equal distances in disparity, which a
//! 3D network predicts of what the view and its nearest neighbours see on these planes. A picture is blended of the planes of
//! the views nearest to its camera. The published LLFF uses one network that was trained on other scenes with a perceptual loss
//! and cannot be had; here the same architecture learns from this scene's training views alone: each step leaves one out, and
//! the planes of its neighbours, predicted without it, have to show it. Views that are held out are never an input.
//!
//! Multiplane images are kept in 8 bits, as the authors keep them: `views * planes * height * width * 4` bytes, 24 MB a view at
//! 504 x 376 and 32 planes, 412 MB for the 17 training views of fern. A prediction of a whole view holds its finest lattice's
//! channels beside that, about 1.2 GB there.

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
    /// What shows `scene` with the weights as they are now.
    ///
    /// # Errors
    /// A scene that the method cannot show; those of candle.
    pub fn renderer(&self, config: &Config, scene: &Scene) -> Result<PlanesRenderer> {
        let stage = stage::Stage::new(config, scene)?;
        let mpis = self.mpis(&stage.views, &stage.depths)?;
        let eyes = mpi::eyes(&stage.views);
        Ok(PlanesRenderer { mpis, eyes, blend: config.llff.blend, background: stage.background })
    }
}
