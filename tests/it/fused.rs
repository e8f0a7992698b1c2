//! The fused field against the plain one: outputs, every gradient, odd sizes, NaN. (Threads: runtime.rs, controls.rs.)

use crate::common::flat;
use augnerf::base::rng::{Random, Stream};
use augnerf::field::{FeatureDelta, Field};
use augnerf::settings::{Contraction, Core, Encoding, FieldConfig, HashConfig, Interpolation, Precision};
use candle_core::{DType, Device, Tensor, Var};
use proptest::prelude::*;

const CPU: Device = Device::Cpu;

#[derive(Clone, Debug)]
struct Case {
    field: FieldConfig,
    rays: usize,
    samples: usize,
    /// 0: no delta.
    layer: usize,
    seed: u64,
    /// Share of the points that are pulled on; the others have gradient 0.
    pulled: f64,
}

fn case() -> impl Strategy<Value = Case> {
    let shape = (1usize..40, 1usize..9, 0usize..11, 0usize..5, prop::collection::vec(1usize..8, 0..3));
    (shape, 1usize..6, prop::sample::select(vec![1usize, 2, 7, 64, 129]), 0usize..9, any::<u32>()).prop_map(
        |((half, depth, position_octaves, view_octaves, skips), rays, samples, layer, seed)| {
            let mut skips: Vec<usize> = skips.into_iter().filter(|&skip| skip < depth).collect();
            skips.sort();
            skips.dedup();
            let field =
                FieldConfig { width: 2 * half, depth, skips, position_octaves, view_octaves, ..FieldConfig::default() };
            Case { field, rays, samples, layer: if layer > depth { 0 } else { layer }, seed: seed.into(), pulled: 1.0 }
        },
    )
}

/// Everything that a case gives: raw colour, raw density, gradients of points, view directions and delta, then of the
/// weights.
struct Found {
    outputs: Vec<Tensor>,
    inputs: Vec<Tensor>,
    weights: Vec<Tensor>,
}

fn random(seed: u64, index: u64, shape: &[usize]) -> Tensor {
    Random::new(seed, Stream::Jitter, index).uniform_tensor(shape, DType::F64, &CPU).unwrap().affine(2.0, -1.0).unwrap()
}

fn field(case: &Case, core: Core, dtype: DType) -> Field {
    let config = FieldConfig { core, ..case.field.clone() };
    let exact = FieldConfig { precision: Precision::F32, ..config.clone() };
    let exact = Field::init(&exact, case.seed, 0, DType::F64, &CPU).unwrap();
    // Biases that are not 0, and the same numbers in every precision.
    let values = exact.variables().iter().enumerate().map(|(i, (_, var))| {
        let is_table = matches!(case.field.encoding, Encoding::Hash) && i == 0;
        let value = if var.rank() == 1 || is_table {
            random(case.seed, 100 + i as u64, var.dims())
        } else {
            var.as_tensor().clone()
        };
        value.to_dtype(DType::F32).unwrap().to_dtype(dtype).unwrap()
    });
    Field::from_parameters(&config, values.collect()).unwrap()
}

/// Asks a field and pulls back a random combination of what it says. `frozen`: no gradients of weights.
fn ask(case: &Case, field: &Field, dtype: DType, frozen: bool) -> Found {
    let n = case.rays * case.samples;
    let input = |index: u64, shape: &[usize]| {
        let single = random(case.seed, index, shape).to_dtype(DType::F32).unwrap();
        Var::from_tensor(&single.to_dtype(dtype).unwrap()).unwrap()
    };
    let points = match case.field.encoding {
        Encoding::Positional | Encoding::Hash => input(0, &[n, 3]),
        Encoding::Integrated => {
            // Variances from 1e-6 to 1.
            let variance = (random(case.seed, 6, &[n, 3]) * 7.0).unwrap().exp().unwrap().affine(1e-3, 0.0).unwrap();
            let gaussians = Tensor::cat(&[random(case.seed, 0, &[n, 3]), variance], 1).unwrap();
            let single = gaussians.to_dtype(DType::F32).unwrap().to_dtype(dtype).unwrap();
            Var::from_tensor(&single).unwrap()
        }
    };
    let viewdirs = input(1, &[case.rays, 3]);
    let delta = input(2, &[n, case.field.width]);
    let recording = if frozen { field.frozen().unwrap() } else { field.recording().unwrap() };
    let at = (case.layer > 0).then(|| FeatureDelta { layer: case.layer, delta: delta.as_tensor() });
    let raw = recording.forward(&points, &viewdirs, at).unwrap();
    // The same points for colour and density.
    let chosen = random(case.seed, 5, &[n, 1]).affine(0.5, 0.5).unwrap().lt(case.pulled).unwrap();
    let pull = |index: u64, out: &Tensor| {
        let weights = random(case.seed, index, &[n, out.elem_count() / n.max(1)]);
        let weights =
            weights.broadcast_mul(&chosen.to_dtype(DType::F64).unwrap()).unwrap().reshape(out.shape()).unwrap();
        let weights = weights.to_dtype(DType::F32).unwrap().to_dtype(dtype).unwrap();
        (out * weights).unwrap().sum_all().unwrap()
    };
    let gradients = (pull(3, &raw.rgb) + pull(4, &raw.density)).unwrap().backward().unwrap();
    let of = |var: &Tensor| match gradients.get(var) {
        Some(gradient) => gradient.clone(),
        None => var.zeros_like().unwrap(),
    };
    let records = recording.table_records();
    let recorded = recording.recorded().unwrap().into_iter().zip(recording.variables());
    let weights = recorded.map(|(recorded, (name, var))| match recorded {
        Some(gradient) => gradient,
        None if name == "table" && !records.is_empty() => recording.table_gradient(&records).unwrap().unwrap(),
        None => of(var),
    });
    let weights = weights.collect();
    Found { outputs: vec![raw.rgb, raw.density], inputs: vec![of(&points), of(&viewdirs), of(&delta)], weights }
}

/// Differences over the largest magnitude of either; ReLU kinks leave single values far off, means close.
fn assert_close(what: &str, found: &[Tensor], expected: &[Tensor], mean: f64) {
    assert_close_beside(1e-6, what, found, expected, mean);
}

/// The same over `terms`, the magnitude of what was added up, where the sums are smaller.
fn assert_close_beside(terms: f64, what: &str, found: &[Tensor], expected: &[Tensor], mean: f64) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert_eq!(found.dims(), expected.dims(), "{what} {i}");
        let (found, expected) = (flat(found), flat(expected));
        let scale = expected.iter().fold(terms, |m: f64, v| m.max(v.abs()));
        let off: f64 = found.iter().zip(&expected).map(|(a, b)| (a - b).abs()).sum::<f64>() / found.len().max(1) as f64;
        assert!(off / scale < mean, "{what} {i}: off by {off:e} of {scale:e} in the mean");
    }
}

/// The plain field in f64 is the oracle.
fn assert_fused_equals_plain(case: &Case) {
    let exact = ask(case, &field(case, Core::Plain, DType::F64), DType::F64, false);
    let fused_field = field(case, Core::Fused, DType::F32);
    let fused = ask(case, &fused_field, DType::F32, false);
    // Density of a single point can be 1e-3 as the sum of 68 products, whose roundings are 2e-7.
    assert_close_beside(5e-2, "outputs", &fused.outputs, &exact.outputs, 2e-5);
    // In a small case one ReLU that a rounding flips is a good part of a gradient.
    assert_close("weights", &fused.weights, &exact.weights, 2e-2);
    assert_close("inputs", &fused.inputs, &exact.inputs, 2e-2);
    assert_frozen_is_the_same(case, &fused_field, &fused);
}

/// Frozen weights change no bit of what a field gives besides their gradients.
fn assert_frozen_is_the_same(case: &Case, field: &Field, found: &Found) {
    let frozen = ask(case, field, DType::F32, true);
    assert!(frozen.weights.is_empty());
    for (a, b) in frozen.inputs.iter().chain(&frozen.outputs).zip(found.inputs.iter().chain(&found.outputs)) {
        assert_eq!(flat(a), flat(b));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn fused_equals_plain(case in case()) {
        assert_fused_equals_plain(&case);
    }

    #[test]
    fn a_fused_hash_field_equals_the_plain_one(case in case(), smooth in any::<bool>(), view_depth in 1usize..3) {
        let interpolation = if smooth { Interpolation::Smoothstep } else { Interpolation::Linear };
        assert_fused_equals_plain(&on_a_grid(&case, interpolation, view_depth));
    }
}

/// A field on a hash grid with dense and hashed levels, whose table is far from its start.
fn on_a_grid(case: &Case, interpolation: Interpolation, view_depth: usize) -> Case {
    let hash = HashConfig {
        levels: 5,
        log2_table: 9,
        coarsest: 4,
        finest: Some(40),
        interpolation,
        bounds: Some([[-1.0; 3], [1.0; 3]]),
        contraction: Some(Contraction::None),
        ..HashConfig::default()
    };
    let field = FieldConfig { encoding: Encoding::Hash, hash, view_depth, ..case.field.clone() };
    Case { field, ..case.clone() }
}

fn paper() -> Case {
    Case { field: FieldConfig::default(), rays: 3, samples: 400, layer: 4, seed: 5, pulled: 1.0 }
}

#[test]
fn the_paper_s_shape() {
    let exact = ask(&paper(), &field(&paper(), Core::Plain, DType::F64), DType::F64, false);
    let plain = ask(&paper(), &field(&paper(), Core::Plain, DType::F32), DType::F32, false);
    let fused = ask(&paper(), &field(&paper(), Core::Fused, DType::F32), DType::F32, false);
    for found in [&plain, &fused] {
        assert_close("outputs", &found.outputs, &exact.outputs, 1e-5);
        assert_close("weights", &found.weights, &exact.weights, 1e-4);
        // The top octave multiplies an argument's rounding by 512.
        assert_close("inputs", &found.inputs, &exact.inputs, 1e-3);
    }
}

/// Points without gradient take no part: around a tile's border, with most points idle, and with all.
#[test]
fn sizes_and_idle_points() {
    for (samples, pulled) in
        [(1, 1.0), (511, 1.0), (512, 1.0), (513, 1.0), (1025, 1.0), (400, 0.2), (1300, 0.2), (1300, 0.9), (600, 0.0)]
    {
        let field_config = FieldConfig { width: 32, depth: 3, skips: vec![2], ..FieldConfig::default() };
        let case = Case { field: field_config, rays: 1, samples, layer: 2, seed: 8, pulled };
        let exact = ask(&case, &field(&case, Core::Plain, DType::F64), DType::F64, false);
        let fused = ask(&case, &field(&case, Core::Fused, DType::F32), DType::F32, false);
        let what = |part: &str| format!("{part} of {samples} points, {pulled} pulled on,");
        // A single output may be the small difference of large terms.
        assert_close(&what("outputs"), &fused.outputs, &exact.outputs, 1e-4);
        assert_close(&what("weights"), &fused.weights, &exact.weights, 1e-4);
        assert_close(&what("inputs"), &fused.inputs, &exact.inputs, 1e-3);
    }
}

/// Only what is wanted is computed, and it is the same.
#[test]
fn each_gradient_alone_equals_it_among_all() {
    let case = paper();
    let frozen = field(&case, Core::Fused, DType::F32).frozen().unwrap();
    let n = case.rays * case.samples;
    let single = |index: u64, shape: &[usize]| random(case.seed, index, shape).to_dtype(DType::F32).unwrap();
    let inputs = [single(0, &[n, 3]), single(1, &[case.rays, 3]), single(2, &[n, case.field.width])];
    let gradients = |tracked: [bool; 3]| {
        let vars = inputs.clone().map(|input| Var::from_tensor(&input).unwrap());
        let pick = |i: usize| if tracked[i] { vars[i].as_tensor().clone() } else { inputs[i].clone() };
        let delta = pick(2);
        let raw = frozen.forward(&pick(0), &pick(1), Some(FeatureDelta { layer: case.layer, delta: &delta })).unwrap();
        let loss = (raw.rgb.sqr().unwrap().sum_all().unwrap() + raw.density.sum_all().unwrap()).unwrap();
        let store = loss.backward().unwrap();
        vars.map(|var| store.get(&var).map(flat))
    };
    let all = gradients([true; 3]);
    for i in 0..3 {
        let mut alone = [false; 3];
        alone[i] = true;
        let found = gradients(alone);
        assert_eq!(found[i], all[i], "input {i}");
        assert!((0..3).all(|j| found[j].is_some() == (j == i)));
    }
}

/// Points that are fixed give what points that are not give.
#[test]
fn fixed_points_change_nothing() {
    for (skips, layer) in [(vec![5], 4), (vec![5], 6), (vec![2], 1), (vec![], 8)] {
        let case = Case { field: FieldConfig { width: 24, skips, ..FieldConfig::default() }, layer, ..paper() };
        let frozen = field(&case, Core::Fused, DType::F32).frozen().unwrap();
        let n = case.rays * case.samples;
        let single = |index: u64, shape: &[usize]| random(case.seed, index, shape).to_dtype(DType::F32).unwrap();
        let (points, viewdirs) = (single(0, &[n, 3]), single(1, &[case.rays, 3]));
        let fixed = frozen.query_points(&points, None).unwrap().kept();
        for index in 2..5 {
            let query = |at_fixed: bool, with_delta: bool| {
                let delta = Var::from_tensor(&single(index, &[n, 24])).unwrap();
                let views = Var::from_tensor(&viewdirs).unwrap();
                let added = with_delta.then(|| FeatureDelta { layer, delta: delta.as_tensor() });
                let raw = if at_fixed { fixed.forward(&views, added) } else { frozen.forward(&points, &views, added) }
                    .unwrap();
                let loss = (raw.rgb.sqr().unwrap().sum_all().unwrap() + raw.density.sum_all().unwrap()).unwrap();
                let store = loss.backward().unwrap();
                let gradients = [store.get(&delta), store.get(&views)].map(|gradient| gradient.map(flat));
                (flat(&raw.rgb), flat(&raw.density), gradients)
            };
            assert_eq!(query(true, true), query(false, true), "layer {layer}");
            assert_eq!(query(true, false), query(false, false), "without a delta");
        }
    }
}

/// A field that is queried at Gaussians (MipNeRF), across tiles and with the feature delta.
#[test]
fn integrated_encoding() {
    for (samples, layer) in [(1, 0), (5, 2), (400, 4)] {
        let field_config =
            FieldConfig { encoding: Encoding::Integrated, position_octaves: 16, ..FieldConfig::default() };
        let case = Case { field: field_config, samples, layer, ..paper() };
        let exact = ask(&case, &field(&case, Core::Plain, DType::F64), DType::F64, false);
        let fused = ask(&case, &field(&case, Core::Fused, DType::F32), DType::F32, false);
        assert_eq!(fused.inputs[0].dims(), [3 * samples, 6]);
        assert_close("outputs", &fused.outputs, &exact.outputs, 1e-5);
        assert_close("weights", &fused.weights, &exact.weights, 1e-3);
        assert_close("inputs", &fused.inputs, &exact.inputs, 1e-3);
        let frozen = ask(&case, &field(&case, Core::Fused, DType::F32), DType::F32, true);
        assert_eq!(flat(&frozen.inputs[0]), flat(&fused.inputs[0]));
    }
}

#[test]
fn no_points_and_one_point() {
    for case in [paper(), on_a_grid(&paper(), Interpolation::Linear, 2)] {
        let field = field(&case, Core::Fused, DType::F32);
        let empty = |shape: &[usize]| Tensor::zeros(shape, DType::F32, &CPU).unwrap();
        for field in [field.frozen().unwrap(), field.recording().unwrap()] {
            let points = Var::from_tensor(&empty(&[0, 3])).unwrap();
            let raw = field.forward(&points, &empty(&[0, 3]), None).unwrap();
            assert_eq!((raw.rgb.dims(), raw.density.dims()), (&[0, 3][..], &[0][..]));
            let gradients = raw.density.sum_all().unwrap().backward().unwrap();
            assert!(gradients.get(&points).is_none_or(|gradient| gradient.dims() == [0, 3]));
            assert_eq!(field.raw_density(&empty(&[0, 3])).unwrap().dims(), [0]);
        }
        let field = field.frozen().unwrap();
        let one = random(1, 0, &[1, 3]).to_dtype(DType::F32).unwrap();
        let both = field.forward(&one, &one, None).unwrap().density;
        assert_eq!(flat(&both), flat(&field.raw_density(&one).unwrap()), "density alone is the same density");
    }
}

/// Beyond a box that ends raw density is what every activation makes 0 of, whatever the network says, and has no
/// gradient; within it nothing is different. Both cores and both types.
#[test]
fn points_outside_a_box_have_no_density() {
    let case = on_a_grid(&Case { layer: 0, ..paper() }, Interpolation::Linear, 1);
    let places = [[0.3, -0.2, 0.9], [0.3, -1.2, 0.9], [-0.4, 0.1, 0.0], [9.0, 9.0, 9.0], [0.7, 0.7, -1.5]];
    let inside = [0, 2];
    let ask = |field: &Field, chosen: &[usize]| {
        let points = chosen.iter().flat_map(|&i| places[i]).collect::<Vec<f64>>();
        let points = Tensor::from_vec(points, (chosen.len(), 3), &CPU).unwrap().to_dtype(field.dtype()).unwrap();
        let viewdirs = random(1, 0, &[1, 3]).to_dtype(field.dtype()).unwrap();
        let points = Var::from_tensor(&points).unwrap();
        let raw = field.forward(&points, &viewdirs, None).unwrap();
        let alone = field.raw_density(&points.as_detached_tensor()).unwrap();
        let store = raw.density.sum_all().unwrap().backward().unwrap();
        (flat(&raw.density), flat(&alone), flat(&raw.rgb), flat(store.get(&points).unwrap()))
    };
    for (core, dtype) in [(Core::Plain, DType::F64), (Core::Plain, DType::F32), (Core::Fused, DType::F32)] {
        let field = field(&case, core, dtype).frozen().unwrap();
        let (density, alone, rgb, gradient) = ask(&field, &[0, 1, 2, 3, 4]);
        let (of_inside, _, rgb_inside, gradient_inside) = ask(&field, &inside);
        let near = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-4 * a.abs().max(1.0));
        for (i, of_point) in gradient.chunks_exact(3).enumerate() {
            let at = |values: &[f64], i: usize| values[3 * i..][..3].to_vec();
            match inside.iter().position(|&at| at == i) {
                Some(k) => {
                    assert!(near(&[density[i]], &[of_inside[k]]), "{core:?} {dtype:?} {i}");
                    assert!(near(&at(&rgb, i), &at(&rgb_inside, k)), "{core:?} {dtype:?} {i}");
                    assert!(near(of_point, &at(&gradient_inside, k)), "{core:?} {dtype:?} {i}");
                    assert!(of_point.iter().all(|gradient| *gradient != 0.0), "{core:?} {i}: {of_point:?}");
                }
                None => assert_eq!((density[i], of_point), (-1e4, &[0.0; 3][..]), "{core:?} {dtype:?} {i}"),
            }
            assert_eq!(density[i], alone[i]);
        }
    }
}

/// A NaN is not swallowed by a ReLU or a vanishing octave, so that training finds it.
#[test]
fn nan_stays_nan() {
    use Encoding::{Hash, Integrated, Positional};
    // Of two points the second has one: in its position, in the mean of a Gaussian of which no octave is left, in a
    // variance, in its position on a grid.
    for (encoding, position_octaves, at) in
        [(Positional, 10, 4), (Integrated, 16, 7), (Integrated, 16, 10), (Hash, 10, 4)]
    {
        let case = Case { field: FieldConfig { encoding, position_octaves, ..FieldConfig::default() }, ..paper() };
        let case = if encoding == Hash { on_a_grid(&case, Interpolation::Linear, 1) } else { case };
        let numbers = if encoding == Integrated { 6 } else { 3 };
        let mut values = vec![0.1f32; 2 * numbers];
        if at == 7 {
            values[9..].fill(1e3);
        }
        values[at] = f32::NAN;
        let points = Tensor::from_vec(values, (2, numbers), &CPU).unwrap();
        let viewdirs = random(1, 0, &[2, 3]).to_dtype(DType::F32).unwrap();
        let field = field(&case, Core::Fused, DType::F32).frozen().unwrap();
        let raw = field.forward(&points, &viewdirs, None).unwrap();
        let density = flat(&raw.density);
        assert!(density[0].is_finite() && density[1].is_nan(), "{encoding:?} {at}: {density:?}");
        assert!(flat(&raw.rgb)[3..].iter().all(|value| value.is_nan()), "{encoding:?} {at}");
    }
}

fn in_bf16(case: &Case) -> Case {
    Case { field: FieldConfig { precision: Precision::Bf16, ..case.field.clone() }, ..case.clone() }
}

/// Off by so much of the whole, as vectors.
fn off(found: &[Tensor], expected: &[Tensor]) -> Vec<f64> {
    assert_eq!(found.len(), expected.len());
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|value| value * value).sum::<f64>().sqrt();
    let each = found.iter().zip(expected).map(|(found, expected)| {
        let (found, expected) = (flat(found), flat(expected));
        let scale = norm(&mut expected.iter().copied()).max(1e-6);
        norm(&mut found.iter().zip(&expected).map(|(a, b)| a - b)) / scale
    });
    each.collect()
}

/// Rounding to 8 bits moves an output by less than a percent, and gradients by more: where a sum comes to lie beyond the
/// kink of its ReLU, a whole path is gone. What frozen weights, one gradient alone and fixed points change is nothing.
#[test]
fn bf16_is_near_f64() {
    for (width, samples, layer, pulled) in [(64, 1, 0, 1.0), (64, 300, 4, 0.6), (42, 129, 2, 1.0), (256, 200, 8, 1.0)] {
        let field_config = FieldConfig { width, ..FieldConfig::default() };
        let case = Case { field: field_config, samples, layer, pulled, ..paper() };
        let exact = ask(&case, &field(&case, Core::Plain, DType::F64), DType::F64, false);
        let half_case = in_bf16(&case);
        let half_field = field(&half_case, Core::Fused, DType::F32);
        let half = ask(&half_case, &half_field, DType::F32, false);
        let [outputs, weights] = [off(&half.outputs, &exact.outputs), off(&half.weights, &exact.weights)];
        assert!(outputs.iter().all(|off| (1e-6..0.02).contains(off)), "{width}: outputs {outputs:?}");
        let mean = weights.iter().sum::<f64>() / weights.len() as f64;
        assert!((1e-4..0.15).contains(&mean), "{width}: weights {weights:?}");
        let inputs = off(&half.inputs, &exact.inputs);
        assert!(inputs.iter().all(|off| *off < 0.35), "{width}: inputs {inputs:?}");
        assert_frozen_is_the_same(&half_case, &half_field, &half);
    }
}

/// As docs/performance.md has it: bf16 where a field that records or is frozen is queried, f32 in derivatives in space and
/// where candle's graph is to have the weights.
#[test]
fn bf16_is_where_passes_are_and_f32_where_derivatives_in_space_are() {
    for case in [paper(), on_a_grid(&Case { layer: 0, ..paper() }, Interpolation::Smoothstep, 2)] {
        let [half, single] = [in_bf16(&case), case.clone()].map(|case| field(&case, Core::Fused, DType::F32));
        let given = |index: u64, shape: &[usize]| random(case.seed, index, shape).to_dtype(DType::F32).unwrap();
        let n = case.rays * case.samples;
        let (points, viewdirs) = (given(0, &[n, 3]), given(1, &[case.rays, 3]));
        let density = |field: &Field| flat(&field.forward(&points, &viewdirs, None).unwrap().density);
        let frozen = half.frozen().unwrap();
        let rounded = density(&frozen);
        assert_eq!(rounded, density(&half.recording().unwrap()));
        assert_eq!(rounded, flat(&frozen.raw_density(&points).unwrap()), "what places samples and makes meshes");
        assert_ne!(rounded, density(&single.frozen().unwrap()));
        assert_eq!(density(&half), density(&single), "in candle's graph");
        let in_space = |field: &Field| {
            let prepared = field.prepared().unwrap();
            let at = prepared.spatial(&points).unwrap().at;
            [at.density, at.gradient, at.laplacian, field.frozen().unwrap().density_gradient(&points).unwrap()]
        };
        for (half, single) in in_space(&half).iter().zip(&in_space(&single)) {
            assert_eq!(flat(half), flat(single), "in space");
        }
    }
}

/// A delta far smaller than what a layer's output is rounded by has its effect: its product is one of its own.
#[test]
fn bf16_does_not_round_a_small_delta_away() {
    let case = Case { layer: 8, samples: 64, ..paper() };
    let n = case.rays * case.samples;
    let single = |index: u64, shape: &[usize]| random(case.seed, index, shape).to_dtype(DType::F32).unwrap();
    let (points, viewdirs) = (single(0, &[n, 3]), single(1, &[case.rays, 3]));
    let delta = (single(2, &[n, 256]) * 1e-4).unwrap();
    let effect = |field: Field, dtype: DType| {
        let given = |tensor: &Tensor| tensor.to_dtype(dtype).unwrap();
        let fixed = field.query_points(&given(&points), None).unwrap().kept();
        let density = |delta: &Tensor| {
            let at = FeatureDelta { layer: case.layer, delta };
            let found = field.forward(&given(&points), &given(&viewdirs), Some(at)).unwrap().density;
            let at = FeatureDelta { layer: case.layer, delta };
            assert_eq!(flat(&found), flat(&fixed.forward(&given(&viewdirs), Some(at)).unwrap().density));
            found
        };
        let (with, without) = (density(&given(&delta)), density(&given(&delta.zeros_like().unwrap())));
        (with - without).unwrap()
    };
    let exact = effect(field(&case, Core::Plain, DType::F64).frozen().unwrap(), DType::F64);
    let half = effect(field(&in_bf16(&case), Core::Fused, DType::F32).frozen().unwrap(), DType::F32);
    let off = off(&[half], &[exact]);
    assert!(off[0] < 0.01, "{off:?}");
}

#[test]
fn bf16_is_refused_where_it_does_not_apply() {
    let half = in_bf16(&paper()).field;
    let refusal = |config: &FieldConfig, dtype: DType| match Field::init(config, 0, 0, dtype, &CPU) {
        Ok(_) => panic!("{config:?} in {dtype:?}"),
        Err(error) => error.to_string(),
    };
    for refusal in [refusal(&half, DType::F64), refusal(&FieldConfig { core: Core::Plain, ..half.clone() }, DType::F32)]
    {
        assert!(refusal.contains("field.precision") && refusal.contains("fused"), "{refusal}");
    }
    Field::init(&half, 0, 0, DType::F32, &CPU).unwrap();
}
