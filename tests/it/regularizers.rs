//! What explicit regularizers promise: exact derivatives, unbiased estimates, and fields that are
//! smoother for them.

use crate::common::{assert_says, flat, parameters, runtime, tiny_config, tiny_scene, trained};
use augnerf::base::rng::{Random, Stream};
use augnerf::field::{Cotangents, Field, Spatial};
use augnerf::losses::{L1, Laplacian, SpaceTerm, Tv, WeightedSpaceTerm, measure, regularize, regularize_at};
use augnerf::methods::{Balance, FieldLearner};
use augnerf::settings::{
    DensityActivation, Encoding, FieldConfig, Method, REGULARIZERS, RegularizedFields, Regularizer, RegularizerConfig,
};
use augnerf::space::{Lattice, Quadrature};
use augnerf::train::Trainer;
use candle_core::{DType, Device, Tensor};

mod hash;
mod terms;

const CPU: Device = Device::Cpu;
const BOX: [[f64; 3]; 2] = [[-1.0; 3], [1.0; 3]];

/// The same terms at weight 1.
fn terms() -> [WeightedSpaceTerm<'static>; 3] {
    [(&L1, 1.0), (&Tv, 1.0), (&Laplacian, 1.0)]
}

fn shape(depth: usize, skips: &[usize], octaves: usize, density_activation: DensityActivation) -> FieldConfig {
    FieldConfig {
        width: 16,
        depth,
        skips: skips.to_vec(),
        position_octaves: octaves,
        view_octaves: 1,
        density_activation,
        ..FieldConfig::default()
    }
}

fn points(seed: u64, n: usize) -> Tensor {
    let unit = Random::new(seed, Stream::Jitter, 0).uniform_tensor(&[n, 3], DType::F64, &CPU).unwrap();
    unit.affine(2.0, -1.0).unwrap()
}

/// A field whose density is positive somewhere at `points`.
fn field(config: &FieldConfig, seed: u64, points: &Tensor) -> Field {
    let drawn = (0..50).map(|index| Field::init(config, seed, index, DType::F64, &CPU).unwrap());
    let alive = |field: &Field| {
        let positive = field.raw_density(points).unwrap().gt(0f64).unwrap().to_dtype(DType::F64).unwrap();
        (0.1..0.9).contains(&positive.mean_all().unwrap().to_scalar::<f64>().unwrap())
    };
    drawn.into_iter().find(alive).expect("a field that is alive")
}

/// Largest difference over the largest magnitude.
fn relative(found: &Tensor, expected: &Tensor) -> f64 {
    assert_eq!(found.dims(), expected.dims());
    let (found, expected) = (flat(found), flat(expected));
    let scale = expected.iter().fold(1e-300, |m: f64, v| m.max(v.abs()));
    found.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / scale
}

/// Gradients of a network's parameters; what one way leaves out is 0 in the other.
#[track_caller]
fn assert_same_gradients(what: &str, found: &[Option<Tensor>], expected: &[Option<Tensor>], tolerance: f64) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (parameter, pair) in found.iter().zip(expected).enumerate() {
        let off = match pair {
            (Some(found), Some(expected)) => relative(found, expected),
            (Some(one), None) | (None, Some(one)) => {
                flat(one).into_iter().fold(0.0, |most, value| value.abs().max(most))
            }
            (None, None) => 0.0,
        };
        assert!(off <= tolerance && (off == 0.0 || pair.0.is_some() == pair.1.is_some()), "{what}, {parameter}: {off}");
    }
}

/// Trunks with no skip, one, several, one at the end; activations; octaves from 0.
fn shapes() -> Vec<FieldConfig> {
    use DensityActivation::{Relu, Softplus};
    vec![
        shape(1, &[], 3, Relu),
        shape(2, &[1], 0, Softplus),
        shape(4, &[2], 6, Softplus),
        shape(5, &[1, 4], 4, Relu),
        shape(8, &[5], 10, Relu),
    ]
}

/// Cotangents that no term has, so that every path counts.
fn odd_cotangents(n: usize) -> Cotangents {
    let wave = |phase: f64, shape: &[usize]| {
        let count: usize = shape.iter().product();
        let values: Vec<f64> = (0..count).map(|i| (i as f64 * 0.7 + phase).sin()).collect();
        Some(Tensor::from_vec(values, shape, &CPU).unwrap())
    };
    Cotangents { density: wave(0.0, &[n]), gradient: wave(1.0, &[n, 3]), laplacian: wave(2.0, &[n]) }
}

/// Those of [`odd_cotangents`] that are named.
fn chosen(used: [bool; 3], n: usize) -> Cotangents {
    let odd = odd_cotangents(n);
    Cotangents {
        density: odd.density.filter(|_| used[0]),
        gradient: odd.gradient.filter(|_| used[1]),
        laplacian: odd.laplacian.filter(|_| used[2]),
    }
}

/// Which of them a loss may have: none in a Laplacian where density has none.
fn subsets(config: &FieldConfig) -> Vec<[bool; 3]> {
    let all =
        [[true, false, false], [false, true, false], [true, true, false], [false, false, true], [true, true, true]];
    all.into_iter().filter(|used| config.has_laplacian() || !used[2]).collect()
}

/// A field that is queried at Gaussians has a gradient in their means.
#[test]
fn the_gradient_in_the_means_equals_finite_differences() {
    const STEP: f64 = 1e-6;
    let config = FieldConfig { encoding: Encoding::Integrated, ..shape(4, &[2], 16, DensityActivation::Softplus) };
    let field = Field::init(&config, 0, 0, DType::F64, &CPU).unwrap();
    let points = points(0, 33);
    let density = |points: &Tensor| {
        let gaussians = field.positions(points, [1e-3, 2e-3, 3e-3]).unwrap();
        assert_eq!(gaussians.to_vec2::<f64>().unwrap()[7][3..], [1e-3, 2e-3, 3e-3]);
        (gaussians.clone(), field.activate_density(&field.raw_density(&gaussians).unwrap()).unwrap())
    };
    let gradient = field.density_gradient(&density(&points).0).unwrap();
    for axis in 0..3 {
        let mut step = [0.0; 3];
        step[axis] = STEP;
        let moved = |sign: f64| {
            let step = Tensor::new(&step.map(|v| sign * v), &CPU).unwrap();
            density(&points.broadcast_add(&step).unwrap()).1
        };
        let slope = ((moved(1.0) - moved(-1.0)).unwrap() / (2.0 * STEP)).unwrap();
        let found = gradient.narrow(1, axis, 1).unwrap().squeeze(1).unwrap();
        // A kink of a ReLU may lie within a step.
        let close =
            flat(&found).iter().zip(flat(&slope)).filter(|(a, b)| (*a - b).abs() < 1e-5 * (1.0 + b.abs())).count();
        assert!(close >= 31, "axis {axis}: {close} of 33");
    }
}

/// Tangents have the gradient that candle finds in the points.
#[test]
fn the_gradient_is_that_of_autodiff() {
    for (i, config) in shapes().iter().enumerate() {
        let points = points(i as u64, 33);
        assert_gradient_is_exact(&field(config, i as u64, &points), &points);
    }
}

fn assert_gradient_is_exact(field: &Field, points: &Tensor) {
    let (at, config) = (field.spatial(points).unwrap().at, field.config());
    assert!(relative(&field.density_gradient(points).unwrap(), &at.gradient) < 1e-11, "{config:?}");
    assert!(config.has_laplacian() || flat(&at.laplacian).iter().all(|value| value.is_nan()));
}

/// With the gradient of a hash grid's table, of the record that there may be.
fn weight_gradients(field: &Field, spatial: &Spatial, loss: &Cotangents) -> Vec<Option<Tensor>> {
    let (mut gradients, record) = spatial.weight_gradients(loss).unwrap();
    if let Some(record) = record {
        gradients[0] = field.table_gradient(&[record]).unwrap();
    }
    gradients
}

fn narrow(loss: &Cotangents) -> Cotangents {
    let [density, gradient, laplacian] =
        [&loss.density, &loss.gradient, &loss.laplacian].map(|d| d.as_ref().map(|d| d.to_dtype(DType::F32).unwrap()));
    Cotangents { density, gradient, laplacian }
}

/// The adjoints of the fused core against the plain tangents in f64: densities, terms and weight gradients, with points that
/// matter and others, within a tile and beyond it.
#[test]
fn the_fused_slope_equals_the_plain_one() {
    for (activation, count) in [
        (DensityActivation::Relu, 1),
        (DensityActivation::Relu, 513),
        (DensityActivation::Relu, 1100),
        (DensityActivation::Softplus, 700),
    ] {
        let config = FieldConfig { width: 48, ..shape(5, &[2, 4], 4, activation) };
        let some = points(9, 64);
        let points = points(9, count).to_dtype(DType::F32).unwrap().to_dtype(DType::F64).unwrap();
        let exact = field(&config, 9, &some);
        let values: Vec<Tensor> = exact.variables().iter().map(|(_, var)| var.to_dtype(DType::F32).unwrap()).collect();
        let double = values.iter().map(|value| value.to_dtype(DType::F64).unwrap()).collect();
        let exact = Field::from_parameters(&config, double).unwrap();
        let fused = Field::from_parameters(&config, values).unwrap().prepared().unwrap();
        let single = points.to_dtype(DType::F32).unwrap();
        let (a, b) = (fused.spatial(&single).unwrap(), exact.spatial(&points).unwrap());
        for (name, a, b) in [
            ("density", &a.at.density, &b.at.density),
            ("gradient", &a.at.gradient, &b.at.gradient),
            ("laplacian", &a.at.laplacian, &b.at.laplacian),
        ] {
            assert!(relative(a, b) < 1e-4, "{name} {activation:?} {count}");
        }
        let all = terms();
        for terms in [&all[..], &all[..1], &all[1..2], &all[2..]] {
            let names: Vec<&str> = terms.iter().map(|(term, _)| term.name()).collect();
            let a = regularize_at(&fused, &single, terms, 1.0).unwrap();
            let b = regularize_at(&exact, &points, terms, 1.0).unwrap();
            assert_same_gradients(&format!("{names:?} {activation:?} {count}"), &a.gradients, &b.gradients, 1e-3);
        }
        for used in subsets(&config) {
            let odd = chosen(used, count);
            let (a, b) = (weight_gradients(&fused, &a, &narrow(&odd)), weight_gradients(&exact, &b, &odd));
            assert_same_gradients(&format!("{used:?} {activation:?} {count}"), &a, &b, 1e-3);
        }
    }
}

/// density = 0.5 (sin x + 2) + 0.25 (cos 2y + 3) + 0.1 (z + 5): every unit always active.
fn known(density_activation: DensityActivation) -> Field {
    let config = FieldConfig { width: 4, ..shape(1, &[], 2, density_activation) };
    let names = Field::parameter_names(&config);
    let tensor = |(name, shape): &(String, Vec<usize>)| {
        let count: usize = shape.iter().product();
        let mut values = vec![0.0; count];
        match name.as_str() {
            // Channels: x y z | sin x y z | cos x y z | sin 2x 2y 2z | cos 2x 2y 2z.
            "trunk.0.weight" => {
                [(0, 3), (1, 13), (2, 2)].iter().for_each(|&(row, column)| values[row * 15 + column] = 1.0)
            }
            "trunk.0.bias" => values.copy_from_slice(&[2.0, 3.0, 5.0, 0.0]),
            "density.weight" => values.copy_from_slice(&[0.5, 0.25, 0.1, 0.0]),
            _ => {}
        }
        Tensor::from_vec(values, shape.as_slice(), &CPU).unwrap()
    };
    Field::from_parameters(&config, names.iter().map(tensor).collect()).unwrap()
}

#[test]
fn a_field_with_known_derivatives() {
    let points = points(7, 20);
    let rows = points.to_vec2::<f64>().unwrap();
    let raw = |p: &[f64]| 0.5 * (p[0].sin() + 2.0) + 0.25 * ((2.0 * p[1]).cos() + 3.0) + 0.1 * (p[2] + 5.0);
    let slope = |p: &[f64]| [0.5 * p[0].cos(), -0.5 * (2.0 * p[1]).sin(), 0.1];
    let curvature = |p: &[f64]| -0.5 * p[0].sin() - (2.0 * p[1]).cos();
    for activation in [DensityActivation::Relu, DensityActivation::Softplus, DensityActivation::Exp] {
        let field = known(activation);
        let spatial = field.spatial(&points).unwrap().at;
        let (density, gradient, laplacian) =
            (flat(&spatial.density), spatial.gradient.to_vec2::<f64>().unwrap(), flat(&spatial.laplacian));
        for (i, p) in rows.iter().enumerate() {
            let sigmoid = 1.0 / (1.0 + (1.0 - raw(p)).exp());
            let (value, first, second) = match activation {
                DensityActivation::Relu => (raw(p), 1.0, 0.0),
                DensityActivation::Softplus => ((raw(p) - 1.0).exp().ln_1p(), sigmoid, sigmoid * (1.0 - sigmoid)),
                DensityActivation::Exp => ((raw(p) - 1.0).exp(), (raw(p) - 1.0).exp(), (raw(p) - 1.0).exp()),
            };
            let square: f64 = slope(p).iter().map(|g| g * g).sum();
            assert!((density[i] - value).abs() < 1e-13);
            gradient[i].iter().zip(slope(p)).for_each(|(a, b)| assert!((a - first * b).abs() < 1e-13));
            assert!((laplacian[i] - (first * curvature(p) + second * square)).abs() < 1e-13);
        }
    }
    // Integrals over [-1, 1]^3: sin x and z vanish, cos 2y gives sin 2 over its side.
    let lattice = Lattice { domain: BOX, side: 40 };
    let found = measure(&known(DensityActivation::Relu), &lattice, |_| ()).unwrap();
    let l1 = 8.0 * (0.5 * 2.0 + 0.25 * 3.0 + 0.1 * 5.0) + 4.0 * 0.25 * 2f64.sin();
    // The midpoint rule's error is of second order in the cell: 2e-4 here.
    assert!((found.l1 / l1 - 1.0).abs() < 1e-4, "{} {l1}", found.l1);
    assert_eq!(found.occupied, 1.0);
    assert!((found.largest_density - 3.02).abs() < 0.03, "{}", found.largest_density);
}

/// Most of space at the start: flat, empty, without a direction.
#[test]
fn a_flat_density_has_no_pull_and_no_nan() {
    for (bias, flat_density) in [(-5.0, 0.0), (0.0, 0.0), (5.0, 5.0)] {
        let config = shape(3, &[1], 4, DensityActivation::Relu);
        let names = Field::parameter_names(&config);
        let values = names.iter().map(|(name, shape)| match name.as_str() {
            "density.bias" => Tensor::new(&[bias], &CPU).unwrap(),
            "density.weight" => Tensor::zeros(shape.as_slice(), DType::F64, &CPU).unwrap(),
            _ => Tensor::ones(shape.as_slice(), DType::F64, &CPU).unwrap(),
        });
        let field = Field::from_parameters(&config, values.collect()).unwrap();
        let found = regularize_at(&field, &points(1, 10), &terms(), 0.1).unwrap();
        assert_eq!(flat(&found.values), [flat_density, 0.0, 0.0]);
        for ((name, _), gradient) in names.iter().zip(found.gradients) {
            let Some(gradient) = gradient else { continue };
            let values = flat(&gradient);
            assert!(values.iter().all(|v| v.is_finite()), "{name}");
            let pulled = flat_density > 0.0 && name.starts_with("density");
            assert_eq!(values.iter().any(|v| *v != 0.0), pulled, "{name} {values:?}");
        }
    }
}

fn sampled(side: usize, points_per_step: usize, jitter: bool) -> RegularizerConfig {
    RegularizerConfig { lattice: side, points_per_step, jitter, ..RegularizerConfig::default() }
}

/// Mean and standard error of the three terms over `seeds` draws.
fn estimates(field: &Field, config: &RegularizerConfig, seeds: u64) -> [(f64, f64); 3] {
    let draws: Vec<Vec<f64>> = (0..seeds)
        .map(|seed| {
            let points = config.quadrature(seed, 3);
            flat(&regularize(field, &points, &terms()).unwrap().values)
        })
        .collect();
    std::array::from_fn(|term| {
        let n = seeds as f64;
        let mean = draws.iter().map(|draw| draw[term]).sum::<f64>() / n;
        let variance = draws.iter().map(|draw| (draw[term] - mean).powi(2)).sum::<f64>() / (n - 1.0);
        (mean, (variance / n).sqrt())
    })
}

#[test]
fn the_estimate_is_unbiased() {
    // Midpoints of random cells: unbiased for the lattice's own sum, however rough the field.
    let rough = shape(8, &[5], 10, DensityActivation::Relu);
    // Random points in them: unbiased for the integral, which a fine lattice finds on a smooth field.
    let smooth = shape(4, &[2], 1, DensityActivation::Softplus);
    for (shape, seed, side, jitter) in [(rough, 60, 16, false), (smooth, 61, 64, true)] {
        let field = field(&shape, seed, &points(seed, 40));
        let full = measure(&field, &Lattice { domain: BOX, side }, |_| ()).unwrap();
        let found = estimates(&field, &sampled(16, 128, jitter), 200);
        for ((mean, error), full) in found.into_iter().zip([full.l1, full.tv, full.laplacian.unwrap()]) {
            assert!((mean - full).abs() < 3.5 * error && error < 0.05 * full, "{mean} +- {error}, full {full}");
        }
    }
}

#[test]
fn all_cells_once_are_the_full_lattice() {
    let lattice = Lattice { domain: [[-1.0, 0.0, 2.0], [1.0, 0.5, 5.0]], side: 5 };
    assert!((lattice.volume() - 3.0).abs() < 1e-12);
    let config = RegularizerConfig { domain: lattice.domain, ..sampled(5, 125, false) };
    let field = field(&shape(4, &[2], 3, DensityActivation::Softplus), 9, &points(9, 40));
    let run = |points: &Quadrature| regularize(&field, points, &terms().map(|(term, _)| (term, 2.0))).unwrap();
    let (some, all) = (run(&config.quadrature(0, 0)), run(&Quadrature::full(lattice)));
    for (a, b) in flat(&some.values).iter().zip(flat(&all.values)) {
        assert!((a / b - 1.0).abs() < 1e-12);
    }
    assert_same_gradients("all cells", &some.gradients, &all.gradients, 1e-9);
}

#[test]
fn points_stay_in_their_cells_and_are_fresh_in_each_step() {
    let draw = |seed, step| {
        let points = sampled(8, 100, true).quadrature(seed, step);
        points.tensor(0, 100, DType::F64, &CPU).unwrap().to_vec2::<f64>().unwrap()
    };
    let first = draw(0, 0);
    let mut cells: Vec<[i64; 3]> =
        first.iter().map(|p| std::array::from_fn(|axis| ((p[axis] + 1.0) * 4.0).floor() as i64)).collect();
    assert!(cells.iter().flatten().all(|c| (0..8).contains(c)));
    cells.sort_unstable();
    cells.dedup();
    assert_eq!(cells.len(), 100, "a cell was drawn twice");
    assert_eq!(first, draw(0, 0));
    assert!(first != draw(0, 1) && first != draw(1, 0));
}

fn regularized(
    kind: Regularizer,
    weight: f64,
    change: impl FnOnce(&mut RegularizerConfig),
) -> augnerf::settings::Resolved {
    tiny_config(Method::Nerf, |config| {
        config.regularizer.kind = vec![kind];
        config.regularizer.weight = vec![weight];
        config.regularizer.lattice = 16;
        config.regularizer.points_per_step = 256;
        change(&mut config.regularizer);
    })
}

#[test]
fn fine_only_leaves_the_coarse_field_alone() {
    let plain = trained(&tiny_config(Method::Nerf, |_| {}), 3);
    let fine = trained(&regularized(Regularizer::L1, 1e-2, |r| r.fields = RegularizedFields::Fine), 3);
    let both = trained(&regularized(Regularizer::L1, 1e-2, |_| {}), 3);
    assert_eq!(parameters(&plain, &["coarse"]), parameters(&fine, &["coarse"]));
    assert_ne!(parameters(&plain, &["coarse"]), parameters(&both, &["coarse"]));
    assert_ne!(parameters(&plain, &["fine"]), parameters(&fine, &["fine"]));
}

fn balance(trainer: &Trainer, regularizer: &RegularizerConfig) -> Vec<Balance> {
    let fields = trainer.model().unwrap().fields().unwrap().clone();
    let mut learner = FieldLearner::new(trainer.config(), &tiny_scene(), fields, DType::F32, &CPU).unwrap();
    learner.balance(regularizer, trainer.step_count()).unwrap()
}

#[test]
fn the_balance_is_a_ratio_of_gradient_norms_and_moves_nothing() {
    let trainer = trained(&tiny_config(Method::Nerf, |_| {}), 5);
    let before = parameters(&trainer, &["coarse", "fine"]);
    let balances = balance(&trainer, &sampled(16, 256, true));
    // A network has no tables.
    assert_eq!(balances.len(), REGULARIZERS.len() - 1);
    assert!(balances.iter().all(|b| b.term_norm > 0.0 && b.photometric_norm == balances[0].photometric_norm));
    assert_eq!(before, parameters(&trainer, &["coarse", "fine"]));

    // A term's norm is over both networks, at the points of the step that comes next.
    let config = sampled(16, 256, true);
    let points = config.quadrature(trainer.config().seed, trainer.step_count());
    for (balance, term) in balances.iter().zip(terms()) {
        assert_eq!(balance.term, term.0.name());
        let of_field = |(_, field): (&'static str, &Field)| {
            let term = regularize(field, &points, &[term]).unwrap();
            term.gradients.iter().flatten().flat_map(flat).map(|g| g * g).sum::<f64>()
        };
        let norm = trainer.model().unwrap().fields().unwrap().by_role().map(of_field).sum::<f64>().sqrt();
        assert!((balance.term_norm / norm - 1.0).abs() < 1e-4, "{balance:?} {norm}");
    }

    // The photometric one is what a step of stochastic gradient descent would move: Adam's first moment after its
    // first step is a tenth of the gradient.
    let mut fresh = trained(&tiny_config(Method::Nerf, |_| {}), 0);
    let expected = balance(&fresh, &config)[0].photometric_norm;
    fresh.step(false).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let checkpoint = fresh.save(dir.path()).unwrap();
    let saved = candle_core::safetensors::load(checkpoint.join("state.safetensors"), &CPU).unwrap();
    let moments = saved.iter().filter(|(name, _)| name.starts_with("adam.first."));
    let moment = moments.flat_map(|(_, tensor)| flat(tensor)).map(|m| m * m).sum::<f64>().sqrt();
    assert!((moment / (0.1 * expected) - 1.0).abs() < 1e-4, "{moment} {expected}");
}

#[test]
fn a_term_of_ones_own_needs_its_formula_alone() {
    /// The paper's TV by its formula, without derivatives of its own.
    struct Slope;
    impl SpaceTerm for Slope {
        fn name(&self) -> &str {
            "slope"
        }
        fn at_points(&self, at: &augnerf::field::DensityAt) -> augnerf::base::Result<Tensor> {
            Ok((at.gradient.sqr()?.sum(1)? + 1e-30)?.sqrt()?)
        }
    }
    let config = shape(4, &[2], 4, DensityActivation::Softplus);
    let points = points(3, 33);
    let field = field(&config, 3, &points);
    let own = regularize_at(&field, &points, &[(&Slope, 0.7)], 0.1).unwrap();
    let tv = regularize_at(&field, &points, &[(&Tv, 0.7)], 0.1).unwrap();
    assert!(relative(&own.values, &tv.values) < 1e-12);
    assert_same_gradients("slope", &own.gradients, &tv.gradients, 1e-9);
}
