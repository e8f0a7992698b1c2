//! Convolutions over a grid that is upsampled to twice the resolution.

use candle_core::{DType, Device, Result, Tensor};

use super::conv3d::Conv3d;

/// Positions of a kernel of 3 x 3 x 3.
const TAPS: usize = 27;

/// Applies a convolution of 3 x 3 x 3 taps over the grid with eight cells for each of `x [z, y, x, inputs]`. It has
/// `weight [27, inputs, outputs]`, taps along z, y, x, and `bias [outputs]` -> `[2 z, 2 y, 2 x, outputs]`.
///
/// The 27 cells of a row are copies of eight, so that their weights are summed first. That is a transposed convolution
/// of 4 x 4 x 4 taps. It needs 8 of 27 products, and the upsampled input is never made.
pub fn convolution(x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    let (z, y, x_side, _) = x.dims4()?;
    let (_, inputs, outputs) = weight.dims3()?;
    let product = Conv3d::transposed([z, y, x_side]);
    let sums = sums(product.kernel(), weight.dtype(), weight.device())?;
    let weight = sums.matmul(&weight.reshape((TAPS, inputs * outputs))?)?;
    product.forward(x, &weight.reshape(((), inputs, outputs))?, bias)
}

/// Returns which of the 27 taps fall on the same coarse cell: `[64, 27]` of ones and zeros, a row for each of `kernel`.
fn sums(kernel: &[[usize; 3]], dtype: DType, device: &Device) -> Result<Tensor> {
    // Position k of the transposed kernel leads from cell i to 2 i + k - 1. That cell reads cell 2 i + k - 1 + t - 1 of
    // the finer grid through tap t, which is a copy of cell i if k + t is 2 or 3.
    let meets = |k: &[usize; 3], tap: usize| {
        let t = [tap / 9, tap / 3 % 3, tap % 3];
        (0..3).all(|axis| matches!(k[axis] + t[axis], 2 | 3))
    };
    let ones = kernel.iter().flat_map(|k| (0..TAPS).map(move |tap| f64::from(u8::from(meets(k, tap)))));
    Tensor::from_iter(ones, device)?.reshape((kernel.len(), TAPS))?.to_dtype(dtype)
}

#[cfg(test)]
mod tests;
