//! Softplus of scaled channels, which makes a decoder's numbers non-negative colours and opacity.

use candle_core::backend::BackendStorage;
use candle_core::{CpuStorage, CustomOp1, Device, Layout, Result, Shape, Tensor, WithDType};

use crate::base::place::is_ours;
use rayon::prelude::*;

use super::values::{Values, each_kind, slice};

/// Above it the softplus is the identity, as in torch (the difference is 2e-9).
const LINEAR: f64 = 20.0;
/// Cells per thread and iteration.
const CELLS: usize = 1 << 12;

/// Returns `ln(1 + exp(scale x + shift))`, with a scale and a shift for each of the last axis's channels.
pub fn softplus<const C: usize>(x: &Tensor, scale: [f64; C], shift: [f64; C]) -> Result<Tensor> {
    if x.dims().last() != Some(&C) {
        candle_core::bail!("softplus of {C} channels: {:?} does not fit", x.shape());
    }
    if !is_ours(x) {
        return plain(x, scale, shift);
    }
    x.contiguous()?.apply_op1(Softplus { scale, shift })
}

/// The same in candle's own operations.
pub fn plain<const C: usize>(x: &Tensor, scale: [f64; C], shift: [f64; C]) -> Result<Tensor> {
    let row = |values: [f64; C]| Tensor::new(&values[..], x.device())?.to_dtype(x.dtype());
    let z = x.broadcast_mul(&row(scale)?)?.broadcast_add(&row(shift)?)?;
    // Above the bound the argument of the exponential does not matter, but must not be infinite.
    let held = z.minimum(LINEAR)?;
    z.gt(LINEAR)?.where_cond(&z, &(held.exp()? + 1.0)?.log()?)
}

struct Softplus<const C: usize> {
    scale: [f64; C],
    shift: [f64; C],
}

impl<const C: usize> Softplus<C> {
    /// Maps `of` over the scaled numbers and those of `beside`.
    fn map<T: WithDType>(&self, x: &[T], beside: &[T], of: impl Fn(T, T, T) -> T + Sync) -> Vec<T> {
        let [scale, shift] = [self.scale, self.shift].map(|row| row.map(T::from_f64));
        let mut out = vec![T::zero(); x.len()];
        let cells = out.par_chunks_mut(C * CELLS).zip(x.par_chunks(C * CELLS)).zip(beside.par_chunks(C * CELLS));
        cells.for_each(|((out, x), beside)| {
            for ((out, x), beside) in out.chunks_exact_mut(C).zip(x.chunks_exact(C)).zip(beside.chunks_exact(C)) {
                for (channel, ((out, x), beside)) in out.iter_mut().zip(x).zip(beside).enumerate() {
                    *out = of(scale[channel] * *x + shift[channel], *beside, scale[channel]);
                }
            }
        });
        out
    }
}

impl<const C: usize> CustomOp1 for Softplus<C> {
    fn name(&self) -> &'static str {
        "scaled-softplus"
    }

    fn cpu_fwd(&self, x: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let out = each_kind!(x.dtype(), T => {
            let (x, linear) = (slice::<T>(x, layout)?, T::from_f64(LINEAR));
            let of = |z: T, _: T, _: T| if z > linear { z } else { T::from_f64(z.to_f64().exp().ln_1p()) };
            T::to_cpu_storage_owned(self.map(x, x, of))
        });
        Ok((out, layout.shape().clone()))
    }

    fn bwd(&self, x: &Tensor, _out: &Tensor, gradient: &Tensor) -> Result<Option<Tensor>> {
        let gradient = gradient.contiguous()?;
        each_kind!(x.dtype(), T => {
            let (of_x, of_gradient) = (Values::of(x), Values::of(&gradient));
            let linear = T::from_f64(LINEAR);
            let sigmoid = |z: T| T::from_f64(1.0 / (1.0 + (-z.to_f64()).exp()));
            let of = |z: T, gradient: T, scale: T| if z > linear { gradient * scale } else { gradient * scale * sigmoid(z) };
            let out = self.map(of_x.slice::<T>()?, of_gradient.slice::<T>()?, of);
            Ok(Some(Tensor::from_vec(out, x.shape(), &Device::Cpu)?))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grids::reference::{check_differences, error, on_any_threads, ramp};
    use candle_core::{DType, Var};

    #[test]
    fn values_and_gradients_are_the_plain_ones_and_those_of_differences() {
        let (scale, shift) = ([25.0, 1.0], [10.0, 0.3]);
        let x = Var::from_tensor(&(ramp(&[40, 2], 0.3) * 3.0).unwrap()).unwrap();
        let both = |of: &dyn Fn(&Tensor) -> Tensor, x: &Var| {
            let out = of(x);
            let gradients = out.sqr().unwrap().sum_all().unwrap().backward().unwrap();
            vec![out, gradients.get(x).unwrap().clone()]
        };
        let expected = both(&|x| plain(x, scale, shift).unwrap(), &x);
        for (found, expected) in both(&|x| softplus(x, scale, shift).unwrap(), &x).iter().zip(&expected) {
            assert!(error(found, expected) < 1e-12, "{}", error(found, expected));
        }
        let single = Var::from_tensor(&x.to_dtype(DType::F32).unwrap()).unwrap();
        let fast = on_any_threads(|| both(&|x| softplus(x, scale, shift).unwrap(), &single));
        fast.iter().zip(&expected).for_each(|(found, expected)| assert!(error(found, expected) < 1e-5));
        check_differences(std::slice::from_ref(&x), 1e-7, || softplus(&x, scale, shift).unwrap().sum_all().unwrap());
    }

    #[test]
    fn large_numbers_stay_and_no_numbers_show() {
        let x = Tensor::new(&[[1e30f32, -1e30, f32::NAN]], &Device::Cpu).unwrap();
        let found = softplus(&x, [1.0; 3], [0.0; 3]).unwrap().to_vec2::<f32>().unwrap();
        assert!(found[0][0] == 1e30 && found[0][1] == 0.0 && found[0][2].is_nan(), "{found:?}");
    }
}
