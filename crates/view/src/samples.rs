//! The samples along one ray, for the page's plot.

use serde::Serialize;

use crate::base::Result;
use crate::render::PassOutput;
use crate::render::volume::{middles, transmittance};

/// The samples of one ray in the evaluated pass.
#[derive(Serialize)]
pub struct RaySamples {
    /// Positions along the ray, in units of `t_vals`.
    t: Vec<f32>,
    /// Density, 1 / unit of space.
    density: Vec<f32>,
    /// Contribution to the colour, 0..=1.
    weights: Vec<f32>,
    /// Fraction of the light that reaches the camera from the sample, 0..=1.
    transmittance: Vec<f64>,
    /// Colour.
    rgb: Vec<[f32; 3]>,
    /// The rendered colour.
    pixel: [f32; 3],
}

impl RaySamples {
    /// Reads them from a pass of one ray, whose direction has length `norm`.
    ///
    /// # Errors
    /// Those of candle.
    pub fn of(out: &PassOutput, norm: f64) -> Result<RaySamples> {
        let row = |tensor: &candle_core::Tensor| tensor.flatten_all()?.to_vec1::<f32>();
        let (t_vals, density) = (row(&out.t_vals)?, row(&out.density)?);
        let t = row(&middles(&out.t_vals, density.len())?)?;
        let wide = |values: &[f32]| values.iter().copied().map(f64::from).collect::<Vec<f64>>();
        let transmittance = transmittance(&wide(&t_vals), &wide(&density), norm);
        let rgb = row(&out.rgb)?.as_chunks::<3>().0.to_vec();
        let pixel = row(&out.composite.rgb)?;
        let weights = row(&out.composite.weights)?;
        Ok(RaySamples { t, density, weights, transmittance, rgb, pixel: [pixel[0], pixel[1], pixel[2]] })
    }
}
