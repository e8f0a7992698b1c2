//! Each kernel against the same in f64. A table of differences is printed with `--nocapture`.

use augnerf_base::rng::{Random, Stream};
use augnerf_nerf::field::hash::{Domain, HashGrid, Vertex};
use augnerf_nerf::field::{encode, encode_integrated};
use augnerf_nerf::optimizer::{Adam, AdamSettings};
use augnerf_nerf::render::gaussians_at;
use augnerf_nerf::render::sampling::importance;
use augnerf_nerf::render::volume::composite_reference;
use augnerf_nerf::settings::{Contraction, Interpolation};
use augnerf_scenes::{Footprint, Rays};
use candle_core::{DType, Device, Tensor, Var};
use wgpu::Buffer;

use super::*;
use crate::device::{Gpu, groups};
use crate::params::Params;
use crate::rays::RAY;
use crate::record::{FIRST_TERM, FIXED_SCALE, ON_RAYS, OUT, SLOT, domain_params, grid_params};

mod encodings;
#[path = "../../../../fast/src/hash/tests/reference.rs"]
mod hash_reference;
mod outputs;
mod products;
mod rays;
mod sets;
mod updates;

pub(super) use products::{EMULATED, without_matrix_units};

fn gpu() -> Gpu {
    Gpu::open(0).expect("a device; install mesa-vulkan-drivers and libvulkan1")
}

/// Numbers between -size and size that no pattern of a kernel matches.
fn numbers(count: usize, size: f64, seed: u64) -> Vec<f32> {
    let mut random = Random::new(seed, Stream::Init, 0);
    (0..count).map(|_| (size * (2.0 * random.uniform() - 1.0)) as f32).collect()
}

fn wide(values: &[f32], shape: &[usize]) -> Tensor {
    Tensor::from_vec(values.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>(), shape, &Device::Cpu).unwrap()
}

fn var(values: &[f32], shape: &[usize]) -> Var {
    Var::from_tensor(&wide(values, shape)).unwrap()
}

fn flat(tensor: &Tensor) -> Vec<f64> {
    tensor.flatten_all().unwrap().to_vec1().unwrap()
}

fn run(gpu: &Gpu, kernel: Kernel, params: Params, buffers: &[(u32, &Buffer)], size: [u32; 3]) {
    gpu.submit(&[gpu.dispatch(&kernel, &params, buffers, size)]);
}

/// Compares by the norm of the difference over that of the reference.
#[track_caller]
fn near(kernel: &str, found: &[f32], expected: &[f64], allowed: f64) {
    assert_eq!(found.len(), expected.len());
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>().sqrt();
    let difference = norm(&mut found.iter().zip(expected).map(|(a, b)| f64::from(*a) - b));
    let relative = difference / norm(&mut expected.iter().copied());
    println!("{kernel:28} {relative:.1e}");
    assert!(relative < allowed, "{kernel}: {relative:.1e}");
}

#[test]
fn every_kernel_is_in_a_test() {
    let tests = [
        include_str!("encodings.rs"),
        include_str!("outputs.rs"),
        include_str!("products.rs"),
        include_str!("rays.rs"),
        include_str!("sets.rs"),
        include_str!("updates.rs"),
    ];
    for name in NAMES.iter().chain(&["product", "product_back", "weights"]) {
        let quoted = format!("(\"{name}\")");
        assert!(tests.iter().any(|text| text.contains(&quoted)), "kernel {name}");
    }
}
