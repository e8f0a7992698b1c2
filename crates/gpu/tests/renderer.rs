//! Views rendered on a device against the host's.

mod common;

use augnerf_nerf::methods::{FieldRenderer, Renderer};
use augnerf_nerf::runtime::Accelerator;
use augnerf_nerf::settings::PixelOrigin;
use augnerf_scenes::RayBuffer;
use candle_core::{DType, Device, Tensor};
use common::{config, flat, gpu, scene, start};

/// Renders all pixels of a view both ways. Returns the largest differences of colour, depth and accumulation.
fn differences(settings: &[&str]) -> [f64; 3] {
    let (config, scene) = (config(settings), scene());
    let learner = start(&config, &scene);
    let fields = learner.fields().at_step(&config, 3).unwrap();
    let camera = &scene.train[0].camera;
    let pixels: Vec<_> = (0..16).flat_map(|y| (0..16).map(move |x| (camera, x, y))).collect();
    let renderer = gpu().renderer(&fields, &config, &scene).unwrap();
    let rays = RayBuffer::new(&pixels, None, PixelOrigin::Corner, renderer.ray_parts());
    let rays = rays.to_tensors(DType::F32, &Device::Cpu).unwrap();
    let on_host = FieldRenderer::new(&fields, &config, &scene).unwrap().render(&rays).unwrap();
    let found = renderer.render(&rays).unwrap();
    let largest = |a: &Tensor, b: &Tensor| {
        let pairs = flat(a).into_iter().zip(flat(b));
        // What is not a number is larger than all.
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, |m: f64, d| if d <= m { m } else { d })
    };
    assert_eq!(found.rgb.dims(), [256, 3]);
    [largest(&found.rgb, &on_host.rgb), largest(&found.depth, &on_host.depth), largest(&found.acc, &on_host.acc)]
}

/// Thin air, in which a ray's weights add up to far less than 1, and a solid.
#[test]
fn views_are_the_hosts() {
    for density in ["relu", "softplus", "exp"] {
        for encoding in ["positional", "hash"] {
            let settings =
                ["method=nerf", &format!("field.density_activation={density}"), &format!("field.encoding={encoding}")];
            let [rgb, depth, acc] = differences(&settings);
            println!("{density:10} {encoding:10} {rgb:.1e} {depth:.1e} {acc:.1e}");
            assert!(rgb < 2e-4 && depth < 2e-3 && acc < 2e-4, "{settings:?}: {rgb:.1e} {depth:.1e} {acc:.1e}");
        }
    }
}

#[test]
fn views_of_fields_that_open_are_the_hosts() {
    for encoding in ["positional", "hash"] {
        let settings = ["method=nerf", &format!("field.encoding={encoding}"), "field.frequency_steps=8"];
        let [rgb, depth, acc] = differences(&settings);
        assert!(rgb < 2e-4 && depth < 2e-3 && acc < 2e-4, "{encoding}: {rgb:.1e} {depth:.1e} {acc:.1e}");
    }
}

#[test]
fn views_of_mip_nerf_are_the_hosts() {
    let [rgb, depth, acc] = differences(&["method=mip-nerf"]);
    assert!(rgb < 2e-4 && depth < 2e-3 && acc < 2e-4, "{rgb:.1e} {depth:.1e} {acc:.1e}");
}

#[test]
fn views_of_a_coarse_field_alone_are_the_hosts() {
    let [rgb, depth, acc] = differences(&["method=nerf", "sampling.fine=0"]);
    assert!(rgb < 1e-5 && depth < 1e-4 && acc < 1e-5, "{rgb:.1e} {depth:.1e} {acc:.1e}");
}
