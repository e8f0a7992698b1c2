//! What training promises besides the numbers of one step.

use crate::common::{assert_says, runtime, tiny_config, tiny_scene, trained};
use augnerf::base::{Error, Image};
use augnerf::metrics::psnr_float;
use augnerf::run::Viewer;
use augnerf::settings::{DataKind, DensityActivation, Encoding, Method, Resolved, Schedule};
use augnerf::train::{Trainer, learning_rate};
use candle_core::{DType, Device, Tensor};

/// The held-out view as it is rendered.
fn rendered(trainer: &Trainer, config: &Resolved) -> Image {
    let scene = &tiny_scene();
    let viewer = Viewer { model: trainer.model().unwrap(), config, scene, runtime: runtime() };
    viewer.render(&scene.test[0].camera).unwrap().image
}

fn psnr(trainer: &Trainer, config: &Resolved) -> f64 {
    psnr_float(&rendered(trainer, config), &tiny_scene().test[0].image).unwrap().unwrap()
}

#[test]
fn training_fits_the_scene() {
    let config = tiny_config(Method::Nerf, |_| {});
    let [start, end] = [0, 400].map(|steps| psnr(&trained(&config, steps), &config));
    assert!(end > start + 5.0 && end > 18.0, "{start} dB at the start, {end} dB at the end");
}

/// Rays to the scene's chunk size: results change by rounding only, and rendering not at all.
#[test]
fn chunks_bound_memory_and_change_no_picture() {
    let config = tiny_config(Method::Nerf, |_| {});
    let trainer = trained(&config, 20);
    let render =
        |chunk: usize| rendered(&trainer, &tiny_config(Method::Nerf, |config| config.eval.chunk = chunk)).pixels;
    let whole = render(256);
    let largest = |other: Vec<f32>| whole.iter().zip(other).map(|(a, b)| (a - b).abs()).fold(0f32, f32::max);
    // Matrix kernels handle the last rows of a block in another order.
    assert!(largest(render(7)) < 1e-5);
    let losses = |chunk: usize| {
        let config = tiny_config(Method::Nerf, |config| config.train.chunk = chunk);
        let stats = trained(&config, 3).step(false).unwrap();
        (stats.term("loss_coarse").unwrap(), stats.term("loss_fine").unwrap())
    };
    let ((a, b), (c, d)) = (losses(64), losses(5));
    assert!((a - c).abs() < 1e-5 && (b - d).abs() < 1e-5, "{a} {b} {c} {d}");
}

#[test]
fn a_run_whose_rays_are_all_empty_is_stopped() {
    // Density noise must not hide it: the field that is evaluated has none.
    let config = tiny_config(Method::Nerf, |config| {
        config.train.collapse_steps = 4;
        config.sampling.density_noise = Some(1e4);
    });
    let mut trainer = trained(&config, 0);
    for (name, var) in trainer.model().unwrap().variables() {
        if name.ends_with("density.bias") {
            var.set(&Tensor::new(&[-1e3f32], &Device::Cpu).unwrap()).unwrap();
        }
    }
    for _ in 0..3 {
        trainer.step(false).unwrap();
    }
    let error = trainer.step(false).unwrap_err();
    assert!(matches!(error, Error::Diverged(_)));
    assert_says(&error.to_string(), &["step 4", "acc", "4 steps", "seed"]);
}

#[test]
fn a_weight_that_is_not_a_number_is_reported_with_step_and_tensor() {
    let config = tiny_config(Method::Nerf, |_| {});
    let mut trainer = trained(&config, 2);
    let (_, var) = &trainer.model().unwrap().variables()[0];
    var.set(&(var.as_tensor() * f64::NAN).unwrap()).unwrap();
    let message = trainer.step(false).unwrap_err().to_string();
    assert!(message.contains("step 3") && message.contains("coarse"), "{message}");
}

#[test]
fn dead_starts_are_drawn_again_the_same_for_all_rows_of_a_seed() {
    // Almost every start has some share of dead densities; half is asked for here.
    let redraws = |method, seed| {
        let config = tiny_config(method, |config| {
            config.seed = seed;
            config.train.dead_start_share = 0.5;
        });
        trained(&config, 0).redraws().to_vec()
    };
    let drawn: Vec<Vec<u64>> = (0..6).map(|seed| redraws(Method::Nerf, seed)).collect();
    assert!(drawn.iter().flatten().any(|&count| count > 0), "{drawn:?}");
    assert!(drawn.iter().flatten().any(|&count| count == 0), "{drawn:?}");
    for (seed, expected) in drawn.iter().enumerate() {
        assert_eq!(&redraws(Method::AugNerf, seed as u64), expected);
    }
}

/// Outside its box a hash field has no density, which says nothing of its weights; the exponential is never 0.
#[test]
fn the_start_of_a_hash_field_is_judged_within_its_box() {
    let start = |activation: DensityActivation, (low, high): (f64, f64)| {
        let config = tiny_config(Method::Nerf, |config| {
            config.field.encoding = Encoding::Hash;
            config.field.density_activation = activation;
            let hash = &mut config.field.hash;
            (hash.log2_table, hash.bounds) = (8, Some([[low; 3], [high; 3]]));
        });
        Trainer::new(&config, &tiny_scene(), DType::F32, runtime())
    };
    // A tenth of the rays' interval at the most lies in it.
    assert_eq!(start(DensityActivation::Exp, (-0.2, 0.2)).unwrap().redraws(), [0]);
    let alive = start(DensityActivation::Relu, (-0.05, 0.05)).unwrap();
    assert!(alive.redraws()[0] < 10, "{:?}", alive.redraws());
    for activation in [DensityActivation::Exp, DensityActivation::Relu, DensityActivation::Softplus] {
        let refusal = start(activation, (50.0, 51.0)).err().expect("no ray meets the box").to_string();
        assert_says(&refusal, &["field.hash.bounds", "outside", "[50.000, 50.000, 50.000]"]);
    }
}

#[test]
fn the_learning_rate_decays_exponentially() {
    let config = tiny_config(Method::Nerf, |config| {
        config.train.learning_rate = 5e-4;
        config.train.decay_steps = Some(1000);
    });
    for (step, expected) in [(0, 5e-4), (1000, 5e-5), (500, 5e-4 * 0.1f64.sqrt())] {
        assert!((learning_rate(&config, step) - expected).abs() < 1e-12);
    }
}

/// At the ends of the course, in its middle, and a quarter of the way up the warm-up's quarter sine.
#[test]
fn the_log_linear_rate_warms_up_and_falls_evenly_in_its_logarithm() {
    let config = tiny_config(Method::MipNerf, |config| {
        config.train.schedule = Schedule::LogLinear;
        config.train.steps = 1000;
        (config.train.learning_rate, config.train.final_learning_rate) = (5e-4, 5e-6);
        (config.train.warmup_share, config.train.warmup_from) = (0.1, 0.01);
    });
    let course = |step: f64| 5e-4 * 1e-2f64.powf(step / 1000.0);
    let risen = 0.01 + 0.99 * (std::f64::consts::FRAC_PI_2 / 2.0).sin();
    for (step, expected) in [(0, 5e-6), (50, course(50.0) * risen), (100, course(100.0)), (500, 5e-5), (1000, 5e-6)] {
        assert!((learning_rate(&config, step) / expected - 1.0).abs() < 1e-12, "{step}");
    }
}

/// In NDC pixels are cylinders.
#[test]
fn mip_nerf_trains_on_a_forward_facing_scene() {
    let config = tiny_config(Method::AugMipNerf, |config| {
        config.sampling.density_noise = Some(1.0);
        config.data.width = 24;
    });
    let config = config.into_draft().locate(DataKind::BuiltinForward).unwrap();
    let scene = augnerf::data::load(&config.data, 0, &()).unwrap();
    assert!(scene.ndc.is_some());
    let config = config.resolve(DataKind::BuiltinForward, scene.extent()).unwrap();
    let mut trainer = Trainer::new(&config, &scene, DType::F32, runtime()).unwrap();
    let mut loss = || trainer.step(false).unwrap().term("loss_fine").unwrap();
    let early: f64 = (0..20).map(|_| loss()).sum();
    let late: f64 = (0..200).map(|_| loss()).skip(180).sum();
    assert!(late < 0.7 * early, "{early} {late}");
}

/// One field serves both passes, and the coarse one counts a tenth.
#[test]
fn mip_nerf_fits_the_scene_with_one_field() {
    for method in [Method::MipNerf, Method::AugMipNerf] {
        let config = tiny_config(method, |_| {});
        let mut trainer = trained(&config, 300);
        assert_eq!(trainer.model().unwrap().fields().unwrap().by_role().count(), 1);
        let psnr = psnr(&trainer, &config);
        assert!(psnr > 18.0, "{method:?}: {psnr} dB");
        let stats = trainer.step(true).unwrap();
        let (coarse, fine) = (stats.term("loss_coarse").unwrap(), stats.term("loss_fine").unwrap());
        let perturbed = stats.term("loss_perturbed").map_or(0.0, |loss| config.perturb.lambda * loss);
        assert!((stats.loss - (0.1 * coarse + fine + perturbed)).abs() < 1e-9, "{stats:?}");
        assert_eq!(stats.sites.len(), if method == Method::AugMipNerf { 6 } else { 0 });
    }
}

#[test]
fn a_model_without_fine_samples_trains_its_coarse_field_alone() {
    let config = tiny_config(Method::AugNerf, |config| config.sampling.fine = 0);
    let mut trainer = trained(&config, 2);
    assert!(trainer.model().unwrap().fields().unwrap().fine().is_none());
    let stats = trainer.step(true).unwrap();
    assert!(stats.term("loss_fine").is_none() && stats.sites.len() == 6);
    rendered(&trainer, &config);
}
