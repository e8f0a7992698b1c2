//! ReLU's backward pass in one loop.

use augnerf_base::place::is_ours;
use augnerf_base::tensors::slice;
use candle_core::{CpuStorage, CustomOp2, Layout, Result, Shape, Tensor};

/// Returns the gradient where `y > 0`, otherwise 0. `None` if candle's own operations have to.
///
/// # Errors
/// Those of candle.
pub fn mask_where_zero(gradient: &Tensor, y: &Tensor) -> Result<Option<Tensor>> {
    if !is_ours(y) {
        return Ok(None);
    }
    Ok(Some(gradient.contiguous()?.apply_op2_no_bwd(&y.contiguous()?, &ReluMask)?))
}

struct ReluMask;

fn masked<T: Copy + PartialOrd + Default>(gradient: &[T], y: &[T]) -> Vec<T> {
    gradient.iter().zip(y).map(|(&g, &y)| if y > T::default() { g } else { T::default() }).collect()
}

impl CustomOp2 for ReluMask {
    fn name(&self) -> &'static str {
        "relu-mask"
    }

    fn cpu_fwd(
        &self,
        gradient: &CpuStorage,
        gradient_layout: &Layout,
        y: &CpuStorage,
        y_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let out = match y {
            CpuStorage::F32(_) => CpuStorage::F32(masked(slice(gradient, gradient_layout)?, slice(y, y_layout)?)),
            CpuStorage::F64(_) => CpuStorage::F64(masked(slice(gradient, gradient_layout)?, slice(y, y_layout)?)),
            _ => candle_core::bail!("relu-mask is for f32 and f64"),
        };
        Ok((out, y_layout.shape().clone()))
    }
}
