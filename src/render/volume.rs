//! Emission-absorption compositing along rays (paper, equation 1). Pure functions of tensors.

use candle_core::{D, Tensor};

use crate::error::Result;

/// Length of a ray's last interval, as in the original implementation: whatever density the last
/// sample has makes the ray opaque.
pub const LAST_INTERVAL: f64 = 1e10;

/// What a ray shows.
pub struct Composite {
    /// `[rays, 3]`, background included.
    pub rgb: Tensor,
    /// Sum of weight times t, `[rays]`, in the units of `t_vals`; not divided by `acc`.
    pub depth: Tensor,
    /// Sum of weights, `[rays]`, 0..=1.
    pub acc: Tensor,
    /// Probability that the ray ends in each interval, `[rays, samples]`.
    pub weights: Tensor,
}

/// Interval lengths in scene units, `[rays, samples]`: differences of `t_vals` times the length of
/// the direction `direction_norm` `[rays, 1]`, the last one [`LAST_INTERVAL`] long.
pub fn intervals(t_vals: &Tensor, direction_norm: &Tensor) -> Result<Tensor> {
    let (rays, samples) = t_vals.dims2()?;
    let gaps = (t_vals.narrow(1, 1, samples - 1)? - t_vals.narrow(1, 0, samples - 1)?)?;
    let last = Tensor::full(LAST_INTERVAL, (rays, 1), t_vals.device())?.to_dtype(t_vals.dtype())?;
    Ok(Tensor::cat(&[gaps, last], 1)?.broadcast_mul(direction_norm)?)
}

/// Weights of the samples: transmittance times alpha, with
/// T_k = exp(-sum over l < k of density_l * interval_l) and alpha_k = 1 - exp(-density_k * interval_k).
///
/// The exponent of a sum, not a product of factors: its gradient stays right where a factor is 0.
pub fn weights_from_density(density: &Tensor, intervals: &Tensor) -> Result<Tensor> {
    let (_, samples) = density.dims2()?;
    let optical = (density * intervals)?;
    let alpha = (1.0 - optical.neg()?.exp()?)?;
    // The last interval's huge depth takes no part: no sample lies behind it.
    let before = optical.narrow(1, 0, samples - 1)?.contiguous()?.matmul(&exclusive_sum(samples, density)?)?;
    Ok((alpha * before.neg()?.exp()?)?)
}

/// `[samples - 1, samples]`, 1 where row < column: right-multiplying sums over earlier samples.
fn exclusive_sum(samples: usize, like: &Tensor) -> Result<Tensor> {
    let values: Vec<f32> =
        (0..samples - 1).flat_map(|row| (0..samples).map(move |column| if row < column { 1.0 } else { 0.0 })).collect();
    Ok(Tensor::from_vec(values, (samples - 1, samples), like.device())?.to_dtype(like.dtype())?)
}

/// Composites `rgb` `[rays, samples, 3]` with `density` `[rays, samples]` (not negative) at
/// `t_vals` `[rays, samples]`. `background` fills what the ray's weights leave.
pub fn composite(
    rgb: &Tensor,
    density: &Tensor,
    t_vals: &Tensor,
    direction_norm: &Tensor,
    background: Option<[f32; 3]>,
) -> Result<Composite> {
    let weights = weights_from_density(density, &intervals(t_vals, direction_norm)?)?;
    let acc = weights.sum(D::Minus1)?;
    let depth = (&weights * t_vals)?.sum(D::Minus1)?;
    let row = weights.unsqueeze(1)?; // [rays, 1, samples]
    let mut colour = row.matmul(&rgb.contiguous()?)?.squeeze(1)?; // [rays, 3]
    if let Some(background) = background {
        let fill = Tensor::new(&background, rgb.device())?.to_dtype(rgb.dtype())?.reshape((1, 3))?;
        colour = (colour + (1.0 - &acc)?.unsqueeze(1)?.broadcast_mul(&fill)?)?;
    }
    Ok(Composite { rgb: colour, depth, acc, weights })
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{DType, Device};

    #[test]
    fn two_slabs_by_hand() {
        // density * interval = ln 2 twice: alpha 1/2, then 1/2 of the rest, then the opaque end.
        let ln2 = std::f64::consts::LN_2;
        let density = Tensor::new(&[[ln2, ln2, 1.0]], &Device::Cpu).unwrap();
        let t = Tensor::new(&[[1.0f64, 2.0, 3.0]], &Device::Cpu).unwrap();
        let rgb = Tensor::new(&[[[1.0f64, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]], &Device::Cpu).unwrap();
        let norm = Tensor::ones((1, 1), DType::F64, &Device::Cpu).unwrap();
        let out = composite(&rgb, &density, &t, &norm, None).unwrap();
        assert_eq!(out.weights.to_vec2::<f64>().unwrap()[0], [0.5, 0.25, 0.25]);
        assert_eq!(out.rgb.to_vec2::<f64>().unwrap()[0], [0.5, 0.25, 0.25]);
        assert_eq!(out.depth.to_vec1::<f64>().unwrap(), [0.5 + 0.5 + 0.75]);
        assert_eq!(out.acc.to_vec1::<f64>().unwrap(), [1.0]);
    }

    #[test]
    fn empty_space_shows_the_background() {
        let density = Tensor::zeros((1, 4), DType::F32, &Device::Cpu).unwrap();
        let t = Tensor::new(&[[0f32, 1.0, 2.0, 3.0]], &Device::Cpu).unwrap();
        let rgb = Tensor::ones((1, 4, 3), DType::F32, &Device::Cpu).unwrap();
        let norm = Tensor::ones((1, 1), DType::F32, &Device::Cpu).unwrap();
        let out = composite(&rgb, &density, &t, &norm, Some([1.0, 0.5, 0.0])).unwrap();
        assert_eq!(out.rgb.to_vec2::<f32>().unwrap()[0], [1.0, 0.5, 0.0]);
    }
}
