//! The network and how it learns.

use candle_core::{DType, Device, Tensor};

use crate::data::{RayBuffer, RayParts, Scene};
use crate::grids::reference::{error, ramp, values};
use crate::methods::Learner;
use crate::methods::Renderer;
use crate::methods::StepResult;
use crate::planes::windows::Work;
use crate::planes::{MpiNetwork, PlanesLearner, PlanesRenderer};
use crate::settings::{Config, PixelOrigin, PlanesLoss, Resolved};

use super::{config, scene};

fn network(config: &Config, dtype: DType) -> MpiNetwork {
    MpiNetwork::init(config, dtype, &Device::Cpu).unwrap()
}

fn learned(config: &Resolved, scene: &Scene, dtype: DType, step: u64) -> StepResult {
    let mut learner = PlanesLearner::new(config, scene, network(config, dtype)).unwrap();
    learner.step(step, false, &|| Ok(())).unwrap()
}

/// As many as slim's layers have with five inputs; Xavier's rule bounds them.
#[test]
fn parameters_are_those_of_the_network() {
    let config = Config::default();
    let names = MpiNetwork::parameter_names(&config);
    let count: usize = names.iter().map(|(_, shape)| shape.iter().product::<usize>()).sum();
    assert_eq!(count, 679_968 + 5 + 1_072);
    let variables = network(&config, DType::F32).parameters.variables;
    for ((name, shape), (own, var)) in names.iter().zip(&variables) {
        assert_eq!((name, &shape[..]), (own, var.dims()));
        let values = values(var);
        match name.rsplit_once('.').unwrap().1 {
            "weight" => {
                let limit = (6.0 / (27 * (shape[1] + shape[2])) as f64).sqrt();
                let largest = values.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
                assert!((0.98 * limit..=limit * (1.0 + 1e-6)).contains(&largest), "{name}: {largest} of {limit}");
            }
            "scale" => assert!(values.iter().all(|value| *value == 1.0)),
            _ => assert!(values.iter().all(|value| *value == 0.0)),
        }
    }
    assert_eq!(variables[0].0, "planes.conv1_1.weight");
}

#[test]
fn f32_is_near_f64() {
    let config = config(&scene(16), |config| config.llff.inputs = 2);
    let sweep = ((ramp(&[8, 16, 8, 6], 0.3) * 0.5).unwrap() + 0.5).unwrap();
    let exact = network(&config, DType::F64).weights(false).forward(&sweep).unwrap();
    let fast = network(&config, DType::F32).weights(false).forward(&sweep.to_dtype(DType::F32).unwrap()).unwrap();
    assert_eq!(exact.dims(), [8, 16, 8, 2]);
    assert!(error(&fast, &exact) < 1e-4, "{}", error(&fast, &exact));
}

/// Slopes of the whole loss along some parameters of every kind: network, head, planes, over and blend together.
#[test]
fn gradients_of_a_step_are_central_differences() {
    for (loss, every) in [(PlanesLoss::Mse, 6), (PlanesLoss::L1, 17)] {
        let scene = scene(8);
        let config = config(&scene, |config| config.llff.loss = loss);
        let network = network(&config, DType::F64);
        let mut learner = PlanesLearner::new(&config, &scene, network.clone()).unwrap();
        let gradients = learner.step(1, false, &|| Ok(())).unwrap().gradients.0;
        let variables = network.parameters.variables;
        assert!(gradients.iter().all(Option::is_some) && gradients.len() == variables.len());
        for (index, (name, var)) in variables.into_iter().enumerate().filter(|(index, _)| index % every == every - 1) {
            let (found, at) = (values(gradients[index].as_ref().unwrap()), values(&var));
            let place = at.len() * 2 / 3;
            let set = |values: Vec<f64>| var.set(&Tensor::from_vec(values, var.dims(), &Device::Cpu).unwrap()).unwrap();
            let mut moved = |by: f64| {
                let mut values = at.clone();
                values[place] += by;
                set(values);
                learner.step(1, false, &|| Ok(())).unwrap().report.loss
            };
            let slope = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            set(at);
            let scale = found.iter().fold(1e-6, |scale: f64, value| scale.max(value.abs()));
            assert!((found[place] - slope).abs() < 1e-3 * scale, "{loss:?} {name}: {} and {slope}", found[place]);
        }
    }
}

fn bits(learned: &StepResult) -> Vec<u64> {
    let gradients = learned.gradients.0.iter().flatten().flat_map(values).map(f64::to_bits);
    gradients.chain([learned.report.loss.to_bits()]).collect()
}

/// The view that is left out says what is asked for at the crop's pixels, and nothing else of it is seen.
#[test]
fn the_view_that_is_left_out_is_no_input() {
    let plain = scene(32);
    let config = config(&plain, |_| {});
    let eyes: Vec<_> = {
        let learner = PlanesLearner::new(&config, &plain, network(&config, DType::F32)).unwrap();
        crate::planes::mpi::eyes(&learner.stage.views)
    };
    let depths = super::super::geometry::depths(1.0, 4.0, 8);
    let mut seen = [0; 4];
    for step in 0..6 {
        let work = Work::draw(&config.llff, config.seed, step, &eyes, &depths).unwrap();
        assert!(work.references.iter().all(|reference| reference.view != work.target) && work.counted() >= 32);
        seen[work.target] += 1;
        let usual = learned(&config, &plain, DType::F32, step);
        let rendered = |inside: bool| {
            let mut scene = plain.clone();
            let mut image = (*scene.train[work.target].image).clone();
            for (i, pixel) in image.pixels.chunks_mut(3).enumerate() {
                let asked = work.pixels.contains(&[i % 32, i / 32]);
                if asked == inside {
                    pixel.fill(0.0);
                }
            }
            scene.train[work.target].image = image.into();
            learned(&config, &scene, DType::F32, step)
        };
        assert!(bits(&rendered(false)) == bits(&usual), "step {step}");
        assert!(bits(&rendered(true)) != bits(&usual), "step {step}");
    }
    assert!(seen.iter().filter(|times| **times > 0).count() > 1, "{seen:?}");
}

/// Pictures, steps and multiplane images are the same whatever the held-out views are.
#[test]
fn views_that_are_held_out_are_never_an_input() {
    let plain = scene(24);
    let mut other = plain.clone();
    other.test[0].camera.pose[0][3] = 9.0;
    other.test[0].image = plain.train[0].image.clone();
    other.test.push(plain.train[1].clone());
    let config = config(&plain, |_| {});
    for step in 0..3 {
        let [a, b] = [&plain, &other].map(|scene| bits(&learned(&config, scene, DType::F32, step)));
        assert!(a == b, "step {step}");
    }
    let network = network(&config, DType::F32);
    let [a, b] = [&plain, &other].map(|scene| network.renderer(&config, scene).unwrap().mpis);
    // The second renderer takes what the first has made: nothing that it is made of differs.
    assert!(std::sync::Arc::ptr_eq(&a, &b));
}

/// Weights that moved, or another picture, are seen; the same ones cost no second prediction.
#[test]
fn multiplane_images_are_those_of_the_weights_as_they_are() {
    let scene = scene(16);
    let config = config(&scene, |_| {});
    let network = network(&config, DType::F32);
    let of = |renderer: &PlanesRenderer| -> Vec<Vec<u8>> {
        let mpi = |view: usize| renderer.mpis.make(view).and_then(|()| Ok(renderer.mpis.of(view)?.planes.clone()));
        (0..4).map(|view| mpi(view).unwrap()).collect()
    };
    let planes = |scene: &Scene| of(&network.renderer(&config, scene).unwrap());
    let before = planes(&scene);
    // Millions of numbers, which a message would print.
    assert!(planes(&scene) == before);
    let mut darker = scene.clone();
    let mut image = (*darker.train[2].image).clone();
    image.pixels.iter_mut().for_each(|value| *value *= 0.5);
    darker.train[2].image = image.into();
    assert!(planes(&darker) != before);
    assert!(planes(&scene) == before);
    // The bias of alpha: behind every other convolution a normalization takes its size away.
    let (_, bias) = network.parameters.variables.last().unwrap();
    let dark = planes(&darker);
    let early = network.renderer(&config, &scene).unwrap();
    bias.set(&(bias.as_detached_tensor() + 0.5).unwrap()).unwrap();
    assert!(planes(&scene) != before);
    // A renderer that was made before, and has predicted nothing yet, shows the weights of its time.
    assert!(dark != before && of(&early) == before);
}

/// A picture needs the planes of the views next to its camera alone, and says so where they are missing.
#[test]
fn the_planes_of_far_views_are_not_predicted() {
    let scene = scene(16);
    let config = config(&scene, |config| config.llff.blend = 2);
    let renderer = network(&config, DType::F32).renderer(&config, &scene).unwrap();
    let rays = RayBuffer::new(&[(&scene.train[1].camera, 3, 4)], None, PixelOrigin::Corner, RayParts::default());
    let rays = rays.to_tensors(DType::F32, &Device::Cpu).unwrap();
    assert!(renderer.render(&rays).err().unwrap().to_string().contains("not prepared"));
    renderer.prepare(&rays).unwrap();
    renderer.render(&rays).unwrap();
    let made: Vec<usize> = (0..4).filter(|view| renderer.mpis.of(*view).is_ok()).collect();
    assert_eq!(made, [0, 1]);
}

fn refused(scene: &Scene, change: impl FnOnce(&mut Config)) -> String {
    let config = config(scene, change);
    PlanesLearner::check(&config, scene).unwrap_err().to_string()
}

#[test]
fn scenes_that_it_cannot_learn_are_refused_in_a_sentence() {
    let mut few = scene(16);
    few.train.truncate(2);
    let said = refused(&few, |_| {});
    assert!(said.contains("at least 3") && said.contains("leaves 2") && said.contains("data.holdout"), "{said}");
    let mut masked = scene(16);
    masked.train[1].mask = Some(vec![true; 256].into());
    let said = refused(&masked, |_| {});
    assert!(said.contains("view1") && said.contains("mask"), "{said}");
    let mut from_zero = scene(16);
    from_zero.near = 0.0;
    let said = refused(&from_zero, |config| (config.llff.near, config.llff.far) = (None, None));
    assert!(said.contains("llff.near = 0"), "{said}");
    let mut ndc = scene(16);
    ndc.ndc = Some(crate::data::Ndc { width: 16.0, height: 16.0, focal: 19.2 });
    assert!(refused(&ndc, |_| {}).contains("data.ndc=false"));
    let mut huge = scene(16);
    huge.train.iter_mut().for_each(|view| (view.camera.width, view.camera.height) = (1 << 20, 1 << 16));
    let said = refused(&huge, |_| {});
    assert!(said.contains("llff.planes = 8") && said.contains("4 training views"), "{said}");
    // Two views look the one way, two the other.
    let mut apart = scene(16);
    for view in &mut apart.train[2..] {
        (view.camera.pose[0][0], view.camera.pose[2][2]) = (-1.0, -1.0);
    }
    let said = refused(&apart, |_| {});
    assert!(said.contains("see too little of the same") && said.contains("llff.references"), "{said}");
}

/// Planes ten pixels apart, of which a window of 16 holds two: no pixel has three quarters of them, and those with any count.
#[test]
fn large_disparities_leave_every_step_its_pixels() {
    let wide = scene(400);
    let config = config(&wide, |_| {});
    let learner = PlanesLearner::new(&config, &wide, network(&config, DType::F32)).unwrap();
    let eyes = crate::planes::mpi::eyes(&learner.stage.views);
    for step in 0..40 {
        let work = Work::draw(&config.llff, 0, step, &eyes, &learner.stage.depths).unwrap();
        assert!(work.counted() > 0, "step {step}");
        assert!(learned(&config, &wide, DType::F32, step).report.loss.is_finite(), "step {step}");
    }
}
