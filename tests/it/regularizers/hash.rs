//! The same of fields on a hash grid.

use super::*;
use crate::common::assert_refused;
use augnerf::settings::{Contraction, HashConfig, Interpolation};

const CONTRACTIONS: [Contraction; 3] = [Contraction::None, Contraction::Axes, Contraction::Ball];

/// Points of -1..1 lie on both sides of this box.
const GRID_BOX: [[f64; 3]; 2] = [[-0.8, -0.5, -2.0], [0.7, 1.5, 2.0]];

fn on_grid(interpolation: Interpolation, contraction: Contraction, config: FieldConfig) -> FieldConfig {
    let hash = HashConfig {
        levels: 4,
        features: 2,
        log2_table: 8,
        coarsest: 3,
        finest: Some(14),
        interpolation,
        bounds: Some(GRID_BOX),
        contraction: Some(contraction),
    };
    FieldConfig { encoding: Encoding::Hash, hash, ..config }
}

/// Interpolations, contractions and activations, each with each, on trunks with and without skips.
fn grids() -> Vec<FieldConfig> {
    use DensityActivation::{Exp, Relu, Softplus};
    let trunks = [shape(1, &[], 0, Exp), shape(3, &[1], 0, Relu), shape(4, &[2, 3], 0, Softplus)];
    let mut grids = Vec::new();
    for interpolation in [Interpolation::Linear, Interpolation::Smoothstep] {
        for contraction in CONTRACTIONS {
            grids.extend(trunks.iter().map(|trunk| on_grid(interpolation, contraction, trunk.clone())));
        }
    }
    grids
}

/// A field with tables as large as training makes them, alive at `points`.
fn rough(config: &FieldConfig, seed: u64, points: &Tensor) -> Field {
    let drawn = (0..50).map(|index| {
        let field = Field::init(config, seed, index, DType::F64, &CPU).unwrap();
        let mut values: Vec<Tensor> = field.variables().iter().map(|(_, var)| var.as_tensor().clone()).collect();
        values[0] = (&values[0] * 1e4).unwrap();
        Field::from_parameters(config, values).unwrap()
    });
    let alive = |field: &Field| {
        let raw = flat(&field.raw_density(points).unwrap());
        let inside: Vec<f64> = raw.into_iter().filter(|raw| *raw > -1e3).collect();
        let share = inside.iter().filter(|raw| **raw > 0.0).count() as f64 / inside.len() as f64;
        (0.2..0.8).contains(&share)
    };
    drawn.into_iter().find(alive).expect("a field that is alive")
}

#[test]
fn the_gradient_is_that_of_autodiff() {
    for (i, config) in grids().iter().enumerate() {
        let points = points(i as u64, 33);
        assert_gradient_is_exact(&rough(config, i as u64, &points), &points);
    }
}

#[test]
fn nothing_is_outside_the_box() {
    for interpolation in [Interpolation::Linear, Interpolation::Smoothstep] {
        for activation in [DensityActivation::Exp, DensityActivation::Relu, DensityActivation::Softplus] {
            let config = on_grid(interpolation, Contraction::None, shape(2, &[], 0, activation));
            let field = rough(&config, 3, &points(3, 64));
            let outside = Tensor::new(&[[-0.81f64, 0.0, 0.0], [0.0, 1.6, 0.0], [0.0, 0.0, -9.0]], &CPU).unwrap();
            let spatial: Spatial = field.spatial(&outside).unwrap();
            assert_eq!(flat(&spatial.at.density), [0.0; 3]);
            assert_eq!(flat(&spatial.at.gradient), [0.0; 9]);
            for used in subsets(&config) {
                for gradient in weight_gradients(&field, &spatial, &chosen(used, 3)).into_iter().flatten() {
                    assert!(flat(&gradient).iter().all(|value| *value == 0.0), "{config:?} {used:?}");
                }
            }
        }
    }
}

/// The fused core's kernels, and candle's operations in f32, against f64.
#[test]
fn kernels_equal_the_reference() {
    for (i, config) in grids().iter().enumerate() {
        let few = points(60 + i as u64, 64).to_dtype(DType::F32).unwrap().to_dtype(DType::F64).unwrap();
        let exact = rough(config, 60 + i as u64, &few);
        let singles: Vec<Tensor> = exact.variables().iter().map(|(_, var)| var.to_dtype(DType::F32).unwrap()).collect();
        let doubles = singles.iter().map(|value| value.to_dtype(DType::F64).unwrap()).collect();
        let exact = Field::from_parameters(config, doubles).unwrap();
        let plain = Field::from_parameters(config, singles).unwrap();
        let fused = plain.prepared().unwrap();
        let b = exact.spatial(&few).unwrap();
        let single = few.to_dtype(DType::F32).unwrap();
        for (name, field) in [("plain", plain), ("fused", fused)] {
            let a = field.spatial(&single).unwrap();
            assert!(relative(&a.at.density, &b.at.density) < 1e-4, "{name} {config:?}");
            assert!(relative(&a.at.gradient, &b.at.gradient) < 1e-4, "{name} {config:?}");
            let off = if config.has_laplacian() { relative(&a.at.laplacian, &b.at.laplacian) } else { 0.0 };
            assert!(off < 1e-3, "{name} {off} {config:?}");
            for used in subsets(config) {
                let odd = chosen(used, 64);
                let (a, b) = (weight_gradients(&field, &a, &narrow(&odd)), weight_gradients(&exact, &b, &odd));
                assert_same_gradients(&format!("{name} {used:?} {config:?}"), &a, &b, 1e-3);
            }
        }
    }
}

#[test]
fn chunks_add_up_to_the_same_bytes_for_any_number_of_threads() {
    let config = on_grid(Interpolation::Smoothstep, Contraction::Ball, shape(1, &[], 0, DensityActivation::Exp));
    let few = points(9, 64);
    let values = rough(&config, 9, &few).variables().iter().map(|(_, var)| var.to_dtype(DType::F32).unwrap()).collect();
    let field = Field::from_parameters(&config, values).unwrap();
    // More points than records wait for, none on a face of the grid, where second derivatives jump.
    let lattice = Lattice { domain: [[-1.013, -0.971, -0.937], [0.991, 0.957, 1.019]], side: 42 };
    let sums = [1, 2, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let found = pool.install(|| regularize(&field, &Quadrature::full(lattice), &terms()).unwrap());
        found.gradients.into_iter().map(|gradient| gradient.map(|gradient| flat(&gradient))).collect::<Vec<_>>()
    });
    assert_eq!(sums[0], sums[1]);
    assert_eq!(sums[0], sums[2]);
    let values: Vec<Tensor> = field.variables().iter().map(|(_, var)| var.to_dtype(DType::F64).unwrap()).collect();
    let exact = Field::from_parameters(&config, values).unwrap();
    let exact = regularize(&exact, &Quadrature::full(lattice), &terms()).unwrap();
    for (found, expected) in sums[0].iter().zip(exact.gradients) {
        let (Some(found), Some(expected)) = (found, expected) else { continue };
        let found = Tensor::from_vec(found.clone(), expected.shape(), &CPU).unwrap();
        assert!(relative(&found, &expected) < 1e-3, "{}", relative(&found, &expected));
    }
}

#[test]
fn a_linear_grid_has_no_laplacian() {
    let lattice = Lattice { domain: BOX, side: 8 };
    for interpolation in [Interpolation::Linear, Interpolation::Smoothstep] {
        let config = on_grid(interpolation, Contraction::Axes, shape(1, &[], 0, DensityActivation::Exp));
        let found = measure(&rough(&config, 5, &points(5, 64)), &lattice, |_| ()).unwrap();
        assert!(found.l1 > 0.0 && found.tv > 0.0);
        assert_eq!(
            found.laplacian.is_some_and(|laplacian| laplacian > 0.0),
            interpolation == Interpolation::Smoothstep
        );
        assert_eq!(found.laplacian.is_some(), interpolation == Interpolation::Smoothstep);
    }
    let linear = "field.encoding=hash; regularizer.kind=laplacian; field.hash.interpolation=linear";
    assert_refused(&[(linear, &["laplacian", "no second derivative", "smoothstep"])]);
}
