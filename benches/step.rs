//! Times one training step at the paper's network size with and without the attack, and the parts of a step. A regularizer's
//! term is timed next to the trunk's own forward and backward pass.
//!
//! A step has 256 rays, 64 + 64 samples, two fields of 8 x 256 and Adam, as a PyTorch implementation's with `--rays 256`.

use std::hint::black_box;
use std::time::Duration;

use augnerf::base::rng::{Random, Stream};
use augnerf::field::Field;
use augnerf::losses::{L1, Laplacian, Tv, WeightedSpaceTerm, regularize};
use augnerf::render::Composite;
use augnerf::render::sampling::{importance, stratified};
use augnerf::render::volume::{composite, composite_reference};
use augnerf::runtime::Runtime;
use augnerf::settings::{Config, Core, DataKind, FieldConfig, Method, RegularizerConfig, Spacing, TrainConfig};
use augnerf::space::chunk_size;
use augnerf::train::{Adam, AdamSettings, Trainer};
use candle_core::{DType, Device, Tensor, Var};
use criterion::{Criterion, criterion_group, criterion_main};
use rayon::prelude::*;

fn step(criterion: &mut Criterion) {
    let runtime = Runtime::new("cpu", None).expect("threads");
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
        config.train.collapse_steps = 0;
        config.train.dead_start_share = 0.0;
        let config = config.resolve(DataKind::Blender, augnerf::bench::EXTENT).expect("valid settings");
        let mut trainer = Trainer::new(&config, &augnerf::bench::scene(), DType::F32, &runtime).expect("a trainer");
        group.bench_function(name, |bencher| bencher.iter(|| black_box(trainer.step(false).expect("a step"))));
    }
    group.finish();
}

/// Times the trunk's value and weight gradients by candle's backward pass, and a regularizer's, at 8,192 points in the same
/// chunks on the same threads.
fn space(criterion: &mut Criterion) {
    let field = Field::init(&FieldConfig::default(), 0, 0, DType::F32, &Device::Cpu).expect("a field");
    let config = RegularizerConfig { points_per_step: 8192, ..RegularizerConfig::default() };
    let points = config.quadrature(0, 0);
    let mut group = criterion.benchmark_group("space");
    group.sample_size(20).warm_up_time(Duration::from_secs(3)).measurement_time(Duration::from_secs(10));
    let plain = |start: usize| {
        let points = points.tensor(start, chunk_size(&Device::Cpu), DType::F32, &Device::Cpu).expect("points");
        let sum = field.raw_density(&points).and_then(|raw| Ok(raw.sum_all()?)).expect("a trunk");
        sum.backward().expect("gradients")
    };
    group.bench_function("trunk", |bencher| {
        bencher.iter(|| {
            (0..8192)
                .step_by(chunk_size(&Device::Cpu))
                .collect::<Vec<usize>>()
                .into_par_iter()
                .map(plain)
                .collect::<Vec<_>>()
        })
    });
    let terms: [(&str, &[WeightedSpaceTerm]); 3] =
        [("l1", &[(&L1, 1.0)]), ("tv", &[(&Tv, 1.0)]), ("tv-laplacian", &[(&Tv, 1.0), (&Laplacian, 1.0)])];
    for (name, terms) in terms {
        group.bench_function(name, |bencher| bencher.iter(|| regularize(&field, &points, terms).expect("terms")));
    }
    group.finish();
}

/// Times the parts of a step with 32 rays of 64 samples and one 8 x 256 field, fused and plain if there are both. One thread,
/// except Adam.
fn parts(criterion: &mut Criterion) {
    const RAYS: usize = 32;
    const SAMPLES: usize = 64;
    let draw = |index: u64, shape: &[usize]| {
        Random::new(0, Stream::Jitter, index).uniform_tensor(shape, DType::F32, &Device::Cpu).expect("numbers")
    };
    let mut group = criterion.benchmark_group("parts");
    group.sample_size(20).warm_up_time(Duration::from_secs(1)).measurement_time(Duration::from_secs(5));
    let points = draw(0, &[RAYS * SAMPLES, 3]);
    let viewdirs = draw(1, &[RAYS, 3]);
    for (name, core) in [("fused", Core::Fused), ("plain", Core::Plain)] {
        let config = FieldConfig { core, ..FieldConfig::default() };
        let field = Field::init(&config, 0, 0, DType::F32, &Device::Cpu).and_then(|field| field.prepared());
        let field = field.expect("a field");
        let asked = |field: &Field, points: &Tensor| {
            let raw = field.forward(points, &viewdirs, None).expect("a pass");
            let sum = (raw.rgb.sum_all().expect("a sum") + raw.density.sum_all().expect("a sum")).expect("a sum");
            sum.backward().expect("gradients")
        };
        let frozen = field.frozen().expect("a field");
        group.bench_function(format!("field-forward-{name}"), |bencher| {
            bencher.iter(|| frozen.forward(&points, &viewdirs, None).expect("a pass"))
        });
        let moving = Var::from_tensor(&points).expect("a variable");
        group.bench_function(format!("field-search-{name}"), |bencher| bencher.iter(|| asked(&frozen, &moving)));
        let recording = field.recording().expect("a field");
        group.bench_function(format!("field-train-{name}"), |bencher| bencher.iter(|| asked(&recording, &points)));
    }
    let t_vals = stratified((2.0, 6.0), Spacing::Depth, RAYS, SAMPLES, Some(&draw(2, &[RAYS, SAMPLES])), &points)
        .expect("samples");
    let rgb = Var::from_tensor(&draw(3, &[RAYS, SAMPLES, 3])).expect("a variable");
    let density = Var::from_tensor(&draw(4, &[RAYS, SAMPLES])).expect("a variable");
    let norm = Tensor::ones((RAYS, 1), DType::F32, &Device::Cpu).expect("ones");
    type Composited = fn(&Tensor, &Tensor, &Tensor, &Tensor, Option<[f32; 3]>) -> augnerf::base::Result<Composite>;
    for (name, composited) in [("scan", composite as Composited), ("plain", composite_reference)] {
        group.bench_function(format!("composite-{name}"), |bencher| {
            bencher.iter(|| {
                let out = composited(&rgb, &density, &t_vals, &norm, None).expect("a composite");
                out.rgb.sum_all().and_then(|sum| sum.backward()).expect("gradients")
            })
        });
    }
    let u = draw(5, &[RAYS, SAMPLES]);
    group.bench_function("importance", |bencher| bencher.iter(|| importance(&t_vals, &density, &u).expect("samples")));
    let field = Field::init(&FieldConfig::default(), 0, 0, DType::F32, &Device::Cpu).expect("a field");
    let gradients: Vec<Option<Tensor>> = field.variables().iter().map(|(_, var)| Some(draw(6, var.dims()))).collect();
    let mut adam = Adam::new(AdamSettings::of(&TrainConfig::default()), field.variables().to_vec()).expect("moments");
    group.bench_function("adam", |bencher| bencher.iter(|| adam.update(&gradients, 1e-6, 1).expect("an update")));
    group.finish();
}

criterion_group!(benches, step, space, parts);
criterion_main!(benches);
