//! Emission-absorption compositing along rays (Aug-NeRF paper, equation 1). Pure functions of tensors.

use candle_core::{D, DType, Tensor};

use crate::base::Result;
use crate::base::place::is_ours_in_f32;
use augnerf_fast::scan;

/// Length of a ray's last interval, as in the original implementation. Any density at the last sample makes the ray
/// opaque.
pub const LAST_INTERVAL: f64 = 1e10;

/// Rendered rays.
pub struct Composite {
    /// `[rays, 3]`, including the background.
    pub rgb: Tensor,
    /// Sum of weight times t, `[rays]`, in the units of `t_vals`. It is not divided by `acc`.
    pub depth: Tensor,
    /// Sum of weights, `[rays]`, 0..=1.
    pub acc: Tensor,
    /// Probability that the ray ends in each interval, `[rays, samples]`.
    pub weights: Tensor,
}

/// Returns the lengths of `samples` intervals in scene units, `[rays, samples]`. They are the differences of `t_vals`
/// times the length of the direction, `direction_norm` `[rays, 1]`. With points `[rays, samples]` the last interval is
/// [`LAST_INTERVAL`] long in units of `t_vals`. Edges `[rays, samples + 1]` (MipNeRF) bound every interval.
pub fn intervals(t_vals: &Tensor, direction_norm: &Tensor, samples: usize) -> Result<Tensor> {
    let (rays, columns) = t_vals.dims2()?;
    let gaps = (t_vals.narrow(1, 1, columns - 1)? - t_vals.narrow(1, 0, columns - 1)?)?;
    if columns > samples {
        return Ok(gaps.broadcast_mul(direction_norm)?);
    }
    let last = Tensor::full(LAST_INTERVAL, (rays, 1), t_vals.device())?.to_dtype(t_vals.dtype())?;
    Ok(Tensor::cat(&[gaps, last], 1)?.broadcast_mul(direction_norm)?)
}

/// Returns the weights of the samples: transmittance times alpha, with T_k = exp(-sum over l < k of density_l *
/// interval_l) and alpha_k = 1 - exp(-density_k * interval_k).
///
/// It is the exponential of a sum, not a product of factors, so that the gradient is right if a factor is 0.
pub fn weights_from_density(density: &Tensor, intervals: &Tensor) -> Result<Tensor> {
    let (_, samples) = density.dims2()?;
    let optical = (density * intervals)?;
    let alpha = (1.0 - optical.neg()?.exp()?)?;
    // The last interval's huge depth is not included, because no sample is behind it. In f64, because devices may be
    // told to round single-precision products.
    let earlier = optical.narrow(1, 0, samples - 1)?.to_dtype(DType::F64)?.contiguous()?;
    let before = earlier.matmul(&exclusive_sum(samples, density)?)?.to_dtype(density.dtype())?;
    Ok((alpha * before.neg()?.exp()?)?)
}

/// Returns `[samples - 1, samples]`, with 1 where row < column. Multiplied from the right, it sums over earlier
/// samples.
fn exclusive_sum(samples: usize, like: &Tensor) -> Result<Tensor> {
    let values: Vec<f64> =
        (0..samples - 1).flat_map(|row| (0..samples).map(move |column| if row < column { 1.0 } else { 0.0 })).collect();
    Ok(Tensor::from_vec(values, (samples - 1, samples), like.device())?)
}

/// Returns the transmittance T_k before each sample of one ray whose direction has length `norm`. `density` `[samples]`
/// is at, or between, `t_vals` (see [`intervals`]).
pub fn transmittance(t_vals: &[f64], density: &[f64], norm: f64) -> Vec<f64> {
    let mut depth = 0.0;
    let before = density.iter().enumerate().map(|(k, density)| {
        let before = f64::exp(-depth);
        let length = t_vals.get(k + 1).map_or(LAST_INTERVAL, |next| next - t_vals[k]);
        depth += density * (length * norm);
        before
    });
    before.collect()
}

/// Returns the positions of `samples` samples, `[rays, samples]`: points, or the middles of intervals.
pub fn middles(t_vals: &Tensor, samples: usize) -> Result<Tensor> {
    if t_vals.dim(1)? == samples {
        return Ok(t_vals.clone());
    }
    Ok(((t_vals.narrow(1, 0, samples)? + t_vals.narrow(1, 1, samples)?)? * 0.5)?)
}

/// Composites `rgb` `[rays, samples, 3]` with `density` `[rays, samples]` (at least 0) at `t_vals` `[rays, samples]`,
/// or between edges `[rays, samples + 1]`. `background` shows where the ray's weights sum to less than 1.
pub fn composite(
    rgb: &Tensor,
    density: &Tensor,
    t_vals: &Tensor,
    direction_norm: &Tensor,
    background: Option<[f32; 3]>,
) -> Result<Composite> {
    if !is_ours_in_f32(rgb) {
        return composite_reference(rgb, density, t_vals, direction_norm, background);
    }
    let (rays, samples) = density.dims2()?;
    let out = scan::composite([rgb, density, t_vals], direction_norm, LAST_INTERVAL, background)?;
    Ok(Composite {
        rgb: out.narrow(0, 0, 3 * rays)?.reshape((rays, 3))?,
        depth: out.narrow(0, 3 * rays, rays)?,
        acc: out.narrow(0, 4 * rays, rays)?,
        weights: out.narrow(0, 5 * rays, rays * samples)?.reshape((rays, samples))?,
    })
}

/// The rendering equation in candle's operations: the sum of T_k alpha_k rgb_k, plus the background. [`weights_from_density`]
/// has T_k and alpha_k.
pub fn composite_reference(
    rgb: &Tensor,
    density: &Tensor,
    t_vals: &Tensor,
    direction_norm: &Tensor,
    background: Option<[f32; 3]>,
) -> Result<Composite> {
    let samples = density.dim(1)?;
    let weights = weights_from_density(density, &intervals(t_vals, direction_norm, samples)?)?;
    let acc = weights.sum(D::Minus1)?;
    let depth = (&weights * middles(t_vals, samples)?)?.sum(D::Minus1)?;
    let mut colour = weights.unsqueeze(2)?.broadcast_mul(rgb)?.sum(1)?; // [rays, 3]
    if let Some(background) = background {
        let fill = Tensor::new(&background, rgb.device())?.to_dtype(rgb.dtype())?.reshape((1, 3))?;
        colour = (colour + (1.0 - &acc)?.unsqueeze(1)?.broadcast_mul(&fill)?)?;
    }
    Ok(Composite { rgb: colour, depth, acc, weights })
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{Device, Var};

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
        assert_eq!(transmittance(&[1.0, 2.0, 3.0], &[ln2, ln2, 1.0], 1.0), [1.0, 0.5, 0.25]);
    }

    /// All outputs' gradients at once, every input's gradient; random rays, one of them empty, one opaque.
    #[test]
    fn the_scan_equals_plain_candle() {
        let (rays, samples) = (5, 9);
        let wave = |shape: &[usize], phase: f64| {
            let n: usize = shape.iter().product();
            let values: Vec<f64> = (0..n).map(|i| 0.5 + 0.5 * (i as f64 * 1.7 + phase).sin()).collect();
            Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
        };
        let gaps = (wave(&[rays, samples], 0.3) + 0.01).unwrap();
        let scale = Tensor::new(&[[0.0f64], [1e4], [1.0], [3.0], [0.1]], &Device::Cpu).unwrap();
        let density = wave(&[rays, samples], 1.0).broadcast_mul(&scale).unwrap();
        let norm = Tensor::new(&[[1.0f64], [2.0], [0.5], [1.0], [1.5]], &Device::Cpu).unwrap();
        let more = Tensor::cat(&[&gaps, &gaps.narrow(1, 0, 1).unwrap()], 1).unwrap();
        for gaps in [&gaps, &more] {
            let single = |tensor: &Tensor| tensor.to_dtype(DType::F32).unwrap();
            let var = |tensor: &Tensor| Var::from_tensor(&single(tensor)).unwrap();
            let inputs = [var(&wave(&[rays, samples, 3], 2.0)), var(&density), var(&gaps.cumsum(1).unwrap())];
            let norm = single(&norm);
            let gradients_of = |reference: bool| {
                let composite = if reference { composite_reference } else { composite };
                let [rgb, density, t_vals] = inputs.each_ref().map(|var| var.as_tensor());
                let out = composite(rgb, density, t_vals, &norm, Some([0.2, 0.5, 0.9])).unwrap();
                let outputs = [out.rgb, out.depth, out.acc, out.weights];
                let cotangent = |(i, out): (usize, &Tensor)| {
                    (out * single(&wave(out.dims(), i as f64))).unwrap().sum_all().unwrap()
                };
                let loss = outputs.iter().enumerate().map(cotangent).reduce(|a, b| (a + b).unwrap()).unwrap();
                let store = loss.backward().unwrap();
                let gradients = inputs.each_ref().map(|var| store.get(var).unwrap().clone());
                outputs.into_iter().chain(gradients).collect::<Vec<Tensor>>()
            };
            for (i, (found, expected)) in gradients_of(false).iter().zip(gradients_of(true)).enumerate() {
                let values = |tensor: &Tensor| {
                    tensor.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1::<f64>().unwrap()
                };
                let (found, expected) = (values(found), values(&expected));
                // The opaque end's interval of 1e10 times a density's gradient is beyond any comparison in f32.
                let pairs = found.iter().zip(&expected).filter(|(_, expected)| expected.abs() < 1e8);
                let scale = pairs.clone().fold(1.0, |m: f64, (_, e)| m.max(e.abs()));
                let off = pairs.fold(0.0, |m: f64, (f, e)| m.max((f - e).abs()));
                assert!(off <= 2e-5 * scale, "{i}: {off:e} of {scale:e}");
            }
        }
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
