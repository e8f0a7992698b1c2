//! Whole steps on a device against the host's in f64, which are checked against finite differences.

mod common;

use augnerf_gpu::{Gpu, Steps};
use augnerf_nerf::methods::{DeviceSteps, FieldLearner, Learner, StepAt};
use augnerf_nerf::optimizer::{Adam, AdamSettings};
use augnerf_nerf::runtime::Accelerator;
use augnerf_nerf::settings::DensityActivation;
use augnerf_scenes::{Ndc, Scene};
use candle_core::{DType, Device, Tensor};
use common::{config, flat, gpu, scene, start};

fn norm(values: impl Iterator<Item = f64>) -> f64 {
    values.map(|x| x * x).sum::<f64>().sqrt()
}

fn at(step: u64, learning_rate: f64, log: bool) -> StepAt {
    StepAt { step, updates: step + 1, learning_rate, log }
}

/// How much a step on the device may differ, relatively.
struct Allowed {
    loss: f64,
    gradients: f64,
}

const F32: Allowed = Allowed { loss: 2e-5, gradients: 2e-3 };
/// Operands with 11 bits.
const F16: Allowed = Allowed { loss: 2e-3, gradients: 6e-2 };

/// Compares losses, gradients and diagnostics of one step.
fn compare(settings: &[&str]) {
    compare_within(settings, F32);
}

fn compare_within(settings: &[&str], allowed: Allowed) {
    compare_on(scene(), settings, allowed);
}

fn compare_on(scene: Scene, settings: &[&str], allowed: Allowed) {
    let config = config(settings);
    let learner = start(&config, &scene);
    for (name, var) in learner.fields().variables() {
        // A ReLU that is open at some points.
        if name.ends_with("density.bias") && config.field.density_activation == DensityActivation::Relu {
            var.set(&Tensor::full(0.1f32, var.shape(), &Device::Cpu).unwrap()).unwrap();
        }
    }
    let mut steps = Steps::new(gpu(), &config, &scene, learner.fields(), None).unwrap();
    let mut columns = learner.columns();
    // The device sums both passes' gradients of a table at once.
    columns.further.retain(|column| column != "only_second.entries");
    assert_eq!(steps.columns(), columns);
    let (mut reference, _) = FieldLearner::start(&config, &scene, DType::F64, &Device::Cpu).unwrap();
    for ((_, to), (_, from)) in reference.fields().variables().iter().zip(learner.fields().variables()) {
        to.set(&from.to_dtype(DType::F64).unwrap()).unwrap();
    }
    let expected = reference.step(7, true, &|| Ok(())).unwrap();
    let (report, gradients) = steps.gradients(7).unwrap();
    for (found, expected) in report.terms.iter().zip(&expected.report.terms) {
        assert_eq!((&found.name, found.weight), (&expected.name, expected.weight));
        let difference = (found.value / expected.value - 1.0).abs();
        println!("{:28} {:.7} {difference:.1e}", found.name, expected.value);
        assert!(difference < allowed.loss, "{}: {} against {}", found.name, found.value, expected.value);
    }
    assert_eq!(report.terms.len(), expected.report.terms.len());
    assert!((report.loss / expected.report.loss - 1.0).abs() < allowed.loss);
    assert!((report.extremes.largest_acc - expected.report.extremes.largest_acc).abs() < allowed.loss);
    let total = |gradients: &[Vec<f64>]| norm(gradients.iter().flatten().copied());
    let expected_gradients: Vec<Vec<f64>> = gradients
        .iter()
        .zip(&expected.gradients.0)
        .map(|(found, expected)| expected.as_ref().map_or_else(|| vec![0.0; found.elem_count()], flat))
        .collect();
    let names: Vec<String> = learner.fields().variables().into_iter().map(|(name, _)| name).collect();
    let all = total(&expected_gradients);
    assert!(all > 1e-5);
    for ((name, found), expected) in names.iter().zip(&gradients).zip(&expected_gradients) {
        let difference = norm(flat(found).iter().zip(expected).map(|(a, b)| a - b));
        let own = norm(expected.iter().copied());
        println!("{name:28} {:.1e} of its norm {own:.1e}", difference / own.max(1e-30));
        // A gradient far smaller than the others is a difference of large ones.
        assert!(difference < allowed.gradients * own.max(1e-2 * all), "{name}: {difference:.1e} of {own:.1e}");
    }
    // A step of no length leaves the weights where they are.
    steps.step(at(7, 0.0, true)).unwrap();
    let logged = steps.reports().unwrap().pop().unwrap();
    assert_eq!(logged.sites.len(), expected.report.sites.len());
    let clean: f64 = expected.report.loss;
    for (found, expected) in logged.sites.iter().zip(&expected.report.sites) {
        println!("{found:?}\n{expected:?}");
        assert_eq!(found.site, expected.site);
        let near = |found: f64, expected: f64, scale: f64| {
            assert!((found - expected).abs() < 20.0 * allowed.loss * scale, "{}: {found} {expected}", expected);
        };
        near(found.gain, expected.gain, clean);
        near(found.gain_over_random, expected.gain_over_random, clean);
        near(found.shift, expected.shift, 10.0);
        match (found.share_at_bound, expected.share_at_bound) {
            (Some(found), Some(expected)) => near(found, expected, 50.0),
            (found, expected) => assert_eq!(found, expected),
        }
    }
}

macro_rules! steps {
    ($($name:ident: $($setting:literal),*;)*) => {
        $(
            #[test]
            fn $name() {
                compare(&[$($setting),*]);
            }
        )*
    };
}

steps! {
    nerf: "method=nerf";
    nerf_without_jitter: "method=nerf", "sampling.jitter=false";
    nerf_by_disparity_with_relu: "method=nerf", "sampling.spacing=disparity", "field.density_activation=relu";
    nerf_with_noise_and_padding: "method=nerf", "sampling.density_noise=0.5", "field.rgb_padding=0.01", "field.rgb_limit=1";
    nerf_coarse_only: "method=nerf", "sampling.fine=0";
    nerf_with_distortion: "method=nerf", "regularizer.kind=distortion", "regularizer.weight=0.1";
    nerf_with_distortion_of_the_fine_field: "method=nerf", "regularizer.kind=distortion", "regularizer.weight=0.1",
        "regularizer.fields=fine", "train.coarse_weight=0.3";
    nerf_with_terms_on_rays: "method=nerf", "field.density_activation=relu",
        "regularizer.kind=[\"distortion\",\"occlusion\",\"entropy\",\"cauchy\",\"opacity-prior\"]",
        "regularizer.weight=[0.1,0.2,0.1,0.3,0.1]", "regularizer.occlusion_share=0.4";
    nerf_with_noise_and_terms_on_rays: "method=nerf", "sampling.density_noise=0.5", "regularizer.fields=fine",
        "regularizer.kind=[\"entropy\",\"occlusion\",\"cauchy\"]", "regularizer.weight=[0.1,0.2,0.3]";
    hash_grid_with_terms_on_rays: "method=nerf", "field.encoding=hash", "regularizer.kind=[\"entropy\",\"occlusion\",\"cauchy\",\"opacity-prior\"]",
        "regularizer.weight=[0.1,0.2,0.3,0.1]";
    nerf_with_frequencies_that_open: "method=nerf", "field.frequency_steps=9", "regularizer.kind=occlusion", "regularizer.weight=0.2";
    aug_nerf_with_frequencies_that_open: "method=aug-nerf", "field.frequency_steps=12", "regularizer.kind=tv", "regularizer.weight=0.1", "field.skips=[1,3]", "perturb.field=separate";
    hash_with_levels_that_open: "method=nerf", "field.encoding=hash", "field.frequency_steps=9", "regularizer.kind=tv", "regularizer.weight=0.1";
    nerf_with_samples_that_spread: "method=nerf", "sampling.anneal_steps=10", "sampling.anneal_start=0.1";
    aug_nerf_with_samples_that_spread: "method=aug-nerf", "sampling.anneal_steps=10";
    nerf_coarse_only_with_entropy: "method=nerf", "sampling.fine=0", "regularizer.kind=entropy", "regularizer.weight=0.1";
    nerf_deep_with_two_skips: "method=nerf", "field.depth=6", "field.skips=[2,4]", "field.view_depth=3", "field.width=40";
    nerf_wide: "method=nerf", "field.width=136";
    nerf_whose_gradients_have_few_parts: "method=nerf", "field.width=1024", "field.depth=2", "field.skips=[]";
    hash: "method=nerf", "field.encoding=hash";
    hash_smoothstep_in_a_ball: "method=nerf", "field.encoding=hash", "field.hash.interpolation=smoothstep",
        "field.hash.contraction=ball", "field.hash.bounds=[[-0.5,-0.4,1.0],[0.5,0.6,2.0]]", "field.hash.features=4";
    hash_in_axes: "method=nerf", "field.encoding=hash", "field.hash.contraction=axes",
        "field.hash.bounds=[[-0.5,-0.4,1.0],[0.5,0.6,2.0]]", "field.density_activation=exp";
    hash_in_a_small_box: "method=nerf", "field.encoding=hash", "field.hash.contraction=none", "field.hash.features=3",
        "field.hash.bounds=[[-0.2,-0.2,0.0],[0.2,0.2,1.5]]", "regularizer.kind=distortion", "regularizer.weight=0.1";
    nerf_with_l1: "method=nerf", "regularizer.kind=l1", "regularizer.weight=0.3", "regularizer.points_per_step=130";
    nerf_with_tv_and_l1: "method=nerf", "regularizer.kind=[\"tv\",\"l1\"]", "regularizer.weight=[0.1,0.2]",
        "regularizer.points_per_step=1000", "field.depth=6", "field.skips=[2,4]";
    nerf_with_tv_of_the_fine_field: "method=nerf", "regularizer.kind=tv", "regularizer.weight=0.1",
        "regularizer.fields=fine", "regularizer.points=full", "regularizer.lattice=10";
    nerf_with_tv_of_exp: "method=nerf", "regularizer.kind=[\"distortion\",\"tv\"]", "regularizer.weight=[0.1,0.1]",
        "field.density_activation=exp", "regularizer.jitter=false", "sampling.fine=0";
    nerf_wide_with_tv: "method=nerf", "field.width=136", "regularizer.kind=tv", "regularizer.weight=0.1",
        "regularizer.points_per_step=300";
    hash_with_tv_of_its_one_field: "method=nerf", "field.encoding=hash", "regularizer.kind=tv", "regularizer.weight=0.1",
        "regularizer.fields=fine", "regularizer.points_per_step=300";
    hash_with_tv: "method=nerf", "field.encoding=hash", "regularizer.kind=[\"tv\",\"l1\"]", "regularizer.weight=[0.1,0.1]",
        "regularizer.points_per_step=500", "field.hash.features=3", "field.density_activation=relu";
    hash_with_l1_in_a_small_box: "method=nerf", "field.encoding=hash", "regularizer.kind=l1", "regularizer.weight=0.1",
        "field.hash.contraction=none", "field.hash.bounds=[[-0.5,-0.4,-0.3],[0.5,0.6,0.7]]";
    hash_with_tv_in_a_ball: "method=nerf", "field.encoding=hash", "field.hash.interpolation=smoothstep",
        "field.hash.contraction=ball", "field.hash.bounds=[[-0.5,-0.4,-0.3],[0.5,0.6,0.7]]", "regularizer.kind=tv",
        "regularizer.weight=0.1";
    hash_with_tv_in_axes: "method=nerf", "field.encoding=hash", "field.hash.contraction=axes",
        "field.hash.bounds=[[-0.5,-0.4,-0.3],[0.5,0.6,0.7]]", "regularizer.kind=tv", "regularizer.weight=0.1";
    hash_with_tv_in_a_small_box: "method=nerf", "field.encoding=hash", "regularizer.kind=tv", "regularizer.weight=0.1",
        "field.hash.contraction=none", "field.hash.bounds=[[-0.5,-0.4,-0.3],[0.5,0.6,0.7]]";
    nerf_with_weights_of_terms_that_move: "method=nerf", "regularizer.kind=[\"tv\",\"entropy\"]", "regularizer.weight=[0.2,0.1]",
        "regularizer.schedule=[\"halved every 3 steps\",\"from 2 in 20 steps\"]";
    aug_with_a_lambda_that_moves: "method=aug-nerf", "perturb.attack=calibrated", "perturb.lambda_schedule=from 0 in 20 steps";
    nerf_with_laplacian: "method=nerf", "field.density_activation=relu", "regularizer.kind=laplacian", "regularizer.weight=0.001",
        "regularizer.points_per_step=500", "field.depth=6", "field.skips=[2,4]";
    nerf_with_laplacian_and_tv_of_softplus: "method=nerf", "regularizer.kind=[\"tv\",\"laplacian\",\"l1\"]",
        "regularizer.weight=[0.1,0.001,0.2]", "regularizer.fields=fine";
    nerf_with_laplacian_and_frequencies_that_open: "method=nerf", "field.frequency_steps=9", "regularizer.kind=laplacian",
        "regularizer.weight=0.001";
    nerf_with_a_term_that_begins_at_0: "method=nerf", "regularizer.kind=[\"entropy\",\"occlusion\"]", "regularizer.weight=[0.1,0]",
        "regularizer.schedule=[\"constant\",\"from 2 in 5 steps\"]";
    hash_with_laplacian: "method=nerf", "field.encoding=hash", "field.hash.interpolation=smoothstep", "regularizer.kind=laplacian",
        "regularizer.weight=0.001", "field.density_activation=exp";
    hash_with_laplacian_in_a_ball: "method=nerf", "field.encoding=hash", "field.hash.interpolation=smoothstep",
        "field.hash.contraction=ball", "field.hash.bounds=[[-0.5,-0.4,-0.3],[0.5,0.6,0.7]]", "regularizer.kind=laplacian",
        "regularizer.weight=0.001";
    mip_nerf: "method=mip-nerf";
    mip_nerf_with_noise_and_terms: "method=mip-nerf", "sampling.density_noise=0.5", "regularizer.kind=[\"distortion\",\"entropy\"]",
        "regularizer.weight=[0.1,0.1]";
    aug_mip_nerf: "method=aug-mip-nerf", "perturb.attack=calibrated";
    aug_mip_nerf_paper: "method=aug-mip-nerf", "perturb.attack=paper", "perturb.geometry=paper";
    aug_with_relu: "method=aug-nerf", "perturb.attack=calibrated", "field.density_activation=relu";
    aug_with_tv: "method=aug-nerf", "perturb.attack=calibrated", "regularizer.kind=tv", "regularizer.weight=0.1";
    aug: "method=aug-nerf", "perturb.attack=calibrated";
    aug_paper: "method=aug-nerf", "perturb.attack=paper";
    aug_paper_geometry: "method=aug-nerf", "perturb.attack=calibrated", "perturb.geometry=paper";
    aug_hash: "method=aug-nerf", "perturb.attack=calibrated", "field.encoding=hash";
    aug_hash_in_a_ball: "method=aug-nerf", "perturb.attack=calibrated", "field.encoding=hash",
        "field.hash.interpolation=smoothstep", "field.hash.contraction=ball",
        "field.hash.bounds=[[-0.5,-0.4,1.0],[0.5,0.6,2.0]]", "perturb.geometry=paper";
    aug_gaussian: "method=aug-nerf", "perturb.attack=calibrated", "perturb.kind=gaussian";
    aug_uniform: "method=aug-nerf", "perturb.attack=calibrated", "perturb.kind=uniform", "train.rays=56";
    fresh_jitter: "method=aug-nerf", "perturb.kind=fresh-jitter", "sampling.density_noise=0.5", "train.rays=56";
    aug_separate_field: "method=aug-nerf", "perturb.attack=calibrated", "perturb.field=separate", "perturb.objective=released",
        "perturb.resample=perturbed";
    aug_before: "method=aug-nerf", "perturb.attack=calibrated", "perturb.output=before", "sampling.density_noise=0.5";
    aug_balls: "method=aug-nerf", "perturb.attack=calibrated", "perturb.feature.norm=l2", "perturb.rgb.norm=l2",
        "perturb.view.norm=l2", "perturb.xyz.norm=l2", "perturb.t.passes=off", "train.rays=56";
    aug_boxes: "method=aug-nerf", "perturb.attack=calibrated", "perturb.xyz.norm=linf", "perturb.rgb.steps=3",
        "perturb.density.steps=2", "perturb.perturb_last=true", "perturb.injection_layer=4";
    aug_reach: "method=aug-nerf", "perturb.attack=paper", "perturb.t.epsilon=reach", "perturb.xyz.epsilon=reach",
        "perturb.xyz_radius=released";
    aug_of_features_alone: "method=aug-nerf", "perturb.attack=calibrated", "perturb.levels=[\"feature\"]", "perturb.injection_layer=1";
    aug_of_output_alone: "method=aug-nerf", "perturb.attack=calibrated", "perturb.levels=[\"output\"]", "field.encoding=hash";
}

/// Rays in NDC, where pixels have cylinders.
#[test]
fn mip_nerf_in_ndc() {
    let ndc = Some(Ndc { width: 16.0, height: 16.0, focal: 20.0 });
    for settings in [&["method=mip-nerf"][..], &["method=aug-mip-nerf", "perturb.attack=calibrated"]] {
        compare_on(Scene { ndc, near: 0.0, far: 1.0, ..scene() }, settings, F32);
    }
}

/// A device with little memory takes the rays in parts, with the same random numbers.
#[test]
fn rays_in_parts_have_the_numbers_of_all_at_once() {
    for settings in [
        &["method=aug-nerf", "perturb.attack=calibrated", "train.rays=56", "sampling.density_noise=0.5"][..],
        &["method=aug-nerf", "perturb.kind=fresh-jitter", "field.encoding=hash", "sampling.density_noise=0.5"],
        &["method=aug-nerf", "perturb.kind=gaussian", "perturb.rgb.norm=l2", "perturb.resample=perturbed"],
        &["method=nerf", "field.encoding=hash", "regularizer.kind=tv", "regularizer.points_per_step=190"],
    ] {
        let (config, scene) = (config(settings), scene());
        let (learner, _) = FieldLearner::start(&config, &scene, DType::F32, &Device::Cpu).unwrap();
        let step = |budget: usize| {
            let gpu = gpu().with_budget(budget);
            let mut steps = Steps::new(&gpu, &config, &scene, learner.fields(), None).unwrap();
            let (report, gradients) = steps.gradients(3).unwrap();
            (steps.dispatches(), report.loss, gradients.iter().flat_map(flat).collect::<Vec<f64>>())
        };
        let ((few, loss, all), (many, same, parts)) = (step(1 << 28), step(900_000));
        assert!(2 * many > 3 * few, "{many} dispatches in parts, {few} at once");
        assert!((same / loss - 1.0).abs() < 1e-6);
        let difference = norm(all.iter().zip(&parts).map(|(a, b)| a - b));
        assert!(difference < 1e-4 * norm(all.iter().copied()), "{settings:?}: {difference:.1e}");
    }
    // The gradient of a wide layer's weights has parts as large as the weights.
    for (settings, budget, chunk) in
        [(&["method=nerf"][..], 1000, 16), (&["method=nerf", "field.width=512", "train.chunk=32"][..], 1 << 24, 32)]
    {
        let (config, scene) = (config(settings), scene());
        let (learner, _) = FieldLearner::start(&config, &scene, DType::F32, &Device::Cpu).unwrap();
        let refused = Steps::new(&gpu().with_budget(budget), &config, &scene, learner.fields(), None);
        let error = refused.err().unwrap().to_string();
        assert!(error.contains(&format!("lower train.chunk ({chunk}) or field.width")), "{error}");
    }
}

/// With memory for fewer and fewer rays a step has the same loss, until the error says what to do.
#[test]
fn with_less_memory_it_takes_parts_or_says_what_is_needed() {
    let (config, scene) = (config(&["method=aug-nerf", "perturb.attack=calibrated", "field.encoding=hash"]), scene());
    let learner = start(&config, &scene);
    let losses = (14..24).rev().map(|power| {
        let gpu = gpu().with_budget(1 << power);
        let steps = Steps::new(&gpu, &config, &scene, learner.fields(), None);
        steps
            .map(|mut steps| (steps.dispatches(), steps.gradients(3).unwrap().0.loss))
            .map_err(|error| error.to_string())
    });
    let losses: Vec<Result<(usize, f64), String>> = losses.collect();
    let fits = losses.iter().take_while(|found| found.is_ok()).count();
    assert!((2..10).contains(&fits), "{losses:?}");
    let at = |i: usize| losses[i].clone().unwrap();
    assert!((1..fits).all(|i| (at(i).1 / at(0).1 - 1.0).abs() < 1e-6 && at(i).0 >= at(i - 1).0), "{losses:?}");
    assert!(at(fits - 1).0 > at(0).0, "{losses:?}");
    for refused in &losses[fits..] {
        let error = refused.clone().unwrap_err();
        assert!(
            error.contains("lower train.chunk (16) or field.width") && error.contains("AUGNERF_GPU_MEMORY"),
            "{error}"
        );
    }
    // A table that no buffer holds.
    let tables = [
        "method=nerf",
        "field.encoding=hash",
        "field.hash.levels=16",
        "field.hash.log2_table=20",
        "field.hash.finest=2048",
    ];
    if gpu().adapter().largest_buffer.unwrap() < 1 << 28 {
        let config = common::config(&tables);
        let (learner, _) = FieldLearner::start(&config, &scene, DType::F32, &Device::Cpu).unwrap();
        let error = Steps::new(gpu(), &config, &scene, learner.fields(), None).err().unwrap().to_string();
        assert!(error.contains("lower field.hash.log2_table (20)"), "{error}");
    }
}

/// By matrix units where a device has them, and otherwise in f32.
#[test]
fn steps_in_f16() {
    for settings in [
        &["method=nerf", "field.width=64"][..],
        &["method=nerf", "field.width=160", "field.skips=[1,3]", "field.view_depth=2"],
        &["method=nerf", "field.width=64", "field.encoding=hash"],
        &["method=nerf", "field.width=160", "field.encoding=hash", "regularizer.kind=tv", "regularizer.weight=0.1"],
        &["method=nerf", "field.width=64", "regularizer.kind=laplacian", "regularizer.weight=0.01"],
        &["method=nerf", "field.width=64", "field.frequency_steps=9"],
        &["method=aug-nerf", "field.width=64"],
    ] {
        compare_within(&[settings, &["field.precision=f16"]].concat(), F16);
    }
}

/// Two runs have the same bytes, and a device that goes on from fetched numbers has those of one that did not stop.
#[test]
fn the_same_bytes_twice_and_after_a_fetch() {
    let opening = ["field.frequency_steps=3", "sampling.anneal_steps=3", "method=nerf"];
    for settings in [&["method=aug-nerf", "field.encoding=hash"][..], &["method=nerf"], &opening] {
        let (config, scene) = (config(settings), scene());
        let (learner, _) = FieldLearner::start(&config, &scene, DType::F32, &Device::Cpu).unwrap();
        let start: Vec<Tensor> =
            learner.fields().variables().iter().map(|(_, var)| var.as_tensor().copy().unwrap()).collect();
        let run = |stops: bool| {
            for ((_, var), value) in learner.fields().variables().iter().zip(&start) {
                var.set(value).unwrap();
            }
            let mut steps = Steps::new(gpu(), &config, &scene, learner.fields(), None).unwrap();
            let mut losses = Vec::new();
            for step in 0..4 {
                if stops && step == 2 {
                    let moments = steps.fetch().unwrap();
                    steps = Steps::new(gpu(), &config, &scene, learner.fields(), Some(&moments)).unwrap();
                }
                steps.step(at(step, 0.01, step == 1)).unwrap();
                // Reports may be asked for after each step, or after several.
                if stops || step == 3 {
                    losses.extend(steps.reports().unwrap().into_iter().map(|report| report.loss));
                }
            }
            let moments = steps.fetch().unwrap();
            let values = learner.fields().variables().into_iter().map(|(_, var)| var.as_tensor().copy().unwrap());
            let all = values
                .chain(moments.into_iter().flat_map(|moments| [moments.first, moments.second]))
                .map(|tensor| flat(&tensor));
            assert_eq!(losses.len(), 4);
            all.chain([losses]).collect::<Vec<Vec<f64>>>()
        };
        let once = run(false);
        assert_eq!(once, run(false));
        assert_eq!(once, run(true));
        let moved = norm(once[0].iter().zip(flat(&start[0])).map(|(a, b)| a - b));
        assert!(moved > 1e-3, "parameters move");
    }
}

/// Limits of gradients, decay of weights and weights of losses that move, over some steps.
#[test]
fn updates_are_the_hosts() {
    let moving = [
        "method=nerf",
        "field.encoding=hash",
        "train.clip_value=0.002",
        "train.clip_norm=0.01",
        "train.weight_decay=2",
    ];
    let settings =
        [&moving[..], &["regularizer.kind=l1", "regularizer.weight=0.1", "regularizer.schedule=halved every 1 steps"]]
            .concat();
    let (config, scene) = (config(&settings), scene());
    let learner = start(&config, &scene);
    let mut steps = Steps::new(gpu(), &config, &scene, learner.fields(), None).unwrap();
    let (mut reference, _) = FieldLearner::start(&config, &scene, DType::F64, &Device::Cpu).unwrap();
    let variables = reference.fields().variables();
    for ((_, to), (_, from)) in variables.iter().zip(learner.fields().variables()) {
        to.set(&from.to_dtype(DType::F64).unwrap()).unwrap();
    }
    let before: Vec<Vec<f64>> = variables.iter().map(|(_, var)| flat(var.as_tensor())).collect();
    let mut adam = Adam::new(AdamSettings::of(&config.train), variables.clone()).unwrap();
    let (mut limited, rate) = (0, 1e-3);
    for step in 0..3 {
        let gradients = reference.step(step, false, &|| Ok(())).unwrap().gradients.0;
        let clamped = gradients.into_iter().map(|part| part.map(|part| part.clamp(-0.002, 0.002).unwrap()));
        let clamped: Vec<Option<Tensor>> = clamped.collect();
        let found = norm(clamped.iter().flatten().flat_map(flat));
        limited += usize::from(found > 0.01);
        let factor = (0.01 / found).min(1.0);
        let clipped: Vec<_> = clamped.into_iter().map(|part| part.map(|part| (part * factor).unwrap())).collect();
        adam.update(&clipped, rate, step + 1).unwrap();
        steps.step(at(step, rate, false)).unwrap();
    }
    assert_eq!(limited, 3, "the norm is limited");
    let weights: Vec<f64> = steps.reports().unwrap().iter().map(|report| report.terms.last().unwrap().weight).collect();
    assert_eq!(weights, [0.1, 0.05, 0.025]);
    steps.fetch().unwrap();
    for (((name, expected), (_, found)), before) in variables.iter().zip(learner.fields().variables()).zip(before) {
        let (expected, found) = (flat(expected.as_tensor()), flat(found.as_tensor()));
        let moved = norm(expected.iter().zip(&before).map(|(a, b)| a - b));
        let off = norm(expected.iter().zip(&found).map(|(a, b)| a - b));
        println!("{name:28} moved by {moved:.1e}, off by {off:.1e}");
        assert!(off < 1e-4 * moved, "{name}: {off:.1e} of {moved:.1e}");
    }
}

/// Drivers may take comparisons with what is not a number as they like: the loss or a parameter tells.
#[test]
fn what_is_not_finite_is_reported() {
    let (config, scene) = (config(&["method=nerf"]), scene());
    let (learner, _) = FieldLearner::start(&config, &scene, DType::F32, &Device::Cpu).unwrap();
    let variables = learner.fields().variables();
    let (_, var) = variables.iter().find(|(name, _)| name == "fine.trunk.0.bias").unwrap();
    var.set(&(var.as_tensor() * f64::NAN).unwrap()).unwrap();
    let mut steps = Steps::new(gpu(), &config, &scene, learner.fields(), None).unwrap();
    let values = || -> Vec<Vec<f64>> {
        learner.fields().variables().into_iter().map(|(_, var)| flat(var.as_tensor())).collect()
    };
    let before = values();
    // The first of several that nobody waited for.
    (4..7).for_each(|step| steps.step(at(step, 0.01, false)).unwrap());
    let error = steps.reports().unwrap_err().to_string();
    assert!(
        error.contains("diverged at step 5: the ") && error.contains(" fine") && error.contains("not a number"),
        "{error}"
    );
    // The steps are lost, and the parameters are those before them.
    steps.fetch().unwrap();
    for (after, before) in values().iter().flatten().zip(before.iter().flatten()) {
        assert!(after == before || after.is_nan() && before.is_nan());
    }
}

/// A device keeps the reports of some steps, and makes place for more by itself.
#[test]
fn the_first_of_many_waiting_steps_that_is_not_finite_is_named() {
    let (config, scene) = (config(&["method=nerf"]), scene());
    let (learner, _) = FieldLearner::start(&config, &scene, DType::F32, &Device::Cpu).unwrap();
    let mut steps = Steps::new(gpu(), &config, &scene, learner.fields(), None).unwrap();
    (0..20).for_each(|step| steps.step(at(step, 0.001, false)).unwrap());
    let reports = steps.reports().unwrap();
    assert_eq!(reports.len(), 20);
    assert!(reports[19].loss < reports[0].loss, "{} {}", reports[0].loss, reports[19].loss);
    // A rate that leaves no finite loss: step 24 moves, and step 25 says so. Some drivers' minimum and maximum hide what is not a number
    // from the loss, but not from gradients.
    (20..28).for_each(|step| steps.step(at(step, if step == 23 { 1e30 } else { 0.001 }, false)).unwrap());
    let error = steps.reports().unwrap_err().to_string();
    let names = |what: &str| error.contains(&format!("diverged at step 25: the {what}"));
    assert!(names("loss") || names("gradient of coarse"), "{error}");
}

#[test]
fn what_is_not_there_is_refused_by_name() {
    for (settings, named) in [
        (["method=srn", "field.width=16"], "method srn"),
        (["method=nerf", "regularizer.kind=orientation"], "regularizer orientation"),
        (["method=nerf", "train.sam_radius=0.1"], "train.sam_radius"),
        (["method=nerf", "field.precision=bf16"], "bf16"),
        (["method=nerf", "field.width=30"], "width 30"),
        (["method=nerf", "sampling.fine=4000"], "4012 samples"),
    ] {
        let error = augnerf_gpu::check(&config(&settings)).unwrap_err().to_string();
        assert!(error.contains(named) && error.contains("--device cpu"), "{error}");
    }
}

/// Wherever a device is lost, an error says so, and nothing panics.
#[test]
fn a_lost_device_is_an_error_that_names_resume() {
    let (config, scene) = (config(&["method=aug-nerf", "perturb.attack=calibrated"]), scene());
    for at_place in 0..10u64 {
        let gpu = Gpu::open(0).unwrap();
        let learner = start(&config, &scene);
        let work = || -> augnerf_base::Result<()> {
            let lose = |place: u64| (place == at_place).then(|| gpu.destroy());
            lose(0);
            let mut steps = Steps::new(&gpu, &config, &scene, learner.fields(), None)?;
            lose(1);
            for step in 0..3 {
                steps.step(at(step, 1e-3, step == 1))?;
                lose(2 + step);
            }
            steps.reports()?;
            lose(5);
            steps.step(at(3, 1e-3, true))?;
            lose(6);
            steps.fetch()?;
            lose(7);
            steps.gradients(4)?;
            lose(8);
            steps.fetch()?;
            lose(9);
            gpu.synchronize()
        };
        let error = work().expect_err("the device is gone").to_string();
        assert!(error.contains("was lost") && error.contains("`augnerf resume` continues"), "{at_place}: {error}");
    }
}
