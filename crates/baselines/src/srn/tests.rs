//! The march, its loss and its gradients against the original modules' numbers, closed forms and finite differences.

mod march;

use std::collections::HashMap;

use candle_core::{DType, Device, Tensor, Var};

use crate::data::{Camera, Rays};
use crate::methods::Gradients;
use crate::settings::SrnConfig;

use super::cell::Lstm;
use super::network::{Srn, SrnMarch};
use super::step::{Sums, Weights};

/// Six rays of two cameras; what the original's loss weighs its terms with.
const RAYS: usize = 6;
const WEIGHTS: Weights = Weights { image: 200.0 / (3.0 * RAYS as f64), depth: 10.0 / RAYS as f64 };

/// `tests/fixtures/baselines.safetensors`, in f64.
struct Fixture(HashMap<String, Tensor>);

impl Fixture {
    fn load() -> Fixture {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/fixtures/baselines.safetensors");
        Fixture(candle_core::safetensors::load(path, &Device::Cpu).unwrap())
    }

    fn get(&self, name: &str) -> Tensor {
        let tensor = self.0.get(&format!("srn.{name}")).unwrap_or_else(|| panic!("srn.{name} is not there"));
        tensor.to_dtype(DType::F64).unwrap()
    }

    fn config(&self) -> SrnConfig {
        SrnConfig { width: 8, ..SrnConfig::default() }
    }

    fn srn(&self) -> Srn {
        let names = Srn::parameter_names(&self.config()).into_iter().map(|(name, _)| name);
        Srn::from_parameters(&self.config(), names.map(|name| self.get(&name)).collect()).unwrap()
    }

    fn rays(&self) -> Rays {
        Rays::new(self.get("o"), self.get("d"), self.get("u")).unwrap()
    }

    fn march(&self, srn: &Srn) -> SrnMarch {
        srn.march(&self.rays(), &self.get("z0")).unwrap()
    }

    /// Loss of a step with `factor` times its weights, and its gradients.
    fn step(&self, srn: &Srn, factor: f64) -> (Sums, f64) {
        let weights = Weights { image: WEIGHTS.image * factor, depth: WEIGHTS.depth * factor };
        let mut sums = Sums::new(None, srn);
        let target: Vec<f32> = values(&self.get("target")).into_iter().map(|value| value as f32).collect();
        sums.add_plain(srn, &self.march(srn), &target, weights).unwrap();
        let loss = weights.image * sums.image + weights.depth * sums.behind;
        (sums, loss)
    }
}

fn values(tensor: &Tensor) -> Vec<f64> {
    tensor.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1().unwrap()
}

/// Demands numbers to `tolerance` of the largest of them.
#[track_caller]
fn assert_near(name: &str, found: &Tensor, expected: &Tensor, tolerance: f64) {
    assert_eq!(found.elem_count(), expected.elem_count(), "{name}");
    let (found, expected) = (values(found), values(expected));
    let largest = expected.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    for (found, expected) in found.iter().zip(&expected) {
        assert!((found - expected).abs() <= tolerance * largest, "{name}: {found}, not {expected}");
    }
}

#[test]
fn the_march_is_the_original_modules() {
    let fixture = Fixture::load();
    let march = fixture.march(&fixture.srn());
    assert_near("z", &march.z, &fixture.get("z"), 1e-12);
    assert_near("colour", &march.colour, &fixture.get("colour"), 1e-12);
}

#[test]
fn the_loss_and_its_gradients_are_the_original_modules() {
    let fixture = Fixture::load();
    let srn = fixture.srn();
    let (sums, loss) = fixture.step(&srn, 1.0);
    let scalar = |name: &str| values(&fixture.get(name))[0];
    let near = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-12 * expected, "{found} {expected}");
    near(sums.image / (3 * RAYS) as f64, scalar("image_loss"));
    near(1e4 * sums.behind / RAYS as f64, scalar("depth_loss"));
    near(loss, scalar("loss"));
    let Gradients(found) = sums.gradients(&srn).unwrap();
    for ((name, _), found) in srn.parameters.variables.iter().zip(found) {
        assert_near(name, &found.unwrap(), &fixture.get(&format!("grad.{name}")), 1e-10);
    }
}

/// With 64 times the loss the gradient at some outputs of the cell is beyond 10.
#[test]
fn gradients_at_the_cells_outputs_are_cut_as_in_the_original() {
    let fixture = Fixture::load();
    let srn = fixture.srn();
    let Gradients(found) = fixture.step(&srn, 64.0).0.gradients(&srn).unwrap();
    let mut cut = 0;
    for ((name, _), found) in srn.parameters.variables.iter().zip(found) {
        if !(name.starts_with("phi.") || name.starts_with("lstm.")) {
            continue;
        }
        let expected = fixture.get(&format!("clamped64.grad.{name}"));
        let free = (fixture.get(&format!("grad.{name}")) * 64.0).unwrap();
        cut += values(&expected).iter().zip(values(&free)).filter(|(a, b)| (**a - b).abs() > 1e-3 * b.abs()).count();
        assert_near(name, &found.unwrap(), &expected, 1e-10);
    }
    assert!(cut > 100, "{cut} gradients differ");
}

#[test]
fn the_cell_is_pytorchs() {
    let fixture = Fixture::load();
    let names = ["x", "h", "c", "weight_ih", "weight_hh", "bias_ih", "bias_hh"];
    let all = names.map(|name| Var::from_tensor(&fixture.get(&format!("cell.{name}"))).unwrap());
    let [x, h, c, weight_ih, weight_hh, bias_ih, bias_hh] = all.each_ref().map(Var::as_tensor);
    let (h, c) = Lstm { weight_ih, weight_hh, bias_ih, bias_hh }.apply(x, (h, c), true).unwrap();
    let out = Tensor::cat(&[h, c], 1).unwrap();
    assert_near("out", &out, &fixture.get("cell.out"), 1e-12);
    let store = (out * fixture.get("cell.cotangent")).unwrap().sum_all().unwrap().backward().unwrap();
    for (name, var) in names.iter().zip(&all) {
        assert_near(name, store.get(var).unwrap(), &fixture.get(&format!("cell.grad.{name}")), 1e-12);
    }
}

/// Their cameras look along +z with rows downwards, ours along -z with rows upwards.
#[test]
fn rays_of_its_cameras_are_ours() {
    let fixture = Fixture::load();
    let [poses, intrinsics, uv] = ["cam2world", "intrinsics", "uv"].map(|name| values(&fixture.get(name)));
    let (o, d) = (values(&fixture.get("o")), values(&fixture.get("d")));
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

/// The fixture's SRN with other numbers in the step's head.
fn with_head(fixture: &Fixture, weight: f64, bias: f64) -> Srn {
    let value = |(name, var): &(String, Var)| match name.as_str() {
        "head.weight" => (var.as_tensor() * weight).unwrap(),
        "head.bias" => var.affine(0.0, bias).unwrap(),
        _ => var.as_tensor().clone(),
    };
    let values = fixture.srn().parameters.variables.iter().map(value).collect();
    Srn::from_parameters(&fixture.config(), values).unwrap()
}

#[test]
fn a_head_that_says_how_far_leads_there() {
    let fixture = Fixture::load();
    let rays = fixture.rays();
    for length in [0.0, 0.4] {
        let march = fixture.march(&with_head(&fixture, 0.0, length));
        let z = (fixture.get("z0") + (rays.direction_norm.recip().unwrap() * (10.0 * length)).unwrap()).unwrap();
        assert_near("z", &march.z, &z, 1e-14);
    }
}

/// Rays that stand still show what is where they start, however many steps they take.
#[test]
fn a_head_of_zeros_leaves_the_colour() {
    let fixture = Fixture::load();
    let srn = with_head(&fixture, 0.0, 0.0);
    let values = srn.parameters.variables.iter().map(|(_, var)| var.as_tensor().clone()).collect();
    let once = Srn::from_parameters(&SrnConfig { steps: 1, ..fixture.config() }, values).unwrap();
    let (march, expected) = (fixture.march(&srn), fixture.march(&once));
    assert_near("colour", &march.colour, &expected.colour, 1e-14);
}

/// Positions times `scale` are what the network sees: a scene half as large at twice the scale is the same.
#[test]
fn a_scale_is_a_change_of_units() {
    let fixture = Fixture::load();
    let srn = fixture.srn();
    let values = srn.parameters.variables.iter().map(|(_, var)| var.as_tensor().clone()).collect();
    let doubled = Srn::from_parameters(&SrnConfig { scale: 2.0, ..fixture.config() }, values).unwrap();
    let half = Rays { origins: (fixture.get("o") / 2.0).unwrap(), ..fixture.rays() };
    let (march, expected) = (doubled.march(&half, &fixture.get("z0")).unwrap(), fixture.march(&srn));
    assert_near("z", &march.z, &expected.z, 1e-14);
    assert_near("colour", &march.colour, &expected.colour, 1e-14);
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
