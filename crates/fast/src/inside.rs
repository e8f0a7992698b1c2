//! Numbers of points outside a box, replaced as a differentiable operation.

use std::sync::Arc;

use augnerf_base::tensors::slice;
use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor};

/// Returns f32 `values` on the CPU, whose last numbers belong to points, with `by` at points that are not `inside`, where they
/// have no gradient. NaN stays NaN.
///
/// # Errors
/// There are fewer numbers than points.
pub fn replaced_outside(values: &Tensor, inside: &Arc<[bool]>, by: f32) -> Result<Tensor> {
    values.contiguous()?.apply_op1(Replace { inside: inside.clone(), by })
}

/// Replaces those of its argument's last `n` numbers whose points are outside.
struct Replace {
    inside: Arc<[bool]>,
    by: f32,
}

impl Replace {
    fn replaced(&self, values: &[f32]) -> Result<Vec<f32>> {
        let Some(first) = values.len().checked_sub(self.inside.len()) else {
            candle_core::bail!("{} numbers do not end with those of {} points", values.len(), self.inside.len());
        };
        let mut values = values.to_vec();
        for (value, _) in values[first..].iter_mut().zip(&*self.inside).filter(|(_, inside)| !**inside) {
            // Adds 0, or NaN if the value was NaN.
            *value = *value * 0.0 + self.by;
        }
        Ok(values)
    }
}

impl CustomOp1 for Replace {
    fn name(&self) -> &'static str {
        "only-inside"
    }

    fn cpu_fwd(&self, values: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        Ok((CpuStorage::F32(self.replaced(slice(values, layout)?)?), layout.shape().clone()))
    }

    fn bwd(&self, _raw: &Tensor, _replaced: &Tensor, gradient: &Tensor) -> Result<Option<Tensor>> {
        let zeros = Replace { inside: self.inside.clone(), by: 0.0 };
        Ok(Some(gradient.contiguous()?.apply_op1_no_bwd(&zeros)?))
    }
}
