use candle_core::{DType, Var};

use super::*;
use crate::grids::reference::{channels_last, error, fixture, ramp, values, with_gradients};

fn lattice(name: &str) -> Tensor {
    channels_last(&fixture(name))
}

#[test]
fn values_and_gradients_are_torch_s() {
    let [raw, sweep, cotangent] = ["raw", "sweep", "cotangent"].map(|name| lattice(&format!("llff.mix.{name}")));
    let found = with_gradients(&[raw], &cotangent, |[raw]| blend_views(raw, &sweep));
    assert!(error(&found[0], &lattice("llff.mix.out")) < 1e-14);
    assert!(error(&found[1], &lattice("llff.mix.grad.raw")) < 1e-13);
}

#[test]
fn large_numbers_stay_numbers() {
    let raw = Var::from_tensor(&(ramp(&[90, 5], 0.2) * 1e4).unwrap().to_dtype(DType::F32).unwrap()).unwrap();
    let out = blend_views(&raw, &ramp(&[90, 15], 0.7).to_dtype(DType::F32).unwrap()).unwrap();
    let gradients = out.sqr().unwrap().sum_all().unwrap().backward().unwrap();
    let found = [values(&out), values(gradients.get(&raw).unwrap())].concat();
    assert!(found.iter().all(|value| value.is_finite()));
}
