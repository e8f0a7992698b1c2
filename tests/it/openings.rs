//! What moves during a training: encodings that open, samples that spread, gradients near cameras, the perturbed pass's weight.

use crate::common::{
    assert_refused, assert_same_bytes, parameters, put_on_grid, runtime, tiny_config, tiny_scene, trained,
};
use augnerf::data::{RayBuffer, RayParts};
use augnerf::methods::{FieldRenderer, Fields, Renderer};
use augnerf::settings::{Config, Method, PixelOrigin, Resolved, WeightSchedule};
use augnerf::train::Trainer;
use candle_core::{DType, Device};

const ROLES: [&str; 2] = ["coarse", "fine"];

fn config(on_grid: bool, set: impl Fn(&mut Config)) -> Resolved {
    tiny_config(Method::AugNerf, |config| {
        if on_grid {
            put_on_grid(config, 9);
        }
        config.train.steps = 10;
        set(config);
    })
}

#[test]
fn all_of_it_together_has_the_same_bytes_on_threads_and_after_a_stop() {
    for on_grid in [false, true] {
        let roles = if on_grid { &ROLES[..1] } else { &ROLES[..] };
        let all = config(on_grid, |config| {
            config.field.frequency_steps = 10;
            (config.sampling.anneal_steps, config.sampling.anneal_start) = (4, 0.3);
            config.train.gradient_scaling = true;
            config.perturb.lambda_schedule = WeightSchedule::Linear { from: 0.0, steps: 4 };
        });
        let once = assert_same_bytes(&all, roles);
        let changes: [fn(&mut Config); 4] = [
            |config| config.field.frequency_steps = 0,
            |config| config.sampling.anneal_steps = 0,
            |config| config.train.gradient_scaling = false,
            |config| config.perturb.lambda_schedule = WeightSchedule::Constant,
        ];
        for (i, change) in changes.iter().enumerate() {
            let mut other = all.clone().into_draft();
            change(&mut other);
            let other = other.resolve(augnerf::settings::DataKind::Blender, augnerf::bench::EXTENT).unwrap();
            let differs = parameters(&trained(&other, 6), roles) != once;
            // All cameras of the scene are farther than a unit from every sample.
            assert_eq!(differs, i != 2, "{i} on a grid ({on_grid})");
        }
    }
}

/// A model in training, and the same from its checkpoint, are rendered with the frequencies that are open; from the end on with
/// all.
#[test]
fn pictures_have_the_frequencies_that_are_open() {
    let scene = tiny_scene();
    let pixels: Vec<_> = (0..16).map(|x| (&scene.test[0].camera, x, 7)).collect();
    let rays = RayBuffer::new(&pixels, None, PixelOrigin::Corner, RayParts::default());
    let rays = rays.to_tensors(DType::F32, &Device::Cpu).unwrap();
    for on_grid in [false, true] {
        let config = config(on_grid, |config| config.field.frequency_steps = 5);
        let mut trainer = trained(&config, 0);
        for step in 1..=6 {
            trainer.step(false).unwrap();
            let folder = tempfile::tempdir().unwrap();
            let checkpoint = trainer.save(folder.path()).unwrap();
            let colours = |fields: &Fields| {
                let renderer = FieldRenderer::new(fields, &config, &scene).unwrap();
                renderer.render(&rays).unwrap().rgb.flatten_all().unwrap().to_vec1::<f32>().unwrap()
            };
            let fields = trainer.model().unwrap().fields().unwrap();
            let shown = colours(fields);
            let loaded = Trainer::resume(&checkpoint, &config, &scene, DType::F32, runtime()).unwrap();
            assert_eq!(shown, colours(loaded.model().unwrap().fields().unwrap()), "step {step}");
            let all_open = colours(&fields.at_step(&config, u64::MAX).unwrap());
            // The last of n levels is open after (n - 1) / n of the end.
            let opens = if on_grid { 4 } else { 5 };
            assert_eq!(shown == all_open, step >= opens, "step {step} on a grid ({on_grid})");
        }
    }
}

/// Samples within a unit of a camera count less, in the clean and in the perturbed pass.
#[test]
fn gradients_near_cameras_change_what_is_learned() {
    let mut scene = tiny_scene();
    scene.near = 0.1;
    for method in [Method::Nerf, Method::AugNerf] {
        let learned = |scales: bool| {
            let config = tiny_config(method, |config| config.train.gradient_scaling = scales);
            let mut trainer = Trainer::new(&config, &scene, DType::F32, runtime()).unwrap();
            let loss = trainer.step(false).unwrap().loss;
            (0..3).for_each(|_| drop(trainer.step(false).unwrap()));
            (loss, parameters(&trainer, &ROLES))
        };
        let ((loss, with), (same, without)) = (learned(true), learned(false));
        assert_eq!(loss, same, "values do not change");
        assert_ne!(with, without);
    }
}

#[test]
fn the_perturbed_pass_s_weight_follows_its_schedule() {
    let config = config(true, |config| {
        config.perturb.lambda = 0.2;
        config.perturb.lambda_schedule = WeightSchedule::Linear { from: 0.0, steps: 2 };
    });
    let mut trainer = trained(&config, 0);
    for expected in [0.0, 0.1, 0.2, 0.2] {
        let stats = trainer.step(false).unwrap();
        let perturbed = stats.terms.iter().find(|term| term.name == "loss_perturbed").unwrap();
        assert!((perturbed.weight - expected).abs() < 1e-12);
        let sum: f64 = stats.terms.iter().map(|term| term.weight * term.value).sum();
        assert!((stats.loss - sum).abs() < 1e-9);
    }
}

#[test]
fn impossible_ones_are_refused_with_words() {
    let long = "train.steps=100; field.frequency_steps=101";
    let released = "method=aug-nerf; perturb.objective=released; perturb.lambda_schedule=from 2 in 5 steps";
    assert_refused(&[
        (long, &["field.frequency_steps", "101", "at most train.steps (100)"]),
        ("train.steps=100; sampling.anneal_steps=101", &["sampling.anneal_steps", "101", "never sees whole rays"]),
        ("sampling.anneal_start=0", &["sampling.anneal_start", "above 0"]),
        ("data.kind=llff; data.dir=fern; train.gradient_scaling=true", &["train.gradient_scaling", "data.ndc=false"]),
        (released, &["perturb.lambda", "2", "at most 1"]),
    ]);
}
