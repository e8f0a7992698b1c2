//! Seconds of one training step at the paper's network size, plain and with the search, and of a
//! regularizer's term beside the trunk's own forward and backward pass.
//!
//! The same work as a PyTorch implementation's `--rays 256`: 256 rays, 64 + 64 samples, two fields
//! of 8 x 256, Adam.

use std::hint::black_box;
use std::time::Duration;

use augnerf::config::{Config, DataKind, FieldConfig, Method, Regularizer, RegularizerConfig};
use augnerf::field::Field;
use augnerf::regularizers::{CHUNK, Lattice, Points, regularize};
use augnerf::train::Trainer;
use candle_core::{DType, Device};
use criterion::{Criterion, criterion_group, criterion_main};
use rayon::prelude::*;

fn step(criterion: &mut Criterion) {
    augnerf::allocator::keep_freed_memory();
    augnerf::cli::set_threads(None).expect("threads");
    let mut group = criterion.benchmark_group("step");
    group.sample_size(10).warm_up_time(Duration::from_secs(4)).measurement_time(Duration::from_secs(20));
    for (name, method, width) in [
        ("nerf-256", Method::Nerf, 256),
        ("aug-nerf-256", Method::AugNerf, 256),
        ("nerf-64", Method::Nerf, 64),
        ("aug-nerf-64", Method::AugNerf, 64),
    ] {
        let mut config = Config { method, ..Config::default() };
        config.train.rays = 256;
        config.field.width = width;
        config.resolve_kind(DataKind::Blender);
        config.resolve_bounds(2.0, 6.0);
        config.train.collapse_steps = 0;
        config.train.dead_start_share = 0.0;
        let mut trainer = Trainer::new(&config, &augnerf::bench::scene(), DType::F32, &Device::Cpu).expect("a trainer");
        group.bench_function(name, |bencher| bencher.iter(|| black_box(trainer.step(false).expect("a step"))));
    }
    group.finish();
}

/// 8,192 points: the trunk's value and weight gradients by candle's backward pass, and a
/// regularizer's, in the same chunks on the same threads.
fn space(criterion: &mut Criterion) {
    let field = Field::init(&FieldConfig::default(), 0, 0, DType::F32, &Device::Cpu).expect("a field");
    let config = RegularizerConfig { points_per_step: 8192, ..RegularizerConfig::default() };
    let lattice = Lattice { domain: config.domain, side: config.lattice };
    let points = Points::draw(&config, &lattice, 0, 0);
    let mut group = criterion.benchmark_group("space");
    group.sample_size(20).warm_up_time(Duration::from_secs(3)).measurement_time(Duration::from_secs(10));
    let plain = |start: usize| {
        let points = points.tensor(&lattice, start, CHUNK, DType::F32, &Device::Cpu).expect("points");
        let sum = field.raw_density(&points).and_then(|raw| Ok(raw.sum_all()?)).expect("a trunk");
        sum.backward().expect("gradients")
    };
    group.bench_function("trunk", |bencher| {
        bencher.iter(|| (0..8192).step_by(CHUNK).collect::<Vec<usize>>().into_par_iter().map(plain).collect::<Vec<_>>())
    });
    for (name, terms) in [
        ("l1", vec![(Regularizer::L1, 1.0)]),
        ("tv", vec![(Regularizer::Tv, 1.0)]),
        ("tv-laplacian", vec![(Regularizer::Tv, 1.0), (Regularizer::Laplacian, 1.0)]),
    ] {
        group.bench_function(name, |bencher| {
            bencher.iter(|| regularize(&field, &lattice, &points, &terms, (DType::F32, &Device::Cpu)).expect("terms"))
        });
    }
    group.finish();
}

criterion_group!(benches, step, space);
criterion_main!(benches);
