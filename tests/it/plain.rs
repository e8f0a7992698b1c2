//! Steps by candle's operations, as devices of candle that are no CPU take them, against this project's own.

use augnerf::base::place::plainly;
use augnerf::methods::{FieldLearner, Learner};
use augnerf::settings::{Config, Contraction, Encoding, Interpolation, Method, Regularizer, Resolved, Sizes};
use augnerf::train::{Adam, AdamSettings};
use candle_core::{DType, Device, Tensor};

use crate::common::{flat, tiny_config, tiny_scene};

/// Losses, gradients, and parameters after an update, of the fourth step.
fn step(config: &Resolved) -> [Vec<f64>; 3] {
    let (mut learner, _) = FieldLearner::start(config, &tiny_scene(), DType::F32, &Device::Cpu).unwrap();
    let variables = learner.fields().variables();
    for (name, var) in &variables {
        if name.ends_with("table") {
            let moved: Vec<f32> = (0..var.elem_count()).map(|i| 0.5 * (i as f32 * 0.7).sin()).collect();
            var.set(&Tensor::from_vec(moved, var.shape(), &Device::Cpu).unwrap()).unwrap();
        }
    }
    let result = learner.step(3, true, &|| Ok(())).unwrap();
    let mut losses: Vec<f64> = result.report.terms.iter().map(|term| term.value).collect();
    losses.extend(result.report.sites.iter().map(|site| site.gain));
    let gradients = result.gradients.0.iter().flatten().flat_map(flat).collect();
    let mut adam = Adam::new(AdamSettings::of(&config.train), variables.clone()).unwrap();
    adam.update(&result.gradients.0, 0.01, 1).unwrap();
    [losses, gradients, variables.iter().flat_map(|(_, var)| flat(var.as_tensor())).collect()]
}

fn assert_agrees(method: Method, change: impl FnOnce(&mut Config)) {
    let config = tiny_config(method, change);
    let (own, plain) = (step(&config), plainly(|| step(&config)));
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>().sqrt();
    // An update is of the gradient's sign, so that rounding turns some of those that are nearly 0.
    for ((own, plain), allowed) in own.iter().zip(&plain).zip([1e-4, 1e-3, 2e-2]) {
        assert!(own.len() == plain.len() && !own.is_empty());
        let difference = norm(&mut own.iter().zip(plain).map(|(a, b)| a - b));
        let all = norm(&mut own.iter().copied());
        println!("{} numbers differ by {:.1e}", own.len(), difference / all);
        assert!(all > 1e-4 && difference < allowed * all, "{difference:.1e} of {all:.1e}");
    }
}

fn hash(config: &mut Config, contraction: Contraction) {
    config.field.encoding = Encoding::Hash;
    config.field.rgb_limit = 2.0;
    let hash = &mut config.field.hash;
    (hash.levels, hash.log2_table, hash.finest) = (5, 9, Some(40));
    (hash.contraction, hash.bounds) = (Some(contraction), Some([[-1.0, -0.9, -0.8], [0.8, 0.9, 1.0]]));
}

#[test]
fn nerf_and_mip_nerf() {
    assert_agrees(Method::Nerf, |config| {
        config.regularizer.kind = vec![Regularizer::Tv, Regularizer::Distortion, Regularizer::Orientation];
        config.regularizer.weight = vec![1e-3, 0.01, 0.1];
    });
    assert_agrees(Method::MipNerf, |_| ());
}

#[test]
fn aug_nerf() {
    assert_agrees(Method::AugNerf, |config| config.perturb.sizes = Sizes::Calibrated);
}

#[test]
fn hash_grids() {
    for contraction in [Contraction::None, Contraction::Axes, Contraction::Ball] {
        assert_agrees(Method::Nerf, |config| hash(config, contraction));
        assert_agrees(Method::AugNerf, |config| {
            hash(config, contraction);
            config.field.hash.interpolation = Interpolation::Smoothstep;
            config.perturb.sizes = Sizes::Calibrated;
        });
    }
}

#[test]
fn derivatives_of_hash_grids() {
    for (contraction, interpolation) in
        [(Contraction::None, Interpolation::Linear), (Contraction::Ball, Interpolation::Smoothstep)]
    {
        assert_agrees(Method::Nerf, |config| {
            hash(config, contraction);
            config.field.hash.interpolation = interpolation;
            config.regularizer.kind = vec![Regularizer::Tv, Regularizer::Orientation];
            config.regularizer.weight = vec![1e-3, 0.1];
        });
    }
}
