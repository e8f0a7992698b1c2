//! The recurrent cell of the march in candle's operations.

use candle_core::backend::BackendStorage;
use candle_core::{CpuStorage, CudaStorage, CustomOp1, Layout, MetalStorage, Result, Shape, Tensor};

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
    x.contiguous()?.apply_op1(ClampGradient { limit })
}

struct ClampGradient {
    limit: f64,
}

impl CustomOp1 for ClampGradient {
    fn name(&self) -> &'static str {
        "clamp-gradient"
    }

    fn cpu_fwd(&self, x: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        copy(x, layout)
    }

    fn cuda_fwd(&self, x: &CudaStorage, layout: &Layout) -> Result<(CudaStorage, Shape)> {
        copy(x, layout)
    }

    fn metal_fwd(&self, x: &MetalStorage, layout: &Layout) -> Result<(MetalStorage, Shape)> {
        copy(x, layout)
    }

    fn bwd(&self, _x: &Tensor, _y: &Tensor, gradient: &Tensor) -> Result<Option<Tensor>> {
        Ok(Some(gradient.clamp(-self.limit, self.limit)?))
    }
}

/// Copies contiguous values from their part of the storage.
fn copy<S: BackendStorage>(x: &S, layout: &Layout) -> Result<(S, Shape)> {
    Ok((x.affine(layout, 1.0, 0.0)?, layout.shape().clone()))
}
