//! The derivatives of the positional encoding in space.

use candle_core::{Device, Result, Tensor};

use super::encoding::encoded_channels;

/// First and second derivatives of each channel in its own coordinate, `[n, channels]`, and the coordinate of each
/// channel.
pub(super) struct Waves {
    pub(super) first: Tensor,
    pub(super) second: Tensor,
    /// `[channels, 3]`, 1 where the channel belongs to the axis.
    pub(super) axes: Tensor,
}

impl Waves {
    /// From the encoding itself: the derivative of a sine is the frequency times the cosine of the same octave.
    pub(super) fn new(encoded: &Tensor, octaves: usize) -> Result<Waves> {
        let channels = encoded_channels(octaves);
        // first = encoded @ turn + identity: each wave reads its partner.
        let (mut turn, mut constant) = (vec![0f64; channels * channels], vec![0f64; channels]);
        let (mut curvature, mut axes) = (vec![0f64; channels], vec![0f64; channels * 3]);
        for axis in 0..3 {
            constant[axis] = 1.0;
            axes[axis * 3 + axis] = 1.0;
            for octave in 0..octaves {
                let frequency = 2f64.powi(octave as i32);
                let (sin, cos) = (3 + 6 * octave + axis, 6 + 6 * octave + axis);
                turn[cos * channels + sin] = frequency;
                turn[sin * channels + cos] = -frequency;
                for channel in [sin, cos] {
                    curvature[channel] = -frequency * frequency;
                    axes[channel * 3 + axis] = 1.0;
                }
            }
        }
        let (dtype, device) = (encoded.dtype(), encoded.device());
        let tensor = |values: Vec<f64>, shape: (usize, usize)| {
            Tensor::from_vec(values, shape, &Device::Cpu)?.to_dtype(dtype)?.to_device(device)
        };
        let first = encoded.matmul(&tensor(turn, (channels, channels))?)?;
        Ok(Waves {
            first: first.broadcast_add(&tensor(constant, (1, channels))?)?,
            second: encoded.broadcast_mul(&tensor(curvature, (1, channels))?)?,
            axes: tensor(axes, (channels, 3))?,
        })
    }

    /// Returns the derivatives of the encoding along each axis, and its Laplacian, `[n, channels]`.
    pub(super) fn derivatives(&self) -> Result<[Tensor; 4]> {
        let along = |axis: usize| self.first.broadcast_mul(&self.axes.narrow(1, axis, 1)?.t()?);
        Ok([along(0)?, along(1)?, along(2)?, self.second.clone()])
    }
}
