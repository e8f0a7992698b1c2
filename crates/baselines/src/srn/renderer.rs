//! Rendering of an SRN.

use candle_core::Tensor;

use crate::base::Result;
use crate::data::Rays;
use crate::methods::{RenderedRays, Renderer};

use super::network::{Srn, SrnMarch};

/// Marches rays from one depth, without noise.
pub struct SrnRenderer {
    srn: Srn,
}

impl SrnRenderer {
    /// Creates a renderer with the current parameters.
    pub fn new(srn: &Srn) -> SrnRenderer {
        SrnRenderer { srn: srn.frozen() }
    }
}

impl Renderer for SrnRenderer {
    fn render(&self, rays: &Rays) -> Result<RenderedRays> {
        let (dtype, device) = (rays.origins.dtype(), rays.origins.device());
        let config = self.srn.config();
        let z_0 = Tensor::full(config.start_depth, (rays.len(), 1), device)?.to_dtype(dtype)?;
        let SrnMarch { z, colour } = self.srn.march(rays, &z_0)?;
        Ok(RenderedRays {
            rgb: colour.affine(0.5, 0.5)?.clamp(0.0, 1.0)?,
            depth: (z.squeeze(1)? / config.scale)?,
            acc: Tensor::ones(rays.len(), dtype, device)?,
        })
    }
}
