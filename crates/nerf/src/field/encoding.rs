//! Positional encoding (NeRF paper, section 5.1, including the point itself), and its expectation over Gaussians
//! (MipNeRF).

use candle_core::{Result, Tensor};

use crate::field::settings::{Encoding, FieldConfig};

/// Returns the number of channels of the encoding of a 3-vector.
pub fn encoded_channels(octaves: usize) -> usize {
    3 + 6 * octaves
}

/// Returns the number of channels of a position's encoding.
pub fn position_channels(config: &FieldConfig) -> usize {
    match config.encoding {
        Encoding::Positional => encoded_channels(config.position_octaves),
        Encoding::Integrated => 6 * config.position_octaves,
        Encoding::Hash => config.hash.levels * config.hash.features,
    }
}

/// Encodes points `[n, 3]`, Gaussians `[n, 6]` or features of a hash grid, which are their own encoding.
pub(super) fn encode_positions(config: &FieldConfig, positions: &Tensor) -> Result<Tensor> {
    match config.encoding {
        Encoding::Positional => encode(positions, config.position_octaves),
        Encoding::Integrated => encode_integrated(positions, config.position_octaves),
        Encoding::Hash => Ok(positions.clone()),
    }
}

/// Encodes `[n, 3]` -> `[n, 3 + 6 octaves]`: x, then for each frequency 2^0..2^(octaves-1) the sines and the cosines of
/// its three components.
pub fn encode(x: &Tensor, octaves: usize) -> Result<Tensor> {
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
    let (n, _) = gaussians.dims2()?;
    let powers_of_two = |power: f64| -> Result<Tensor> {
        let values: Vec<f64> = (0..octaves).map(|octave| 2f64.powf(octave as f64 * power)).collect();
        Tensor::from_vec(values, (1, octaves, 1), gaussians.device())?.to_dtype(gaussians.dtype())
    };
    let angles = gaussians.narrow(1, 0, 3)?.unsqueeze(1)?.broadcast_mul(&powers_of_two(1.0)?)?; // [n, octaves, 3]
    let variances = gaussians.narrow(1, 3, 3)?.unsqueeze(1)?.broadcast_mul(&powers_of_two(2.0)?)?;
    let damping = (variances * -0.5)?.exp()?;
    let waves = Tensor::cat(&[(&damping * angles.sin()?)?, (&damping * angles.cos()?)?], 2)?; // [n, octaves, 6]
    waves.reshape((n, 6 * octaves))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::rng::{Random, Stream};
    use candle_core::Device;

    fn gaussians(n: usize) -> Tensor {
        let values = (0..n).flat_map(|i| {
            let wave = |phase: f64| (i as f64 * 1.3 + phase).sin();
            let variance = |phase: f64| 10f64.powf(-2.5 + 2.0 * wave(phase));
            [wave(0.0), wave(1.0), 2.0 * wave(2.0), variance(3.0), variance(4.0), variance(5.0)]
        });
        Tensor::from_vec(values.collect::<Vec<f64>>(), (n, 6), &Device::Cpu).unwrap()
    }

    /// Means of sines and cosines over many draws of each Gaussian.
    #[test]
    fn the_integrated_one_is_an_expectation() {
        let (n, octaves, draws) = (4, 6, 40_000);
        let moments = gaussians(n).to_vec2::<f64>().unwrap();
        let encoded = encode_integrated(&gaussians(n), octaves).unwrap().to_vec2::<f64>().unwrap();
        let mut random = Random::new(3, Stream::Init, 0);
        for (gaussian, expected) in moments.iter().zip(encoded) {
            let mut sums = vec![0f64; expected.len()];
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
            let off = sums.iter().zip(&expected).fold(0f64, |m, (a, b)| m.max((a - b).abs()));
            assert!(off < 4.5 / f64::from(draws).sqrt(), "{off}");
        }
    }

    #[test]
    fn no_octaves_is_the_identity() {
        let x = Tensor::new(&[[1f32, -2.0, 0.5]], &Device::Cpu).unwrap();
        assert_eq!(encode(&x, 0).unwrap().to_vec2::<f32>().unwrap(), x.to_vec2::<f32>().unwrap());
    }
}
