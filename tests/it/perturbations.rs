//! What the perturbed pass and the search promise.

use crate::common::pass::{Setting, geometry};
use crate::common::{flat, parameters, put_on_grid, tiny_config, tiny_scene, trained};
use augnerf::base::rng::{Random, Stream};
use augnerf::field::Field;
use augnerf::perturb::{
    AttackGeometry, Deltas, Distribution, Norm, PaperSite, PassGeometry, Passes, PixelScale, Sets, SiteSet,
};
use augnerf::render::{clean_pass, perturbed_pass};
use augnerf::runtime::Runtime;
use augnerf::settings::{Method, OutputPlace, PerturbConfig, PerturbField, SecondPass, Sizes};
use augnerf::train::Trainer;
use candle_core::{DType, Device, Tensor, Var};
use proptest::prelude::*;

const CPU: Device = Device::Cpu;

/// A pass of a small f64 field.
fn setting(method: Method, seed: u64, size: (usize, usize), change: impl FnOnce(&mut PerturbConfig)) -> Setting {
    Setting::new(method, seed, size, DType::F64, |config| {
        // Large enough that f64 differences see them.
        config[PaperSite::Feature].epsilon = Some(0.05.into());
        config[PaperSite::Rgb].epsilon = Some(0.03.into());
        config[PaperSite::Density].epsilon = Some(0.1.into());
        change(config);
    })
}

/// `tensor` with entry `index` moved by `by`.
fn nudged(tensor: &Tensor, index: usize, by: f64) -> Tensor {
    let mut values = tensor.flatten_all().unwrap().to_vec1::<f64>().unwrap();
    values[index] += by;
    Tensor::from_vec(values, tensor.shape(), &CPU).unwrap()
}

/// Compares gradients with central differences; entries at a kink (ReLU, projection) disagree and
/// may be a tenth of all.
fn compare(what: &str, pairs: Vec<(f64, f64)>) {
    let scale = pairs.iter().fold(1e-12f64, |m, (g, _)| m.max(g.abs()));
    let off = pairs.iter().filter(|(g, d)| (g - d).abs() > 1e-5 * scale).count();
    assert!(pairs.iter().any(|(g, _)| *g != 0.0), "{what}: all gradients are 0");
    assert!(off * 10 <= pairs.len(), "{what}: {off} of {} disagree: {pairs:?}", pairs.len());
}

const H: f64 = 1e-6;

#[test]
fn loss_gradients_in_every_delta_equal_finite_differences() {
    let cases = [Method::AugNerf, Method::AugMipNerf]
        .into_iter()
        .flat_map(|method| [OutputPlace::After, OutputPlace::Before].map(|output| (method, output)));
    for (method, output) in cases {
        let setting = setting(method, 1, (4, 6), |config| config.output = output);
        // Half-size deltas: away from the bounds of their sets.
        let mut deltas = setting.draw(0);
        for site in PaperSite::ALL {
            let half = (deltas.get(site).unwrap() * 0.5).unwrap();
            deltas.insert(site, half);
        }
        let mut tracked = deltas.clone();
        let variables = PaperSite::ALL.map(|site| Var::from_tensor(deltas.get(site).unwrap()).unwrap());
        for site in PaperSite::ALL {
            tracked.insert(site, variables[site as usize].as_tensor().clone());
        }
        let gradients = setting.loss(&tracked).0.backward().unwrap();
        for site in PaperSite::ALL {
            let gradient = gradients.get(&variables[site as usize]).unwrap();
            let gradient = gradient.flatten_all().unwrap().to_vec1::<f64>().unwrap();
            // A projected colour or density passes its gradient on although its value is fixed;
            // a point's last density has no perturbation at all.
            let used = setting.loss(&deltas).1.get(site).unwrap().flatten_all().unwrap().to_vec1::<f64>().unwrap();
            let given = deltas.get(site).unwrap().flatten_all().unwrap().to_vec1::<f64>().unwrap();
            let samples = 6;
            let free = |i: &usize| {
                used[*i] == given[*i]
                    && (site != PaperSite::Density || method.encoding().at_intervals() || i % samples != samples - 1)
            };
            let difference = |i: usize| {
                let at = |by: f64| {
                    let mut moved = deltas.clone();
                    moved.insert(site, nudged(deltas.get(site).unwrap(), i, by));
                    setting.loss_value(&moved)
                };
                (at(H) - at(-H)) / (2.0 * H)
            };
            let step = (gradient.len() / 24).max(1);
            let pairs = (0..gradient.len()).step_by(step).filter(free).map(|i| (gradient[i], difference(i)));
            compare(&format!("{method:?} {output:?} {}", site.name()), pairs.collect());
        }
    }
}

#[test]
fn loss_gradients_in_weights_equal_finite_differences() {
    for method in [Method::AugNerf, Method::AugMipNerf] {
        let setting = setting(method, 1, (4, 6), |_| {});
        let deltas = setting.search(setting.draw(0));
        let gradients = setting.loss(&deltas).0.backward().unwrap();
        for (name, var) in setting.field.variables() {
            let gradient = gradients.get(var).unwrap().flatten_all().unwrap().to_vec1::<f64>().unwrap();
            let original = var.as_tensor().copy().unwrap();
            let at = |i: usize, by: f64| {
                var.set(&nudged(&original, i, by)).unwrap();
                let loss = setting.loss_value(&deltas);
                var.set(&original).unwrap();
                loss
            };
            let step = (gradient.len() / 12).max(1);
            let pairs = (0..gradient.len()).step_by(step).map(|i| (gradient[i], (at(i, H) - at(i, -H)) / (2.0 * H)));
            let pairs: Vec<(f64, f64)> = pairs.collect();
            if pairs.iter().any(|(g, d)| *g != 0.0 || *d != 0.0) {
                compare(name, pairs);
            }
        }
    }
}

#[test]
fn epsilon_zero_is_the_clean_pass_exactly() {
    for method in [Method::AugNerf, Method::AugMipNerf] {
        let setting = setting(method, 2, (5, 7), |config| {
            for site in PaperSite::ALL {
                config[site].epsilon = Some(0.0.into());
            }
        });
        let deltas = setting.search(setting.draw(0));
        let perturbed = perturbed_pass(&setting.field, setting.pass(), setting.perturbation(&deltas)).unwrap();
        let clean = clean_pass(&setting.field, setting.pass()).unwrap();
        let rows = |tensor: &Tensor| tensor.to_vec2::<f64>().unwrap();
        assert_eq!(rows(&perturbed.composite.rgb), rows(&clean.composite.rgb));
        assert_eq!(rows(&perturbed.composite.weights), rows(&clean.composite.weights));
    }
}

/// Every delta within its set, colours in 0..=1, densities not negative, samples sorted.
fn assert_legal(setting: &Setting, deltas: &Deltas) -> Result<(), TestCaseError> {
    let out = perturbed_pass(&setting.field, setting.pass(), setting.perturbation(deltas)).unwrap();
    for SiteSet { site, set } in setting.sets.iter() {
        let delta = out.used.deltas.get(site.name()).unwrap();
        let size = match set.norm {
            Norm::Linf => delta.abs().unwrap(),
            Norm::L2 => delta.sqr().unwrap().sum_keepdim(delta.rank() - 1).unwrap().sqrt().unwrap(),
        };
        let radius = set.radius.broadcast_as(size.shape()).unwrap();
        let excess = (size - radius).unwrap().flatten_all().unwrap().max(0).unwrap().to_scalar::<f64>().unwrap();
        // A ball's projection divides by a rounded norm.
        let rounding = 1e-15 * (1.0 + set.radius.max_all().unwrap().to_scalar::<f64>().unwrap());
        prop_assert!(excess <= rounding, "{} exceeds its radius by {excess:e}", site.name());
    }
    let padding = setting.field.config().rgb_padding;
    prop_assert!(flat(&out.rgb).iter().all(|c| (-padding..=1.0 + padding).contains(c)));
    prop_assert!(flat(&out.density).iter().all(|d| *d >= 0.0));
    let t_vals =
        (&setting.samples.t_vals + out.used.deltas.get(PaperSite::T).unwrap()).unwrap().to_vec2::<f64>().unwrap();
    for ray in t_vals {
        prop_assert!(ray.windows(2).all(|pair| pair[0] <= pair[1]), "{ray:?}");
        prop_assert!(ray.iter().all(|t| (2.0..=6.0).contains(t)), "{ray:?}");
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn deltas_never_leave_their_sets_and_samples_stay_sorted(
        seed in 0u64..1000,
        epsilon_t in 0.0f64..=0.5,
        epsilon in 1e-6f64..10.0,
        step_size in 1e-6f64..10.0,
        steps in 0usize..4,
        l2 in any::<bool>(),
        mip in any::<bool>(),
    ) {
        let method = if mip { Method::AugMipNerf } else { Method::AugNerf };
        let setting = setting(method, seed, (3, 5), |config| {
            for site in PaperSite::ALL {
                let delta = &mut config[site];
                (delta.epsilon, delta.step_size, delta.steps) = (Some(epsilon.into()), Some(step_size), Some(steps));
                if !matches!(site, PaperSite::T | PaperSite::Density) {
                    delta.norm = Some(if l2 { Norm::L2 } else { Norm::Linf });
                }
            }
            config[PaperSite::T].epsilon = Some(epsilon_t.max(1e-9).into());
        });
        let start = setting.draw(seed);
        assert_legal(&setting, &start)?;
        assert_legal(&setting, &setting.search(start))?;
        let gaussian = setting.sets.draw(Distribution::Gaussian, 0, |part| Random::part(seed, Stream::Search, 1, part)).unwrap();
        assert_legal(&setting, &gaussian)?;
    }

    /// In f32, where roundings are largest, with gaps over many orders of magnitude.
    #[test]
    fn samples_stay_sorted_in_single_precision(mut t in prop::collection::vec(0.0f32..1.0, 3..12), power in 1i32..6) {
        for value in &mut t {
            *value = value.powi(power);
        }
        t.sort_by(f32::total_cmp);
        let samples = t.len();
        let t_vals = Tensor::from_vec(t, (1, samples), &CPU).unwrap();
        let norm = Tensor::ones((1, 1), DType::F32, &CPU).unwrap();
        let mut config = PerturbConfig::default();
        config[PaperSite::T].epsilon = Some(0.5.into());
        let sites = config.fill(1.0, 1, 16);
        let pixel = PixelScale { width: 16.0, height: 16.0, focal: 20.0, ndc: true };
        let pass = geometry(&t_vals, &norm);
        let pass = PassGeometry { run: AttackGeometry { pixel, ..pass.run }, ..pass };
        let sets = Sets::new(config.sites_of_pass(&sites, true), &pass).unwrap();
        let set = sets.get(PaperSite::T).unwrap();
        for signs in 0..(1usize << samples.min(6)) {
            let far: Vec<f32> = (0..samples).map(|i| if signs >> (i % 6) & 1 == 1 { 9.0 } else { -9.0 }).collect();
            let delta = set.project(&Tensor::from_vec(far, (1, samples), &CPU).unwrap()).unwrap();
            let moved = (&t_vals + delta).unwrap().to_vec2::<f32>().unwrap().remove(0);
            prop_assert!(moved.windows(2).all(|pair| pair[0] <= pair[1]), "{moved:?}");
            prop_assert!(moved.iter().all(|t| (0.0..=1.0).contains(t)), "{moved:?}");
        }
    }
}

#[test]
fn the_search_raises_the_loss_and_beats_random_deltas_on_a_trained_field() {
    let config = tiny_config(Method::Nerf, |_| {});
    let trainer = trained(&config, 300);
    let field = trainer.model().unwrap().fields().unwrap().coarse();
    let weights: Vec<Tensor> =
        field.variables().iter().map(|(_, var)| var.as_tensor().to_dtype(DType::F64).unwrap()).collect();
    // Each level by itself, then all together, in the calibrated sizes.
    for only in PaperSite::ALL.map(Some).into_iter().chain([None]) {
        let (mut clean, mut random, mut worst) = (0.0, 0.0, 0.0);
        for batch in 0..8 {
            let mut setting = setting(Method::AugNerf, batch, (32, 8), |config| {
                *config = PerturbConfig { sizes: Sizes::Calibrated, injection_layer: 2, ..PerturbConfig::default() };
                for site in PaperSite::ALL {
                    let alone = only.is_none_or(|only| only == site);
                    config[site].passes = if alone { Passes::Both } else { Passes::Off };
                }
            });
            setting.field = Field::from_parameters(&config.field, weights.clone()).unwrap();
            setting.noise = None;
            clean += setting.loss_value(&Deltas::default());
            random += setting.loss_value(&setting.draw(batch));
            worst += setting.loss_value(&setting.search(setting.draw(batch)));
        }
        let name = only.map_or("all", PaperSite::name);
        assert!(worst > clean, "{name}: {worst} after the search, {clean} clean");
        assert!(worst > random, "{name}: {worst} after the search, {random} at random");
    }
}

const EVALUATED: [&str; 2] = ["coarse", "fine"];

#[test]
fn a_shared_field_learns_from_the_perturbed_loss_and_a_separate_one_leaves_the_evaluated_fields_alone() {
    for on_grid in [false, true] {
        let trained = |method, field, steps| {
            let config = tiny_config(method, |config| {
                if on_grid {
                    put_on_grid(config, 10);
                }
                config.perturb.field = field;
            });
            trained(&config, steps)
        };
        let nerf = trained(Method::Nerf, PerturbField::Shared, 2);
        let shared = trained(Method::AugNerf, PerturbField::Shared, 2);
        let separate = trained(Method::AugNerf, PerturbField::Separate, 2);
        assert_ne!(parameters(&nerf, &EVALUATED), parameters(&shared, &EVALUATED), "on a grid ({on_grid})");
        assert_eq!(parameters(&nerf, &EVALUATED), parameters(&separate, &EVALUATED), "on a grid ({on_grid})");
        let start = trained(Method::AugNerf, PerturbField::Separate, 0);
        assert_ne!(parameters(&start, &["adversarial"]), parameters(&separate, &["adversarial"]));
    }
}

#[test]
fn the_search_leaves_weights_batches_and_jitter_untouched() {
    // With lambda = 0 everything of the search runs and nothing of it may show.
    let nerf = trained(&tiny_config(Method::Nerf, |_| {}), 5);
    let searched = trained(&tiny_config(Method::AugNerf, |config| config.perturb.lambda = 0.0), 5);
    assert_eq!(parameters(&nerf, &EVALUATED), parameters(&searched, &EVALUATED));
}

#[test]
fn every_kind_and_place_trains() {
    for second in [SecondPass::WorstCase, SecondPass::Gaussian, SecondPass::Uniform, SecondPass::FreshJitter] {
        for output in [OutputPlace::After, OutputPlace::Before] {
            for resample in [augnerf::settings::Resample::Clean, augnerf::settings::Resample::Perturbed] {
                let config = tiny_config(Method::AugNerf, |config| {
                    (config.perturb.second, config.perturb.output, config.perturb.resample) =
                        (second, output, resample);
                });
                let mut trainer = trained(&config, 2);
                let stats = trainer.step(true).unwrap();
                assert!(stats.term("loss_perturbed").unwrap() > 0.0);
                let expected = if second.perturbs() { 6 } else { 0 };
                assert_eq!(stats.sites.len(), expected, "{second:?}");
            }
        }
    }
}

#[test]
fn a_level_too_small_to_matter_is_inactive_and_a_large_one_is_not() {
    let levels = |epsilon: f64| {
        let config = tiny_config(Method::AugNerf, |config| {
            config.perturb[PaperSite::Rgb].epsilon = Some(epsilon.into());
            config.perturb[PaperSite::Rgb].step_size = Some(epsilon);
        });
        let stats = trained(&config, 20).step(true).unwrap();
        stats.sites.iter().find(|measured| measured.site == "rgb").unwrap().clone()
    };
    let (small, large) = (levels(1e-9), levels(0.1));
    assert!(small.inactive && !large.inactive, "{small:?} {large:?}");
    // A colour of a ray is a mean of samples' colours, each moved by a tenth at most.
    assert!(small.shift < 1e-5 && large.shift > 0.5 && large.shift <= 25.5, "{small:?} {large:?}");
    assert!(large.gain > 0.0 && large.gain_over_random > 0.0 && large.share_at_bound.unwrap() > 0.4, "{large:?}");
}

/// What a level adds to the loss counts as the loss itself does: a coarse pass of weight 0.1 a tenth.
#[test]
fn a_coarse_level_gains_as_much_as_its_pass_weighs() {
    let gain = |coarse_weight: f64| {
        let config = tiny_config(Method::AugNerf, |config| {
            config.train.coarse_weight = coarse_weight;
            config.perturb.sizes = Sizes::Calibrated;
            for site in PaperSite::ALL {
                config.perturb[site].passes = Passes::Off;
            }
            config.perturb[PaperSite::Xyz].passes = Passes::Coarse;
            config.perturb[PaperSite::Xyz].epsilon = Some(20.0.into());
        });
        trained(&config, 0).step(true).unwrap().sites[0].gain
    };
    let (whole, tenth) = (gain(1.0), gain(0.1));
    assert!(whole != 0.0 && (tenth / whole - 0.1).abs() < 1e-6, "{whole} {tenth}");
}

#[test]
fn density_noise_cannot_make_an_empty_white_scene_opaque() {
    // All densities 0, the density delta at +epsilon everywhere: what it adds to each ray is at
    // most epsilon * (far - near) * |d|, because the last sample's is kept at 0.
    let mut setting = setting(Method::AugNerf, 5, (6, 9), |config| {
        config[PaperSite::Density].epsilon = Some(0.01.into());
        for site in [PaperSite::T, PaperSite::Xyz, PaperSite::View, PaperSite::Feature, PaperSite::Rgb] {
            config[site].passes = Passes::Off;
        }
    });
    setting.noise = Some(Tensor::full(-1e3f64, (6, 9), &CPU).unwrap());
    let mut deltas = Deltas::default();
    deltas.insert(PaperSite::Density, Tensor::full(0.01f64, (6, 9), &CPU).unwrap());
    let out = perturbed_pass(&setting.field, setting.pass(), setting.perturbation(&deltas)).unwrap();
    let norms = setting.rays.direction_norm.flatten_all().unwrap().to_vec1::<f64>().unwrap();
    for (rgb, norm) in out.composite.rgb.to_vec2::<f64>().unwrap().iter().zip(norms) {
        let limit = 0.01 * 4.0 * norm;
        assert!(rgb.iter().all(|c| (1.0 - c) <= limit && *c <= 1.0 + 1e-12), "{rgb:?} beyond {limit}");
    }
    assert!(out.composite.acc.max(0).unwrap().to_scalar::<f64>().unwrap() > 0.0);
}

#[test]
fn a_level_of_size_zero_is_reported_inactive() {
    let config = tiny_config(Method::AugNerf, |config| config.perturb[PaperSite::Rgb].epsilon = Some(0.0.into()));
    let stats = trained(&config, 1).step(true).unwrap();
    let rgb = stats.sites.iter().find(|measured| measured.site == "rgb").unwrap();
    assert!(rgb.inactive && (rgb.gain, rgb.shift) == (0.0, 0.0) && rgb.share_at_bound.is_none(), "{rgb:?}");
}

/// So does the search of a step: where the feature level alone is on, a further ascent step costs less than the trunk.
#[test]
fn a_search_that_leaves_the_points_alone_pays_for_the_trunk_once() {
    let work_of = |steps: usize| {
        let config = tiny_config(Method::AugNerf, |config| {
            config.perturb.injection_layer = 4;
            for site in PaperSite::ALL {
                config.perturb[site].passes = if site == PaperSite::Feature { Passes::Both } else { Passes::Off };
            }
            config.perturb[PaperSite::Feature].steps = Some(steps);
        });
        let runtime = Runtime::new("cpu", Some(1)).unwrap();
        let mut trainer = Trainer::new(&config, &tiny_scene(), DType::F32, &runtime).unwrap();
        let before = runtime.work().multiply_adds;
        runtime.install(|| trainer.step(false).unwrap());
        runtime.work().multiply_adds - before
    };
    // 64 rays of 8 coarse and 16 fine samples; layers 1 to 4.
    let trunk = 64 * (8 + 16) * (27 * 16 + 16 * 16 + (27 + 16) * 16 + 16 * 16);
    let [two, three] = [2, 3].map(work_of);
    assert!(three > two && three - two < trunk, "{} for a step, {trunk} for the trunk", three - two);
}
