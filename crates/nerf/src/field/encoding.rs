//! Positional encoding (NeRF paper, section 5.1, including the point itself), and its expectation over Gaussians
//! (MipNeRF).

use augnerf_fast::encoding::{self, Code, integrated_channels};
use candle_core::{Result, Tensor};

use crate::field::settings::{Encoding, FieldConfig};

/// Returns the encoding of a field's positions.
pub(super) fn position_code(config: &FieldConfig) -> Code {
    match config.encoding {
        Encoding::Positional => Code::Positional(config.position_octaves),
        Encoding::Integrated => Code::Integrated(config.position_octaves),
        Encoding::Hash => Code::Features(config.hash.levels * config.hash.features),
    }
}

/// Encodes positions in candle's graph.
pub(super) fn encode_positions(code: Code, positions: &Tensor) -> Result<Tensor> {
    match code {
        Code::Positional(octaves) => encode(positions, octaves),
        Code::Integrated(octaves) => encode_integrated(positions, octaves),
        Code::Features(_) => Ok(positions.clone()),
    }
}

/// Encodes `[n, 3]` -> `[n, 3 + 6 octaves]`: x, then for each frequency 2^0..2^(octaves-1) the sines and the cosines of
/// its three components.
pub fn encode(x: &Tensor, octaves: usize) -> Result<Tensor> {
    let encoded = encoding::encode(x, Code::Positional(octaves))?;
    encoded.map_or_else(|| encode_reference(x, octaves), Ok)
}

/// The same in plain candle operations.
pub fn encode_reference(x: &Tensor, octaves: usize) -> Result<Tensor> {
    let (n, components) = x.dims2()?;
    if octaves == 0 {
        return Ok(x.clone());
    }
    let frequencies: Vec<f64> = (0..octaves).map(|octave| 2f64.powi(octave as i32)).collect();
    let frequencies = Tensor::from_vec(frequencies, (1, octaves, 1), x.device())?.to_dtype(x.dtype())?;
    let scaled = x.reshape((n, 1, components))?.broadcast_mul(&frequencies)?; // [n, octaves, 3]
    let waves = Tensor::cat(&[scaled.sin()?, scaled.cos()?], 2)?; // [n, octaves, 6]
    Tensor::cat(&[x, &waves.reshape((n, octaves * 2 * components))?], 1)
}

/// Encodes `[n, 6]`, mean and diagonal variance of Gaussians, -> `[n, 6 octaves]`. For each frequency f =
/// 2^0..2^(octaves-1) it returns the expectations of the sines and of the cosines of f x. These are
/// exp(-f^2 variance / 2) times those of the mean (Barron et al. 2021, equation 14).
pub fn encode_integrated(gaussians: &Tensor, octaves: usize) -> Result<Tensor> {
    let encoded = encoding::encode(gaussians, Code::Integrated(octaves))?;
    encoded.map_or_else(|| encode_integrated_reference(gaussians, octaves), Ok)
}

/// The same in plain candle operations.
pub fn encode_integrated_reference(gaussians: &Tensor, octaves: usize) -> Result<Tensor> {
    let (n, _) = gaussians.dims2()?;
    let of_each = |power: f64| -> Result<Tensor> {
        let values: Vec<f64> = (0..octaves).map(|octave| 2f64.powf(octave as f64 * power)).collect();
        Tensor::from_vec(values, (1, octaves, 1), gaussians.device())?.to_dtype(gaussians.dtype())
    };
    let angles = gaussians.narrow(1, 0, 3)?.unsqueeze(1)?.broadcast_mul(&of_each(1.0)?)?; // [n, octaves, 3]
    let spread = gaussians.narrow(1, 3, 3)?.unsqueeze(1)?.broadcast_mul(&of_each(2.0)?)?;
    let kept = (spread * -0.5)?.exp()?;
    let waves = Tensor::cat(&[(&kept * angles.sin()?)?, (&kept * angles.cos()?)?], 2)?; // [n, octaves, 6]
    waves.reshape((n, integrated_channels(octaves)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::rng::{Random, Stream};
    use augnerf_fast::encoding::LEAST_KEPT;
    use candle_core::{DType, Device, Var};

    #[test]
    fn value_and_gradient_equal_plain_candle() {
        let values: Vec<f64> = (0..60).map(|i| (i as f64 * 0.37).sin() * 2.0).collect();
        let weights: Vec<f64> = (0..20 * 63).map(|i| (i as f64 * 0.11).cos()).collect();
        let weights = Tensor::from_vec(weights, (20, 63), &Device::Cpu).unwrap();
        // Errors of the argument grow with the top frequency, 512.
        for (dtype, tolerance) in [(DType::F64, 1e-11), (DType::F32, 1e-4)] {
            let x = Tensor::from_slice(&values, (20, 3), &Device::Cpu).unwrap().to_dtype(dtype).unwrap();
            let x = Var::from_tensor(&x).unwrap();
            let weights = weights.to_dtype(dtype).unwrap();
            let both = [encode(&x, 10).unwrap(), encode_reference(&x, 10).unwrap()];
            let gradients = both.clone().map(|out| {
                let loss = (out * &weights).unwrap().sum_all().unwrap();
                loss.backward().unwrap().get(&x).unwrap().clone()
            });
            let largest = |[a, b]: [Tensor; 2]| {
                let difference = (a - b).unwrap().abs().unwrap().max_all().unwrap();
                difference.to_dtype(DType::F64).unwrap().to_scalar::<f64>().unwrap()
            };
            assert!(largest(both) < tolerance, "{dtype:?}");
            // Up to 512 times 20 terms.
            assert!(largest(gradients) < 5e3 * tolerance, "{dtype:?}");
        }
    }

    fn gaussians(n: usize) -> Tensor {
        let values = (0..n).flat_map(|i| {
            let wave = |phase: f64| (i as f64 * 1.3 + phase).sin();
            let variance = |phase: f64| 10f64.powf(-2.5 + 2.0 * wave(phase));
            [wave(0.0), wave(1.0), 2.0 * wave(2.0), variance(3.0), variance(4.0), variance(5.0)]
        });
        Tensor::from_vec(values.collect::<Vec<f64>>(), (n, 6), &Device::Cpu).unwrap()
    }

    #[test]
    fn the_integrated_one_equals_plain_candle() {
        let weights: Vec<f64> = (0..20 * 96).map(|i| (i as f64 * 0.11).cos()).collect();
        let weights = Tensor::from_vec(weights, (20, 96), &Device::Cpu).unwrap();
        let x = Var::from_tensor(&gaussians(20)).unwrap();
        let both = [encode_integrated(&x, 16).unwrap(), encode_integrated_reference(&x, 16).unwrap()];
        let gradients = both.clone().map(|out| {
            let loss = (out * &weights).unwrap().sum_all().unwrap();
            loss.backward().unwrap().get(&x).unwrap().clone()
        });
        for (what, [a, b], tolerance) in [("values", both, 1e-10), ("gradients", gradients, 1e-8)] {
            let difference = (a - &b).unwrap().abs().unwrap().max_all().unwrap().to_scalar::<f64>().unwrap();
            let scale = b.abs().unwrap().max_all().unwrap().to_scalar::<f64>().unwrap();
            assert!(difference < tolerance * scale, "{what}: {difference} of {scale}");
        }
    }

    #[test]
    fn the_integrated_one_leaves_no_subnormal_number() {
        let x = gaussians(200).to_dtype(DType::F32).unwrap();
        let of = |encoded: Result<Tensor>| encoded.unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap();
        let [ours, plain] = [of(encode_integrated(&x, 16)), of(encode_integrated_reference(&x, 16))];
        let subnormal = |values: &[f32]| values.iter().filter(|v| v.is_subnormal()).count();
        assert!(subnormal(&plain) > 0, "these Gaussians do not show it");
        assert_eq!(subnormal(&ours), 0);
        let lost = ours.iter().zip(&plain).filter(|(a, b)| **a == 0.0 && f64::from(b.abs()) > LEAST_KEPT);
        assert_eq!(lost.count(), 0, "zeros in place of numbers that count");
    }

    /// Means of sines and cosines over many draws of each Gaussian.
    #[test]
    fn the_integrated_one_is_an_expectation() {
        let (n, octaves, draws) = (4, 6, 40_000);
        let given = gaussians(n).to_vec2::<f64>().unwrap();
        let found = encode_integrated(&gaussians(n), octaves).unwrap().to_vec2::<f64>().unwrap();
        let mut random = Random::new(3, Stream::Init, 0);
        for (gaussian, found) in given.iter().zip(found) {
            let mut sums = vec![0f64; found.len()];
            for _ in 0..draws {
                for axis in 0..3 {
                    let x = gaussian[axis] + gaussian[3 + axis].sqrt() * random.normal_pair().0;
                    for octave in 0..octaves {
                        let (sin, cos) = (2f64.powi(octave as i32) * x).sin_cos();
                        sums[6 * octave + axis] += sin / f64::from(draws);
                        sums[6 * octave + 3 + axis] += cos / f64::from(draws);
                    }
                }
            }
            // Four and a half standard errors of a mean of numbers within -1..1.
            let off = sums.iter().zip(&found).fold(0f64, |m, (a, b)| m.max((a - b).abs()));
            assert!(off < 4.5 / f64::from(draws).sqrt(), "{off}");
        }
    }

    #[test]
    fn no_octaves_is_the_identity() {
        let x = Tensor::new(&[[1f32, -2.0, 0.5]], &Device::Cpu).unwrap();
        assert_eq!(encode(&x, 0).unwrap().to_vec2::<f32>().unwrap(), x.to_vec2::<f32>().unwrap());
    }
}
