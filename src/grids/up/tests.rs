use candle_core::Var;

use super::*;
use crate::grids::reference::{check_differences, error, fixture, on_any_threads, ramp};

/// `[1, c, z, y, x]` to `[z, y, x, c]`.
fn lattice(tensor: &Tensor) -> Tensor {
    tensor.squeeze(0).unwrap().permute((1, 2, 3, 0)).unwrap().contiguous().unwrap()
}

#[test]
fn values_and_gradients_are_torch_s() {
    let x = Var::from_tensor(&lattice(&fixture("llff.up.x"))).unwrap();
    let out = upsample(&x).unwrap();
    assert_eq!(error(&out, &lattice(&fixture("llff.up.out"))), 0.0);
    let gradients = (out * lattice(&fixture("llff.up.cotangent"))).unwrap().sum_all().unwrap().backward().unwrap();
    assert!(error(gradients.get(&x).unwrap(), &lattice(&fixture("llff.up.grad.x"))) < 1e-14);
}

/// A second consumer's gradient counts, which candle's own forgets.
#[test]
fn gradients_of_two_consumers_add_up() {
    let x = Var::from_tensor(&ramp(&[2, 3, 2, 3], 0.5)).unwrap();
    let cotangent = ramp(&[4, 6, 4, 3], 0.2);
    check_differences(std::slice::from_ref(&x), 1e-8, || {
        let fine = (upsample(&x).unwrap() * &cotangent).unwrap().sum_all().unwrap();
        (fine + x.sqr().unwrap().sum_all().unwrap()).unwrap()
    });
}

#[test]
fn threads_change_no_bit() {
    on_any_threads(|| {
        let x = Var::from_tensor(&ramp(&[8, 9, 10, 5], 0.5).to_dtype(DType::F32).unwrap()).unwrap();
        let out = upsample(&x).unwrap();
        let gradients = out.sqr().unwrap().sum_all().unwrap().backward().unwrap();
        vec![out.detach(), gradients.get(&x).unwrap().clone()]
    });
}
