//! The over operator: alpha compositing of planes behind one another.
//!
//! Plane 0 is the farthest. Plane k has the weight `w_k = a_k prod (1 - a_j + 1e-10)`, over the nearer planes j. The
//! constant is LLFF's (Mildenhall et al. 2019, the authors' code), and keeps opaque planes from stopping all gradients.

use candle_core::{Result, Tensor};

/// Transmittance of an opaque plane.
const LEAK: f64 = 1e-10;

/// Numbers of a plane: red, green, blue, alpha.
const CHANNELS: usize = 4;

/// The transmittance along planes from the nearest on.
#[derive(Clone, Copy, Debug)]
pub struct Passing {
    transmittance: f64,
}

impl Default for Passing {
    fn default() -> Passing {
        Passing { transmittance: 1.0 }
    }
}

impl Passing {
    /// Returns the weight of the next plane.
    #[inline(always)]
    pub fn weight(&mut self, alpha: f64) -> f64 {
        let weight = alpha * self.transmittance;
        self.transmittance *= 1.0 - alpha + LEAK;
        weight
    }
}

/// Composites planes `[rays, planes, 4]` (RGBA, straight alpha). Returns the weighted sum of colours and the sum of
/// weights, `[rays, 4]`.
pub fn alpha_over(planes: &Tensor) -> Result<Tensor> {
    let (rays, count, _) = planes.dims3()?;
    let mut transmittance = Tensor::ones((rays, 1), planes.dtype(), planes.device())?;
    let mut sum = Tensor::zeros((rays, CHANNELS), planes.dtype(), planes.device())?;
    for k in (0..count).rev() {
        let plane = planes.narrow(1, k, 1)?.squeeze(1)?;
        let alpha = plane.narrow(1, CHANNELS - 1, 1)?;
        let weight = (&alpha * &transmittance)?;
        sum = (sum + Tensor::cat(&[&plane.narrow(1, 0, CHANNELS - 1)?.broadcast_mul(&weight)?, &weight], 1)?)?;
        transmittance = (transmittance * ((1.0 - alpha)? + LEAK)?)?;
    }
    Ok(sum)
}

#[cfg(test)]
mod tests;
