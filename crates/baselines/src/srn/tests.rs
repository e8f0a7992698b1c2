//! The march, its loss and its gradients against the original modules' numbers and closed forms.

use std::collections::HashMap;

use candle_core::{DType, Device, Tensor};

use crate::data::{Camera, Rays};
use crate::grids::reference::{error, fixture, values, with_gradients};
use crate::settings::SrnConfig;

use super::cell::Lstm;
use super::network::{Srn, SrnMarch};
use super::step::{Sums, Weights};

/// Six rays of two cameras; what the original's loss weighs its terms with.
const RAYS: usize = 6;
const WEIGHTS: Weights = Weights { image: 200.0 / (3.0 * RAYS as f64), depth: 10.0 / RAYS as f64 };

/// A tensor of the original's.
fn get(name: &str) -> Tensor {
    fixture(&format!("srn.{name}"))
}

fn config() -> SrnConfig {
    SrnConfig { width: 8, ..SrnConfig::default() }
}

fn original() -> Srn {
    let names = Srn::parameter_names(&config()).into_iter().map(|(name, _)| name);
    Srn::from_parameters(&config(), names.map(|name| get(&name)).collect()).unwrap()
}

fn rays() -> Rays {
    Rays::new(get("o"), get("d"), get("u")).unwrap()
}

fn march(srn: &Srn) -> SrnMarch {
    srn.march(&rays(), &get("z0")).unwrap()
}

/// Loss of a step with `factor` times its weights, and its sums.
fn step(srn: &Srn, factor: f64) -> (Sums, f64) {
    let weights = Weights { image: WEIGHTS.image * factor, depth: WEIGHTS.depth * factor };
    let mut sums = Sums::new(srn);
    let target: Vec<f32> = values(&get("target")).into_iter().map(|value| value as f32).collect();
    sums.add(srn, &march(srn), &target, weights).unwrap();
    let loss = weights.image * sums.image + weights.depth * sums.behind;
    (sums, loss)
}

/// Demands numbers to `tolerance` of the largest of them.
#[track_caller]
fn assert_near(name: &str, found: &Tensor, expected: &Tensor, tolerance: f64) {
    let error = error(found, expected);
    assert!(error <= tolerance, "{name}: {error}");
}

#[test]
fn the_march_is_the_original_modules() {
    let march = march(&original());
    assert_near("z", &march.z, &get("z"), 1e-12);
    assert_near("colour", &march.colour, &get("colour"), 1e-12);
}

#[test]
fn the_loss_and_its_gradients_are_the_original_modules() {
    let srn = original();
    let (sums, loss) = step(&srn, 1.0);
    let scalar = |name: &str| values(&get(name))[0];
    let near = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-12 * expected, "{found} {expected}");
    near(sums.image / (3 * RAYS) as f64, scalar("image_loss"));
    near(1e4 * sums.behind / RAYS as f64, scalar("depth_loss"));
    near(loss, scalar("loss"));
    for ((name, _), found) in srn.parameters.variables.iter().zip(sums.gradients.0) {
        assert_near(name, &found.unwrap(), &get(&format!("grad.{name}")), 1e-10);
    }
}

/// With 64 times the loss the gradient at some outputs of the cell is beyond 10.
#[test]
fn gradients_at_the_cells_outputs_are_cut_as_in_the_original() {
    let srn = original();
    let found = step(&srn, 64.0).0.gradients.0;
    let mut cut = 0;
    for ((name, _), found) in srn.parameters.variables.iter().zip(found) {
        if !(name.starts_with("phi.") || name.starts_with("lstm.")) {
            continue;
        }
        let expected = get(&format!("clamped64.grad.{name}"));
        let free = (get(&format!("grad.{name}")) * 64.0).unwrap();
        cut += values(&expected).iter().zip(values(&free)).filter(|(a, b)| (**a - b).abs() > 1e-3 * b.abs()).count();
        assert_near(name, &found.unwrap(), &expected, 1e-10);
    }
    assert!(cut > 100, "{cut} gradients differ");
}

#[test]
fn the_cell_is_pytorchs() {
    let names = ["x", "h", "c", "weight_ih", "weight_hh", "bias_ih", "bias_hh"];
    let apply = |[x, h, c, weight_ih, weight_hh, bias_ih, bias_hh]: [&Tensor; 7]| {
        let (h, c) = Lstm { weight_ih, weight_hh, bias_ih, bias_hh }.apply(x, (h, c))?;
        Tensor::cat(&[h, c], 1)
    };
    let given = names.map(|name| get(&format!("cell.{name}")));
    let found = with_gradients(&given, &get("cell.cotangent"), apply);
    let expected = std::iter::once("out".into()).chain(names.map(|name| format!("grad.{name}")));
    for (found, name) in found.iter().zip(expected) {
        assert_near(&name, found, &get(&format!("cell.{name}")), 1e-12);
    }
}

/// Their cameras look along +z with rows downwards, ours along -z with rows upwards.
#[test]
fn rays_of_its_cameras_are_ours() {
    let [poses, intrinsics, uv] = ["cam2world", "intrinsics", "uv"].map(|name| values(&get(name)));
    let (o, d) = (values(&get("o")), values(&get("d")));
    for ray in 0..RAYS {
        let camera = ray / 3;
        let (m, k) = (&poses[16 * camera..], &intrinsics[9 * camera..]);
        let pose = [0, 1, 2].map(|row| [m[4 * row], -m[4 * row + 1], -m[4 * row + 2], m[4 * row + 3]]);
        let camera = Camera { width: 8, height: 8, focal: [k[0], k[4]], centre: [k[2], k[5]], pose };
        let (origin, direction) = camera.ray(uv[2 * ray], uv[2 * ray + 1]);
        for axis in 0..3 {
            assert!((origin[axis] - o[3 * ray + axis]).abs() < 1e-12);
            assert!((direction[axis] - d[3 * ray + axis]).abs() < 1e-12);
        }
    }
}

/// Positions times `scale` are what the network sees: a scene half as large at twice the scale is the same.
#[test]
fn a_scale_is_a_change_of_units() {
    let srn = original();
    let values = srn.parameters.variables.iter().map(|(_, var)| var.as_tensor().clone()).collect();
    let doubled = Srn::from_parameters(&SrnConfig { scale: 2.0, ..config() }, values).unwrap();
    let half = Rays { origins: (get("o") / 2.0).unwrap(), ..rays() };
    let (found, expected) = (doubled.march(&half, &get("z0")).unwrap(), march(&srn));
    assert_near("z", &found.z, &expected.z, 1e-14);
    assert_near("colour", &found.colour, &expected.colour, 1e-14);
}

#[test]
fn fresh_parameters_are_as_many_and_as_large_as_the_originals() {
    for (width, expected) in [(256, 550_292), (128, 144_660), (64, 40_148)] {
        let names = Srn::parameter_names(&SrnConfig { width, ..SrnConfig::default() });
        assert_eq!(names.iter().map(|(_, shape)| shape.iter().product::<usize>()).sum::<usize>(), expected);
    }
    let srn = Srn::init(&SrnConfig::default(), 7, DType::F32, &Device::Cpu).unwrap();
    let named: HashMap<&str, Vec<f64>> =
        srn.parameters.variables.iter().map(|(name, var)| (name.as_str(), values(var))).collect();
    let deviation = |name: &str| {
        let values = &named[name];
        (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
    };
    let largest = |name: &str| named[name].iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    // He: 2 / 256; uniform: within 1 / 16 with a third of its square as variance.
    assert!((deviation("phi.1.weight") / (2f64 / 256.0).sqrt() - 1.0).abs() < 0.02);
    assert!((deviation("phi.0.weight") / (2f64 / 3.0).sqrt() - 1.0).abs() < 0.1);
    assert!((deviation("pixel.5.weight") / (2f64 / 256.0).sqrt() - 1.0).abs() < 0.1);
    assert!((0.06..=1.0 / 16.0).contains(&largest("phi.1.bias")));
    assert!((0.24..=0.25).contains(&largest("lstm.weight_ih")));
    assert!(["lstm.bias_ih", "lstm.bias_hh"].iter().all(|name| named[name][16..32].iter().all(|bias| *bias == 1.0)));
    assert!(named["lstm.bias_ih"][..16].iter().all(|bias| bias.abs() <= 0.25));
    assert!(named["phi.3.scale"].iter().all(|scale| *scale == 1.0) && named["phi.3.shift"].iter().all(|b| *b == 0.0));
}
