//! Rendering of an SRN.

use candle_core::{DType, Tensor};

use crate::base::Result;
use crate::data::Rays;
use crate::methods::{RenderedRays, Renderer};

use super::fast::{Lines, Network};
use super::network::Srn;

/// Marches rays from one depth, without noise.
pub struct SrnRenderer {
    srn: Srn,
    /// The weights in the layout of the march in f32 on the CPU, if it applies.
    network: Option<Network>,
}

impl SrnRenderer {
    /// Creates a renderer with the current parameters.
    pub fn new(srn: &Srn) -> Result<SrnRenderer> {
        let srn = srn.frozen();
        Ok(SrnRenderer { network: srn.is_fast().then(|| Network::of(&srn)).transpose()?, srn })
    }

    /// Returns colours from -1 to 1 `[rays, 3]`, and depths `[rays]` in scene units times `srn.scale`.
    fn march(&self, rays: &Rays) -> Result<(Tensor, Tensor)> {
        let (start, n) = (self.srn.config().start_depth, rays.len());
        let Some(network) = &self.network else {
            let z_0 = Tensor::full(start, (n, 1), rays.origins.device())?.to_dtype(rays.origins.dtype())?;
            let march = self.srn.march(rays, &z_0)?;
            return Ok((march.colour, march.z.squeeze(1)?));
        };
        let values = |tensor: &Tensor| tensor.to_dtype(DType::F32)?.flatten_all()?.to_vec1::<f32>();
        let [origins, directions, viewdirs] = [&rays.origins, &rays.directions, &rays.viewdirs].map(values);
        let (origins, directions, viewdirs) = (origins?, directions?, viewdirs?);
        let z_0 = vec![start as f32; n];
        let lines = Lines { origins: &origins, directions: &directions, viewdirs: &viewdirs, z_0: &z_0 };
        let tape = network.march(lines, false);
        let device = rays.origins.device();
        Ok((Tensor::from_vec(tape.colour, (n, 3), device)?, Tensor::from_vec(tape.z, n, device)?))
    }
}

impl Renderer for SrnRenderer {
    fn render(&self, rays: &Rays) -> Result<RenderedRays> {
        let (colour, z) = self.march(rays)?;
        Ok(RenderedRays {
            rgb: colour.affine(0.5, 0.5)?.clamp(0.0, 1.0)?,
            depth: (z / self.srn.config().scale)?,
            acc: Tensor::ones(rays.len(), colour.dtype(), colour.device())?,
        })
    }
}
