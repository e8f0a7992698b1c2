//! Whole steps on a device against the host's, which are checked against f64 and finite differences.

use std::sync::OnceLock;

use augnerf_core::base::Image;
use augnerf_core::data::{Camera, Scene, View};
use augnerf_core::methods::{FieldLearner, Learner};
use augnerf_core::settings::{DataKind, Extent, Resolved, build, parse_assignment};
use augnerf_gpu::{Gpu, Steps};
use candle_core::{DType, Device, Tensor};

fn gpu() -> &'static Gpu {
    static GPU: OnceLock<Gpu> = OnceLock::new();
    GPU.get_or_init(|| Gpu::open(0).expect("a device; install mesa-vulkan-drivers and libvulkan1"))
}

/// Two views of 16 x 16 of a smooth picture, from two sides.
fn scene() -> Scene {
    let view = |index: usize| {
        let shift = 0.4 * index as f64;
        let camera = Camera {
            width: 16,
            height: 16,
            focal: [20.0, 20.0],
            centre: [8.0, 8.0],
            pose: [[1.0, 0.0, 0.0, shift], [0.0, 1.0, 0.0, 0.1], [0.0, 0.0, 1.0, 4.0]],
        };
        let pixel = |i: usize, c: usize| 0.5 + 0.4 * (0.3 * i as f32 + c as f32 + index as f32).sin();
        let pixels = (0..256).flat_map(|i| [pixel(i, 0), pixel(i, 1), pixel(i, 2)]).collect();
        let image = Image { width: 16, height: 16, channels: 3, pixels };
        View { name: format!("view {index}"), camera, image: image.into(), depth: None, mask: None }
    };
    Scene {
        name: "waves".into(),
        kind: "blender",
        train: vec![view(0), view(1)],
        test: vec![],
        near: 2.0,
        far: 6.0,
        ndc: None,
        background: Some([1.0, 0.5, 0.25]),
        path: vec![],
        corrupted: None,
        space: Default::default(),
    }
}

fn config(settings: &[&str]) -> Resolved {
    let small = [
        "train.rays=64",
        "train.chunk=16",
        "sampling.coarse=12",
        "sampling.fine=10",
        "field.width=24",
        "field.depth=4",
        "field.skips=[2]",
        "field.position_octaves=4",
        "field.view_octaves=2",
        "perturb.injection_layer=2",
        "field.init=torch",
        "field.hash.levels=6",
        "field.hash.log2_table=10",
        "field.hash.finest=64",
        "train.dead_start_share=0",
        "field.density_activation=softplus",
    ];
    let all: Vec<_> = small.iter().chain(settings).map(|text| parse_assignment(text).unwrap()).collect();
    let config = build(None, None, &all).unwrap();
    config.resolve(DataKind::Blender, Extent { near: 2.0, far: 6.0, domain: None, pixels: 16 }).unwrap()
}

fn flat(tensor: &Tensor) -> Vec<f64> {
    tensor.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1().unwrap()
}

fn norm(values: impl Iterator<Item = f64>) -> f64 {
    values.map(|x| x * x).sum::<f64>().sqrt()
}

/// Compares losses, gradients and diagnostics of one step.
fn compare(settings: &[&str]) {
    let (config, scene) = (config(settings), scene());
    let (mut learner, _) = FieldLearner::start(&config, &scene, DType::F32, &Device::Cpu).unwrap();
    // Tables away from their tiny start, so that the grid has something to say.
    for (name, var) in learner.fields().variables() {
        if name.ends_with("table") {
            let moved: Vec<f32> = (0..var.elem_count()).map(|i| 0.5 * (i as f32 * 0.7).sin()).collect();
            var.set(&Tensor::from_vec(moved, var.shape(), &Device::Cpu).unwrap()).unwrap();
        }
    }
    let mut steps = Steps::new(gpu(), &config, &scene, learner.fields(), None).unwrap();
    let expected = learner.step(7, true, &|| Ok(())).unwrap();
    let (report, gradients) = steps.gradients(7).unwrap();
    let names: Vec<String> = learner.fields().variables().into_iter().map(|(name, _)| name).collect();
    for (found, expected) in report.terms.iter().zip(&expected.report.terms) {
        assert_eq!(found.name, expected.name);
        let difference = (found.value / expected.value - 1.0).abs();
        println!("{:20} {:.7} {:.7} {difference:.1e}", found.name, found.value, expected.value);
        assert!(difference < 1e-3, "{}: {} against {}", found.name, found.value, expected.value);
    }
    assert_eq!(report.terms.len(), expected.report.terms.len());
    let mut worst = 0f64;
    for ((name, found), expected) in names.iter().zip(&gradients).zip(&expected.gradients.0) {
        let expected = expected.as_ref().map_or_else(|| vec![0.0; found.elem_count()], flat);
        let found = flat(found);
        let difference = norm(found.iter().zip(&expected).map(|(a, b)| a - b)) / norm(expected.iter().copied()).max(1e-12);
        worst = worst.max(difference);
        println!("{name:28} {difference:.1e}  norm {:.3e}", norm(expected.iter().copied()));
    }
    let (logged, expected_sites) = (steps.try_step(7, true).unwrap(), expected.report.sites);
    for (found, expected) in logged.sites.iter().zip(&expected_sites) {
        println!("{found:?}\n{expected:?}");
    }
    assert!(worst < 5e-3, "gradients differ by {worst:.1e}");
    assert_eq!(logged.sites.len(), expected_sites.len());
}

#[test]
fn nerf() {
    compare(&["method=nerf"]);
}

#[test]
fn nerf_on_a_hash_grid() {
    compare(&["method=nerf", "field.encoding=hash"]);
}

#[test]
fn aug_nerf() {
    compare(&["method=aug-nerf", "perturb.attack=calibrated"]);
}

#[test]
fn aug_nerf_on_a_hash_grid() {
    compare(&["method=aug-nerf", "perturb.attack=calibrated", "field.encoding=hash"]);
}
