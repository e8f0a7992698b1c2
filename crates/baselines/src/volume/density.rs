//! A neural volume's density in space: opacity per length, looked up through the warp.

use candle_core::{DType, Device, Tensor, Var};

use crate::base::Result;
use crate::field::Density;
use crate::grids::trilinear::{Outside, trilinear};

use super::cube::Cube;
use super::decoder::Decoded;
use super::learner::WHITE;
use super::parameters::NeuralVolume;

/// The density of a volume with its current parameters.
pub struct VolumeDensity {
    decoded: Decoded,
    cube: Cube,
}

impl VolumeDensity {
    /// Creates the density of the code's mean.
    pub fn new(volume: &NeuralVolume) -> Result<VolumeDensity> {
        Ok(VolumeDensity { decoded: volume.decode(&volume.code().0.detach(), true)?, cube: volume.cube })
    }

    /// Returns red, green, blue from 0 to 255 and opacity per scene unit, `[n, 4]`; 0 outside the box.
    fn values(&self, points: &Tensor) -> Result<Tensor> {
        let Cube { middle, half } = self.cube;
        let middle = Tensor::new(&middle, points.device())?.to_dtype(points.dtype())?;
        let at = (points.broadcast_sub(&middle)? / half)?;
        let inside = at.detach().abs()?.max_keepdim(1)?.lt(1.0)?.to_dtype(points.dtype())?;
        let at = match &self.decoded.warp {
            Some(warp) => trilinear(warp, &at, Outside::Zeros)?,
            None => at,
        };
        let units = Tensor::new(&[1.0, 1.0, 1.0, 1.0 / half], points.device())?.to_dtype(points.dtype())?;
        let values = trilinear(&self.decoded.template, &at, Outside::Zeros)?;
        Ok(values.broadcast_mul(&units)?.broadcast_mul(&inside)?)
    }
}

impl Density for VolumeDensity {
    fn density(&self, points: &Tensor, _variance: [f64; 3]) -> Result<Tensor> {
        Ok(self.values(points)?.narrow(1, 3, 1)?.squeeze(1)?.contiguous()?)
    }

    fn gradient(&self, points: &Tensor, variance: [f64; 3]) -> Result<Tensor> {
        let points = Var::from_tensor(&points.contiguous()?)?;
        let store = self.density(&points, variance)?.sum_all()?.backward()?;
        Ok(store.get(&points).map_or_else(|| points.zeros_like(), |gradient| Ok(gradient.detach()))?)
    }

    fn rgb(&self, points: &Tensor, _variance: [f64; 3], _viewdirs: &Tensor) -> Result<Tensor> {
        Ok((self.values(points)?.narrow(1, 0, 3)? / WHITE)?.clamp(0.0, 1.0)?)
    }

    fn dtype(&self) -> DType {
        self.decoded.template.dtype()
    }

    fn device(&self) -> &Device {
        self.decoded.template.device()
    }
}
