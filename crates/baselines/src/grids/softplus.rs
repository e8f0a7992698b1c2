//! Softplus of scaled channels, which makes a decoder's numbers non-negative colours and opacity.

use candle_core::{Result, Tensor};

/// Above it the softplus is the identity, as in torch (the difference is 2e-9).
const LINEAR: f64 = 20.0;
/// Below it the softplus is the exponential, to 2e-4 of it. The logarithm has fewer digits there in f32, and none below
/// -16, where the logarithm of the opacity still counts.
const SMALL: f64 = -8.0;

/// Returns `ln(1 + exp(scale x + shift))`, with a scale and a shift for each of the last axis's channels.
pub fn softplus<const C: usize>(x: &Tensor, scale: [f64; C], shift: [f64; C]) -> Result<Tensor> {
    let row = |values: [f64; C]| Tensor::new(&values[..], x.device())?.to_dtype(x.dtype());
    let z = x.broadcast_mul(&row(scale)?)?.broadcast_add(&row(shift)?)?;
    // Above the bound the argument of the exponential does not matter, but must not be infinite.
    let exponential = z.minimum(LINEAR)?.exp()?;
    let middle = (&exponential + 1.0)?.log()?;
    let lower = z.lt(SMALL)?.where_cond(&exponential, &middle)?;
    z.gt(LINEAR)?.where_cond(&z, &lower)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grids::reference::{check_differences, error, ramp, values};
    use candle_core::{DType, Device, Var};

    /// Of numbers from -65 to 85.
    #[test]
    fn values_are_those_of_the_definition_and_gradients_those_of_differences() {
        let (scale, shift) = ([25.0, 1.0], [10.0, 0.3]);
        let x = Var::from_tensor(&(ramp(&[40, 2], 0.3) * 3.0).unwrap()).unwrap();
        let of = |(i, x): (usize, &f64)| (scale[i % 2] * x + shift[i % 2]).exp().ln_1p();
        let expected: Vec<f64> = values(&x).iter().enumerate().map(of).collect();
        let expected = Tensor::from_vec(expected, (40, 2), &Device::Cpu).unwrap();
        let single = softplus(&x.to_dtype(DType::F32).unwrap(), scale, shift).unwrap();
        assert!(error(&softplus(&x, scale, shift).unwrap(), &expected) < 1e-9);
        assert!(error(&single, &expected) < 1e-6);
        check_differences(std::slice::from_ref(&x), 1e-7, || softplus(&x, scale, shift).unwrap().sum_all().unwrap());
    }

    #[test]
    fn small_numbers_keep_their_digits_in_f32() {
        let x = Tensor::new(&[[-7.9f32, -8.1, -25.0]], &Device::Cpu).unwrap();
        for (found, expected) in values(&softplus(&x, [1.0; 3], [0.0; 3]).unwrap()).iter().zip([-7.9f64, -8.1, -25.0]) {
            assert!((found / expected.exp().ln_1p() - 1.0).abs() < 4e-4, "{found} of {expected}");
        }
    }

    #[test]
    fn large_numbers_stay_and_no_numbers_show() {
        let x = Tensor::new(&[[1e30f32, -1e30, f32::NAN]], &Device::Cpu).unwrap();
        let found = softplus(&x, [1.0; 3], [0.0; 3]).unwrap().to_vec2::<f32>().unwrap();
        assert!(found[0][0] == 1e30 && found[0][1] == 0.0 && found[0][2].is_nan(), "{found:?}");
    }
}
