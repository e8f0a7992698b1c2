//! The recurrent cell of the march in candle's operations.

use candle_core::{Result, Tensor};

use crate::base::tensors::with_gradient;
use crate::parameters::linear;

/// Weights of a recurrent layer: of its input `[4 hidden, inputs]` and its state `[4 hidden, hidden]`, each with a bias
/// `[4 hidden]`. Gates are in the order input, forget, candidate, output.
pub(super) struct Lstm<'a> {
    pub weight_ih: &'a Tensor,
    pub weight_hh: &'a Tensor,
    pub bias_ih: &'a Tensor,
    pub bias_hh: &'a Tensor,
}

impl Lstm<'_> {
    /// Returns the state `(h, c)` after `(h, c)` and x `[n, inputs]`, `[n, hidden]` each (Hochreiter and Schmidhuber
    /// 1997, with forget gates).
    pub(super) fn apply(&self, x: &Tensor, (h, c): (&Tensor, &Tensor)) -> Result<(Tensor, Tensor)> {
        let gates = linear(x, self.weight_ih, self.bias_ih)?;
        let gates = (gates + linear(h, self.weight_hh, self.bias_hh)?)?.chunk(4, 1)?;
        let sigmoid = |gate: &Tensor| candle_nn::ops::sigmoid(gate);
        let kept = (sigmoid(&gates[1])? * c)?;
        let c = (kept + (sigmoid(&gates[0])? * gates[2].tanh()?)?)?;
        Ok(((sigmoid(&gates[3])? * c.tanh()?)?, c))
    }
}

/// Returns the same tensor, whose gradient is clipped to -`limit`..=`limit` in the backward pass.
pub(super) fn clamp_gradient(x: &Tensor, limit: f64) -> Result<Tensor> {
    with_gradient(x, x, move |_, gradient| gradient.clamp(-limit, limit))
}
