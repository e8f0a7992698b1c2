//! A small scene, its settings and the device.

use std::sync::OnceLock;

use augnerf_base::Image;
use augnerf_gpu::Gpu;
use augnerf_nerf::methods::FieldLearner;
use augnerf_nerf::settings::{DataKind, Extent, Resolved, build, parse_assignment};
use augnerf_scenes::{Camera, Scene, View};
use candle_core::{DType, Device, Tensor};

pub fn gpu() -> &'static Gpu {
    static GPU: OnceLock<Gpu> = OnceLock::new();
    GPU.get_or_init(|| Gpu::open(0).expect("a device; install mesa-vulkan-drivers and libvulkan1"))
}

/// Two views of 16 x 16 of a smooth picture, from two sides.
pub fn scene() -> Scene {
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
        View::new(format!("view {index}"), camera, image)
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
        lacks_split: false,
        space: Default::default(),
    }
}

pub fn config(settings: &[&str]) -> Resolved {
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

/// Starts a learner with tables away from their tiny start, so that a grid has something to say.
pub fn start(config: &Resolved, scene: &Scene) -> FieldLearner {
    let (learner, _) = FieldLearner::start(config, scene, DType::F32, &Device::Cpu).unwrap();
    for (name, var) in learner.fields().variables() {
        if name.ends_with("table") {
            let moved: Vec<f32> = (0..var.elem_count()).map(|i| 0.5 * (i as f32 * 0.7).sin()).collect();
            var.set(&Tensor::from_vec(moved, var.shape(), &Device::Cpu).unwrap()).unwrap();
        }
    }
    learner
}

pub fn flat(tensor: &Tensor) -> Vec<f64> {
    tensor.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1().unwrap()
}
