//! Scene Representation Networks through the trainer and through everything that is done with a run.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use crate::common::files::{json, text};
use crate::common::learning::{Small, assert_learns, assert_precisions_agree, assert_threads_agree};
use crate::common::program::{refuse, succeed};
use crate::common::reference::Reference;
use crate::common::{flat, tiny_config, tiny_scene};
use augnerf::data::{RayBuffer, RayParts};
use augnerf::methods::{Model, Renderer, Srn, SrnRenderer};
use augnerf::runtime::Runtime;
use augnerf::settings::{Method, PixelOrigin, Representation, Resolved, SrnConfig};
use augnerf::train::{Adam, AdamSettings};
use candle_core::{DType, Device, Tensor, Var};
use tempfile::TempDir;

const SMALL: Small = Small { method: "srn", settings: "srn.width=24 train.chunk=16" };

/// One run for the tests that only read it.
fn small() -> &'static Path {
    static RUN: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    &RUN.get_or_init(|| SMALL.once()).1
}

fn tiny() -> Resolved {
    tiny_config(Method::Srn, |config| {
        config.srn = SrnConfig { width: 48, ..SrnConfig::default() };
        config.train.chunk = 16;
    })
}

/// One update at the original's rate, from its gradients.
#[test]
fn adam_takes_the_originals_step() {
    let reference = Reference::load("baselines");
    let wide = |name: String| reference.get(&name).to_dtype(DType::F64).unwrap();
    let names = Srn::parameter_names(&SrnConfig { width: 8, ..SrnConfig::default() });
    let variables: Vec<(String, Var)> = names
        .into_iter()
        .map(|(name, _)| (name.clone(), Var::from_tensor(&wide(format!("srn.{name}"))).unwrap()))
        .collect();
    let gradients: Vec<Option<Tensor>> =
        variables.iter().map(|(name, _)| Some(wide(format!("srn.grad.{name}")))).collect();
    let mut adam =
        Adam::new(AdamSettings { beta2: 0.999, epsilon: 1e-8, weight_decay: 0.0 }, variables.clone()).unwrap();
    adam.update(&gradients, 5e-5, 1).unwrap();
    for (name, var) in &variables {
        for (found, expected) in flat(var).into_iter().zip(reference.values(&format!("srn.adam.{name}"))) {
            assert!((found - expected).abs() < 1e-12, "{name}: {found}, not {expected}");
        }
    }
}

#[test]
fn steps_lower_the_error() {
    assert_learns(&(tiny(), tiny_scene()), 150, 0.5);
}

/// f32 on packed weights and f64 in candle's operations.
#[test]
fn steps_are_the_same_in_both_precisions_and_with_any_number_of_threads() {
    assert_precisions_agree(&tiny(), "depth_deviation");
    assert_threads_agree(&tiny());
}

/// A picture is the march's end from one depth: opaque, colours from 0 to 1, depths along the camera's axis.
#[test]
fn pictures_in_f32_are_those_of_f64() {
    let scene = tiny_scene();
    let camera = &scene.train[0].camera;
    let pixels: Vec<_> = (0..16).map(|i| (camera, i, 15 - i)).collect();
    let rays = RayBuffer::new(&pixels, None, PixelOrigin::Corner, RayParts::default());
    let config = SrnConfig { width: 48, scale: 1.5, ..SrnConfig::default() };
    let single = Srn::init(&config, 4, DType::F32, &Device::Cpu).unwrap();
    let wide = single.variables().iter().map(|(_, var)| var.to_dtype(DType::F64).unwrap()).collect();
    let double = Srn::from_parameters(&config, wide).unwrap();
    let render = |srn: &Srn, dtype: DType| {
        let rendered = SrnRenderer::new(srn).unwrap().render(&rays.to_tensors(dtype, &Device::Cpu).unwrap()).unwrap();
        [rendered.rgb, rendered.depth, rendered.acc].map(|tensor| flat(&tensor))
    };
    let (single, double) = (render(&single, DType::F32), render(&double, DType::F64));
    for (single, double) in single.iter().zip(&double) {
        assert!(single.iter().zip(double).all(|(a, b)| (a - b).abs() < 1e-4), "{single:?} {double:?}");
    }
    let [rgb, depth, acc] = double;
    assert!(rgb.iter().all(|value| (0.0..=1.0).contains(value)) && acc.iter().all(|acc| *acc == 1.0));
    assert!(depth.iter().any(|z| (z - config.start_depth / config.scale).abs() > 1e-3), "{depth:?}");
}

#[test]
fn a_run_that_was_cut_off_ends_as_one_that_was_not() {
    SMALL.assert_resumes(small());
}

#[test]
fn a_run_has_its_terms_parameters_and_pictures() {
    let run = small();
    let header = text(&run.join("scalars.csv"));
    for column in ["loss_image", "loss_depth", "depth_deviation", "psnr"] {
        assert!(header.lines().next().unwrap().split(',').any(|name| name == column), "{column}: {header}");
    }
    let state =
        candle_core::safetensors::load(run.join("checkpoints/step_000000040/state.safetensors"), &Device::Cpu).unwrap();
    for name in ["phi.0.weight", "phi.3.scale", "lstm.weight_hh", "head.bias", "pixel.5.bias"] {
        assert!(state.keys().any(|key| key.ends_with(name)), "{name}: {:?}", state.keys());
    }
    let dir = TempDir::new().unwrap();
    let [other, path, compared] = ["other", "path", "compared"].map(|name| dir.path().join(name));
    SMALL.train(&other, "2");
    let [run_name, other, path, compared] = [run, &other, &path, &compared].map(|path| path.to_str().unwrap());
    succeed(&["render", "--quiet", run_name, "--frames", "1", "--out", path]);
    succeed(&["compare", "--quiet", run_name, other, "--out", compared]);
    let metrics = json(&run.join("metrics.json"));
    assert!(metrics["mean"]["psnr"].as_f64().unwrap() > 5.0, "{metrics}");
    assert!(metrics["protocol"]["learning_rate"].as_str().unwrap().ends_with(", constant"), "{metrics}");
    assert!(metrics["protocol"]["srn"].as_str().unwrap().starts_with("width 24, 4 + 5 layers, 10 steps"), "{metrics}");
}

#[test]
fn what_an_srn_cannot_say_is_refused() {
    let (_dir, run) = SMALL.once();
    let run = run.to_str().unwrap();
    refuse(&["mesh", run], 2, &["an SRN knows where a ray ends"]);
    refuse(&["mesh", run, "--chamfer", "builtin"], 2, &["an SRN knows where a ray ends"]);
    refuse(&["eval", "--smoothness", run], 2, &["an SRN knows where a ray ends"]);
    let model = Model::Baseline(
        Representation::Srn,
        Arc::new(Srn::init(&SrnConfig::default(), 0, DType::F32, &Device::Cpu).unwrap()),
    );
    assert!(
        !model.has_density()
            && model.density(&Runtime::new("cpu", Some(1)).unwrap()).is_err()
            && model.fields().is_err()
    );
}
