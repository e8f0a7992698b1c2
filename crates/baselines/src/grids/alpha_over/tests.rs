use candle_core::{DType, Device, Var};

use super::*;
use crate::grids::reference::{error, ramp, values};

/// Colours and alphas between 0 and 1.
fn planes(shape: &[usize], phase: f64) -> Tensor {
    ((ramp(shape, phase) * 0.5).unwrap() + 0.5).unwrap()
}

/// The sums as they are defined.
fn slow(planes: &Tensor) -> Tensor {
    let (rays, count, _) = planes.dims3().unwrap();
    let all = values(planes);
    let mut out = Vec::new();
    for ray in all.chunks(4 * count) {
        let before = |k: usize| (k + 1..count).map(|j| 1.0 - ray[4 * j + 3] + 1e-10).product::<f64>();
        let weight = |k: usize| ray[4 * k + 3] * before(k);
        (0..3).for_each(|c| out.push((0..count).map(|k| weight(k) * ray[4 * k + c]).sum::<f64>()));
        out.push((0..count).map(weight).sum());
    }
    Tensor::from_vec(out, (rays, 4), &Device::Cpu).unwrap()
}

#[test]
fn nearer_planes_hide_those_behind() {
    let planes = planes(&[5, 6, 4], 0.2);
    assert!(error(&alpha_over(&planes).unwrap(), &slow(&planes)) < 1e-14);
    let fast = alpha_over(&planes.to_dtype(DType::F32).unwrap()).unwrap();
    assert!(error(&fast, &slow(&planes)) < 1e-6);
}

#[test]
fn an_opaque_plane_is_all_that_is_seen() {
    let far =
        Tensor::new(&[[[0.9f64, 0.1, 0.4, 0.7], [0.2, 0.3, 0.5, 1.0], [0.6, 0.8, 0.1, 0.0]]], &Device::Cpu).unwrap();
    let seen = values(&alpha_over(&far).unwrap());
    assert!(seen.iter().zip([0.2, 0.3, 0.5, 1.0]).all(|(a, b)| (a - b).abs() < 1e-9), "{seen:?}");
}

/// An opaque plane has the slope that the product of the others gives: nothing is divided by what it lets through.
#[test]
fn slopes_at_opaque_and_empty_planes_are_finite() {
    let alphas = [[0.5, 0.5, 0.5, 0.3], [0.1, 0.2, 0.3, 1.0], [0.9, 0.2, 0.7, 0.0], [0.4, 0.4, 0.1, 1.0]];
    let planes =
        Var::from_tensor(&Tensor::new(&[alphas], &Device::Cpu).unwrap().to_dtype(DType::F64).unwrap()).unwrap();
    let gradients = alpha_over(&planes).unwrap().narrow(1, 0, 3).unwrap().sum_all().unwrap().backward().unwrap();
    let found = values(gradients.get(&planes).unwrap());
    assert!(found.iter().all(|value| value.is_finite()));
    // The nearest: its own colour 0.9 minus what is behind it, the second plane behind (colour 0.6), once it is thinner.
    assert!((found[15] - (0.9 - 0.6)).abs() < 1e-8, "{found:?}");
}
