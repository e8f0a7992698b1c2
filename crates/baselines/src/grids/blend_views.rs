//! The head of LLFF's network (Mildenhall et al. 2019): alpha, and a colour blended from the input views.

use candle_core::{Result, Tensor};
use candle_nn::ops::{sigmoid, softmax};

/// Maps `raw [.., inputs]` and `sweep [.., 3 inputs]` to RGBA `[.., 4]`, with a gradient of `raw`. Alpha is the sigmoid
/// of channel 0. The softmax of the other channels and of a last 0 weights the views' colours.
///
/// # Errors
/// If shapes do not fit; those of candle.
pub fn blend_views(raw: &Tensor, sweep: &Tensor) -> Result<Tensor> {
    let (inputs, before) = raw.dims().split_last().unwrap_or((&0, &[]));
    let (inputs, shape) = (*inputs, [before, &[4]].concat());
    if inputs == 0 || sweep.dims() != [before, &[3 * inputs]].concat() || raw.dtype() != sweep.dtype() {
        candle_core::bail!("blend views: {:?} and {:?} do not fit", raw.shape(), sweep.shape());
    }
    let raw = raw.reshape(((), inputs))?;
    let first = raw.narrow(1, 0, 1)?;
    let weights =
        softmax(&Tensor::cat(&[&raw.narrow(1, 1, inputs - 1)?, &first.zeros_like()?], 1)?, 1)?.unsqueeze(2)?;
    let rgb = sweep.detach().reshape(((), inputs, 3))?.broadcast_mul(&weights)?.sum(1)?;
    Tensor::cat(&[&rgb, &sigmoid(&first)?], 1)?.reshape(shape)
}

#[cfg(test)]
mod tests;
