//! The head of LLFF's network (Mildenhall et al. 2019): alpha, and a colour blended from the input views.

use candle_core::{Result, Tensor};
use candle_nn::ops::{sigmoid, softmax};

/// Maps `raw [.., inputs]` and `sweep [.., 3 inputs]` to RGBA `[.., 4]`, with a gradient of `raw`. Alpha is the sigmoid
/// of channel 0. The softmax of the other channels and of a last 0 weights the views' colours.
pub fn blend_views(raw: &Tensor, sweep: &Tensor) -> Result<Tensor> {
    let mut shape = raw.dims().to_vec();
    let inputs = std::mem::replace(shape.last_mut().expect("there are channels"), 4);
    let raw = raw.reshape(((), inputs))?;
    let first = raw.narrow(1, 0, 1)?;
    let weights =
        softmax(&Tensor::cat(&[&raw.narrow(1, 1, inputs - 1)?, &first.zeros_like()?], 1)?, 1)?.unsqueeze(2)?;
    let rgb = sweep.detach().reshape(((), inputs, 3))?.broadcast_mul(&weights)?.sum(1)?;
    Tensor::cat(&[&rgb, &sigmoid(&first)?], 1)?.reshape(shape)
}

#[cfg(test)]
mod tests;
