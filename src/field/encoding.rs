//! Positional encoding (NeRF paper, section 5.1, with the identity kept).

use candle_core::{Result, Tensor};

/// Channels of the encoding of a 3-vector.
pub fn encoded_channels(octaves: usize) -> usize {
    3 + 6 * octaves
}

/// `[n, 3]` -> `[n, 3 + 6 octaves]`: x, then for each frequency 2^0..2^(octaves-1) the sines and
/// the cosines of its three components.
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
