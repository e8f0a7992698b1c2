//! Density, its gradient and colour at points against the host's.

mod common;

use augnerf_nerf::field::{Density, FieldDensity};
use augnerf_nerf::losses::{measure, measure_density};
use augnerf_nerf::runtime::Accelerator;
use augnerf_nerf::space::{Lattice, densities};
use candle_core::{Device, Tensor};
use common::{config, flat, gpu, scene, start};

/// Points in and around the boxes of these fields, more than a device takes at once.
fn points() -> Tensor {
    let values = (0..3 * 5000).map(|i| 0.9 * (0.37 * i as f32).sin()).collect();
    Tensor::from_vec(values, (5000, 3), &Device::Cpu).unwrap()
}

fn compare(settings: &[&str]) {
    let (config, scene) = (config(settings), scene());
    let learner = start(&config, &scene);
    let field = learner.fields().evaluated();
    let (host, device) = (FieldDensity::new(field).unwrap(), gpu().density(field).unwrap());
    let (points, variance) = (points(), [0.0; 3]);
    let views = points.broadcast_div(&points.sqr().unwrap().sum_keepdim(1).unwrap().sqrt().unwrap()).unwrap();
    let near = |found: &Tensor, expected: &Tensor, what: &str| {
        let (found, expected) = (flat(found), flat(expected));
        let largest = expected.iter().fold(0f64, |largest, x| largest.max(x.abs()));
        assert!(largest > 1e-3, "{what} is {largest}");
        let difference = found.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        println!("{what}: {:.1e} of {largest:.2}", difference / largest);
        assert!(difference < 2e-5 * largest, "{what}: {difference} of {largest}");
    };
    near(&device.density(&points, variance).unwrap(), &host.density(&points, variance).unwrap(), "density");
    near(&device.gradient(&points, variance).unwrap(), &host.gradient(&points, variance).unwrap(), "gradient");
    near(&device.rgb(&points, variance, &views).unwrap(), &host.rgb(&points, variance, &views).unwrap(), "rgb");
    let lattice = Lattice { domain: [[-0.6; 3], [0.7; 3]], side: 17 };
    let all = |density: &dyn Density| {
        let mut all = Vec::new();
        densities(density, &lattice, |part| {
            all.extend(part);
            Ok(())
        })
        .unwrap();
        Tensor::new(all, &Device::Cpu).unwrap()
    };
    near(&all(&*device), &all(&host), "densities of a grid");
    let mut measured = 0;
    let found = measure_density(&*device, &lattice, |cells| measured += cells).unwrap();
    let expected = measure(field, &lattice, |_| ()).unwrap();
    assert_eq!(measured, lattice.cells());
    assert!((found.l1 / expected.l1 - 1.0).abs() < 1e-5 && (found.tv / expected.tv - 1.0).abs() < 1e-5);
    assert!((found.largest_density / expected.largest_density - 1.0).abs() < 1e-5);
    assert_eq!((found.occupied, found.laplacian), (expected.occupied, None));
}

#[test]
fn nerf() {
    compare(&["method=nerf", "field.rgb_padding=0.01"]);
}

#[test]
fn hash_in_a_box() {
    compare(&["method=nerf", "field.encoding=hash", "field.hash.bounds=[[-0.5,-0.4,-0.3],[0.5,0.6,0.7]]"]);
}

#[test]
fn hash_in_a_ball() {
    compare(&[
        "method=nerf",
        "field.encoding=hash",
        "field.hash.interpolation=smoothstep",
        "field.hash.contraction=ball",
        "field.hash.bounds=[[-0.5,-0.4,-0.3],[0.5,0.6,0.7]]",
        "field.density_activation=exp",
    ]);
}
