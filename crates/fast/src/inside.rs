//! Numbers of points outside a box, replaced as a differentiable operation.

use std::sync::Arc;

use augnerf_base::place::is_ours;
use augnerf_base::tensors::slice;
use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor, WithDType};

/// Returns `values`, whose last numbers belong to points, with `by` at points that are not `inside`, where they have no
/// gradient. NaN stays NaN. `None` if candle's own operations have to.
///
/// # Errors
/// There are fewer numbers than points.
pub fn replaced_outside(values: &Tensor, inside: &Arc<[bool]>, by: f64) -> Result<Option<Tensor>> {
    if !is_ours(values) {
        return Ok(None);
    }
    Ok(Some(values.contiguous()?.apply_op1(Replace { inside: inside.clone(), by })?))
}

/// Replaces those of its argument's last `n` numbers whose points are outside.
struct Replace {
    inside: Arc<[bool]>,
    by: f64,
}

impl Replace {
    fn replaced<T: WithDType>(&self, values: &[T]) -> Result<Vec<T>> {
        let Some(first) = values.len().checked_sub(self.inside.len()) else {
            candle_core::bail!("{} numbers do not end with those of {} points", values.len(), self.inside.len());
        };
        let by = T::from_f64(self.by);
        let mut values = values.to_vec();
        for (value, _) in values[first..].iter_mut().zip(&*self.inside).filter(|(_, inside)| !**inside) {
            // Adds 0, or NaN if the value was NaN.
            *value = *value * T::zero() + by;
        }
        Ok(values)
    }
}

impl CustomOp1 for Replace {
    fn name(&self) -> &'static str {
        "only-inside"
    }

    fn cpu_fwd(&self, values: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let replaced = match values {
            CpuStorage::F32(_) => CpuStorage::F32(self.replaced(slice(values, layout)?)?),
            CpuStorage::F64(_) => CpuStorage::F64(self.replaced(slice(values, layout)?)?),
            _ => candle_core::bail!("raw density is f32 or f64"),
        };
        Ok((replaced, layout.shape().clone()))
    }

    fn bwd(&self, _raw: &Tensor, _replaced: &Tensor, gradient: &Tensor) -> Result<Option<Tensor>> {
        let zeros = Replace { inside: self.inside.clone(), by: 0.0 };
        Ok(Some(gradient.contiguous()?.apply_op1_no_bwd(&zeros)?))
    }
}
