use candle_core::{DType, Device, Var};

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

/// Sweeps are what views see, not what is learned: the reference's slope along them is that of the weights, which colours show.
#[test]
fn colours_are_weighed_by_the_reference_s_slopes() {
    let (raw, cotangent) = (lattice("llff.mix.raw"), lattice("llff.mix.cotangent"));
    let slopes = lattice("llff.mix.grad.sweep");
    for view in 0..5 {
        // A sweep that is 1 in one channel of one view shows that view's weight.
        let ones = |c: usize| {
            let channels =
                Tensor::from_vec((0..15).map(|i| f64::from(i == 3 * view + c)).collect(), (1, 1, 1, 15), &Device::Cpu);
            channels.unwrap().broadcast_as((2, 3, 4, 15)).unwrap().contiguous().unwrap()
        };
        for c in 0..3 {
            let weight = blend_views(&raw, &ones(c)).unwrap().narrow(3, c, 1).unwrap();
            let slope = (weight * cotangent.narrow(3, c, 1).unwrap()).unwrap();
            assert!(error(&slope, &slopes.narrow(3, 3 * view + c, 1).unwrap().contiguous().unwrap()) < 1e-13);
        }
    }
}

#[test]
fn large_numbers_stay_numbers() {
    let raw = Var::from_tensor(&(ramp(&[90, 5], 0.2) * 1e4).unwrap().to_dtype(DType::F32).unwrap()).unwrap();
    let out = blend_views(&raw, &ramp(&[90, 15], 0.7).to_dtype(DType::F32).unwrap()).unwrap();
    let gradients = out.sqr().unwrap().sum_all().unwrap().backward().unwrap();
    let found = [values(&out), values(gradients.get(&raw).unwrap())].concat();
    assert!(found.iter().all(|value| value.is_finite()));
}
