//! Operations on tensors that may be missing, with gradients of their own, access to their values, and a ReLU that keeps NaN.

use std::ops::Deref;

use candle_core::backend::BackendStorage;
use candle_core::{CpuStorage, CudaStorage, CustomOp2, Layout, Result, Shape, Storage, Tensor, WithDType};

/// Returns `a + b`, or the one that is present.
pub fn sum(a: Option<Tensor>, b: Option<Tensor>) -> super::Result<Option<Tensor>> {
    Ok(match (a, b) {
        (Some(a), Some(b)) => Some((a + b)?),
        (a, b) => a.or(b),
    })
}

/// Returns x if it is positive, and 0 otherwise, with slope 0 at 0. NaN stays NaN, to be found and reported, where candle's own
/// ReLU gives 0.
pub fn relu(x: &Tensor) -> Result<Tensor> {
    x.detach().le(0.0)?.where_cond(&x.zeros_like()?, x)
}

/// Returns `x` if it is not below 0, and `slope x` otherwise. NaN stays NaN, where candle's own ReLU gives 0.
pub fn leaky_relu(x: &Tensor, slope: f64) -> Result<Tensor> {
    x.lt(0.0)?.where_cond(&(x * slope)?, x)
}

/// Returns `value`, of the shape of `x`, on whose backward pass `x` gets `gradient(x, gradient of the value)`.
///
/// # Errors
/// Errors of candle.
pub fn with_gradient(
    x: &Tensor,
    value: &Tensor,
    gradient: impl Fn(&Tensor, &Tensor) -> Result<Tensor> + Send + Sync + 'static,
) -> Result<Tensor> {
    x.apply_op2(&value.detach().contiguous()?, WithGradient(gradient))
}

struct WithGradient<F>(F);

/// Copies contiguous values from their part of the storage.
fn copy<S: BackendStorage>(values: &S, layout: &Layout) -> Result<(S, Shape)> {
    Ok((values.affine(layout, 1.0, 0.0)?, layout.shape().clone()))
}

impl<F: Fn(&Tensor, &Tensor) -> Result<Tensor> + Send + Sync> CustomOp2 for WithGradient<F> {
    fn name(&self) -> &'static str {
        "with-gradient"
    }

    fn cpu_fwd(&self, _: &CpuStorage, _: &Layout, value: &CpuStorage, at: &Layout) -> Result<(CpuStorage, Shape)> {
        copy(value, at)
    }

    fn cuda_fwd(&self, _: &CudaStorage, _: &Layout, value: &CudaStorage, at: &Layout) -> Result<(CudaStorage, Shape)> {
        copy(value, at)
    }

    fn bwd(&self, x: &Tensor, _: &Tensor, _: &Tensor, gradient: &Tensor) -> Result<(Option<Tensor>, Option<Tensor>)> {
        Ok((Some((self.0)(x, gradient)?), None))
    }
}

/// Calls `read` with the values of a contiguous f32 tensor on the CPU. Returns `None` for other tensors.
pub fn with_values<R>(tensor: &Tensor, read: impl FnOnce(&[f32]) -> R) -> Option<R> {
    let (storage, layout) = tensor.storage_and_layout();
    match (&*storage, layout.contiguous_offsets()) {
        (Storage::Cpu(CpuStorage::F32(values)), Some((start, end))) => Some(read(&values[start..end])),
        _ => None,
    }
}

/// A tensor's values on the CPU, readable while this lives.
pub struct Values<'a> {
    storage: Box<dyn Deref<Target = Storage> + 'a>,
    layout: &'a Layout,
}

impl<'a> Values<'a> {
    /// Returns the values of a tensor.
    pub fn of(tensor: &'a Tensor) -> Values<'a> {
        let (storage, layout) = tensor.storage_and_layout();
        Values { storage: Box::new(storage), layout }
    }

    /// Returns the values row by row.
    ///
    /// # Errors
    /// The tensor is not on the CPU, not contiguous, or of another type.
    pub fn slice<T: WithDType>(&self) -> Result<&[T]> {
        match &**self.storage {
            Storage::Cpu(storage) => slice(storage, self.layout),
            _ => candle_core::bail!("this operation needs tensors on the CPU"),
        }
    }
}

/// Returns the values of a contiguous argument of a custom operation.
///
/// # Errors
/// The argument is not contiguous, or of another type.
pub fn slice<'a, T: WithDType>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [T]> {
    match layout.contiguous_offsets() {
        Some((start, end)) => Ok(&T::cpu_storage_as_slice(storage)?[start..end]),
        None => candle_core::bail!("this operation needs contiguous arguments, got {layout:?}"),
    }
}

#[cfg(test)]
mod tests {
    use candle_core::{Device, Var};

    use super::*;

    #[test]
    fn relus_keep_what_is_no_number() {
        let x = Tensor::new(&[-2.0, 0.0, 3.0, f64::NAN], &Device::Cpu).unwrap();
        let y: Vec<f64> = leaky_relu(&x, 0.25).unwrap().to_vec1().unwrap();
        assert!(y[..3] == [-0.5, 0.0, 3.0] && y[3].is_nan(), "{y:?}");
        let x = Var::new(&[f64::NEG_INFINITY, 0.0, 3.0, f64::NAN], &Device::Cpu).unwrap();
        let y = relu(&x).unwrap();
        let slope: Vec<f64> = y.sum_all().unwrap().backward().unwrap().get(&x).unwrap().to_vec1().unwrap();
        assert_eq!(slope, [0.0, 0.0, 1.0, 1.0]);
        let y: Vec<f64> = y.to_vec1().unwrap();
        assert!(y[..3] == [0.0, 0.0, 3.0] && y[3].is_nan(), "{y:?}");
    }
}
