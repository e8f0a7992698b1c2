use crate::grids::reference::{error, fixture, on_any_threads, ramp, single, values, with_gradients};

use super::*;

const RELATIVE: f64 = 1e-12;

fn all_kinds() -> impl Iterator<Item = LayerNorm> {
    [NormGroup::Channels, NormGroup::Sample]
        .into_iter()
        .flat_map(|group| [false, true].map(|relu| LayerNorm { group, epsilon: if relu { 1e-5 } else { 1e-12 }, relu }))
}

/// The result, and gradients of x, scale and shift of `sum(y * cotangent)`.
fn run(norm: LayerNorm, given: &[Tensor; 3], cotangent: &Tensor) -> Vec<Tensor> {
    with_gradients(given, cotangent, |[x, scale, shift]| norm.apply(x, scale, shift))
}

/// PyTorch's and slim's layer norm: value and gradients.
#[test]
fn numbers_are_those_of_the_original_modules() {
    let kinds = [("srn.norm", NormGroup::Channels, 1e-5), ("llff.norm", NormGroup::Sample, 1e-12)];
    for (prefix, group, epsilon) in kinds {
        let get = |name: &str| {
            let tensor = fixture(&format!("{prefix}.{name}"));
            // PyTorch's volumes have their channels first.
            if tensor.rank() == 5 { tensor.permute([0, 2, 3, 4, 1]).unwrap() } else { tensor }
        };
        let norm = LayerNorm { group, epsilon, relu: false };
        let found = run(norm, &["x", "scale", "shift"].map(get), &get("cotangent"));
        for (found, name) in found.iter().zip(["out", "grad.x", "grad.scale", "grad.shift"]) {
            let far = error(found, &get(name));
            assert!(far < RELATIVE, "{prefix}.{name}: {far}");
        }
    }
}

/// Of many blocks and of few numbers, in f32 against f64.
#[test]
fn value_and_gradients_are_those_of_plain_operations() {
    for norm in all_kinds() {
        for shape in [[2, 3, 5], [3, 1500, 24]] {
            let cotangent = ramp(&shape, 0.9);
            let given = [ramp(&shape, 0.1), ramp(&[shape[2]], 0.5), ramp(&[shape[2]], 0.2)];
            let found = run(norm, &given.each_ref().map(single), &single(&cotangent));
            for (found, plain) in found.iter().zip(&run(norm, &given, &cotangent)) {
                let far = error(found, plain);
                assert!(far < 1e-4, "{norm:?} {shape:?}: {far}");
            }
        }
    }
}

#[test]
fn bits_do_not_depend_on_threads_and_nan_stays() {
    for norm in all_kinds() {
        let given = [ramp(&[3, 1500, 24], 0.1), ramp(&[24], 0.5), ramp(&[24], 0.2)].each_ref().map(single);
        let cotangent = single(&ramp(&[3, 1500, 24], 0.9));
        on_any_threads(|| run(norm, &given, &cotangent));
        let broken = (&given[0] * f64::NAN).unwrap();
        let y = norm.apply(&broken, &given[1], &given[2]).unwrap();
        assert!(values(&y).iter().all(|value| value.is_nan()), "{norm:?}");
    }
}
