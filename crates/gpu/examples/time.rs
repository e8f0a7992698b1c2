//! Times steps of NeRF and Aug-NeRF of a size on a device, and each kernel by timestamps.
//!
//! ```text
//! cargo run --release -p augnerf-gpu --example time -- [gpu number] [STEPS] [SETTING=VALUE ...]
//! ```

use std::time::Instant;

use augnerf_core::base::Image;
use augnerf_core::data::{Camera, Scene, View};
use augnerf_core::methods::FieldLearner;
use augnerf_core::runtime::Accelerator as _;
use augnerf_core::settings::{DataKind, Extent, build, parse_assignment};
use augnerf_gpu::{Gpu, Steps};
use candle_core::{DType, Device};

fn scene() -> Scene {
    let camera = Camera {
        width: 64,
        height: 64,
        focal: [80.0, 80.0],
        centre: [32.0, 32.0],
        pose: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 4.0]],
    };
    let pixels = (0..64 * 64 * 3).map(|i| (i * 7919 % 256) as f32 / 255.0).collect();
    let image = Image { width: 64, height: 64, channels: 3, pixels };
    Scene {
        name: "noise".into(),
        kind: "blender",
        train: vec![View { name: "noise".into(), camera, image: image.into(), depth: None, mask: None }],
        test: vec![],
        near: 2.0,
        far: 6.0,
        ndc: None,
        background: None,
        path: vec![],
        corrupted: None,
        space: Default::default(),
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let index = arguments.next().map_or(0, |text| text.parse().unwrap_or(0));
    let count: u64 = arguments.next().map_or(10, |text| text.parse().unwrap_or(10));
    let own = ["field.init=torch", "train.dead_start_share=0", "train.rays=1024", "train.precrop_steps=0"];
    let given: Vec<String> = own.iter().map(ToString::to_string).chain(arguments).collect();
    let settings = given.iter().map(|text| parse_assignment(text)).collect::<Result<Vec<_>, _>>()?;
    let config = build(None, None, &settings)?;
    let config = config.resolve(DataKind::Blender, Extent { near: 2.0, far: 6.0, domain: None, pixels: 64 })?;
    let (scene, gpu) = (scene(), Gpu::open(index)?);
    println!("{}: {}", gpu.description(), given[4..].join(" "));
    let (learner, _) = FieldLearner::start(&config, &scene, DType::F32, &Device::Cpu)?;
    let started = Instant::now();
    let mut steps = Steps::new(&gpu, &config, &scene, learner.fields(), None)?;
    println!("ready after {:.2} s", started.elapsed().as_secs_f64());
    let mut seconds = Vec::new();
    for step in 0..count + 3 {
        let started = Instant::now();
        let report = steps.step(step, step + 1, 5e-4, false)?;
        seconds.push(started.elapsed().as_secs_f64());
        if step == count + 2 {
            println!("loss {:.5} after {} steps", report.loss, step + 1);
        }
    }
    let mut timed = seconds.split_off(3);
    timed.sort_by(f64::total_cmp);
    let (dispatches, multiply_adds, sent) = steps.work();
    let median = timed[timed.len() / 2];
    println!(
        "{:.3} ms a step (first {:.1} ms), {dispatches} dispatches, {:.1} GFLOP, {:.2} TFLOP/s, {sent} bytes sent",
        1e3 * median,
        1e3 * seconds[0],
        2e-9 * multiply_adds,
        2e-12 * multiply_adds / median
    );
    let mut sum = 0.0;
    for (name, milliseconds, count) in steps.profile(0)? {
        println!("  {name:16} {milliseconds:9.3} ms  {count} dispatches");
        sum += milliseconds;
    }
    println!("  {:16} {sum:9.3} ms", "sum");
    Ok(())
}
