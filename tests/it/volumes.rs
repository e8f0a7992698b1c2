//! Neural Volumes through the trainer and through everything that is done with a run.

use std::path::Path;
use std::sync::OnceLock;

use crate::common::files::{assert_same_files, json, text};
use crate::common::program::{refuse, succeed};
use crate::common::{flat, runtime, tiny_config, tiny_scene};
use augnerf::data::{RayBuffer, RayParts};
use augnerf::methods::{NeuralVolume, Painter, VolumePainter};
use augnerf::runtime::Runtime;
use augnerf::settings::{Method, PixelOrigin, Resolved, VolumeCode, VolumeConfig};
use augnerf::train::Trainer;
use candle_core::{DType, Device};
use tempfile::TempDir;

/// Of a run, what need not repeat: clocks, locks and event files.
const FLEETING: [&str; 3] = ["timing.json", "run.lock", "tensorboard"];

/// A run of a second on the embedded scene, with a checkpoint every 20 steps of 40, both of which are kept.
const SMALL: &str = "data.width=16 nv.resolution=16 nv.divide=16 nv.warp_resolution=4 nv.code=variational train.rays=64 \
    train.steps=40 train.checkpoint_every=20 train.keep_checkpoints=2 eval.pictures=1";

fn train(out: &Path, threads: &str) {
    let set = SMALL.split_whitespace().flat_map(|setting| ["--set", setting]);
    let run = ["train", "--quiet", "--preset", "smoke", "--method", "nv", "--threads", threads, "--out"];
    succeed(&run.into_iter().chain([out.to_str().unwrap()]).chain(set).collect::<Vec<_>>());
}

/// One run for the tests that only read it.
fn small() -> &'static Path {
    static RUN: OnceLock<(TempDir, std::path::PathBuf)> = OnceLock::new();
    let (_, run) = RUN.get_or_init(|| {
        let dir = TempDir::new().unwrap();
        let out = dir.path().join("run");
        train(&out, "1");
        (dir, out)
    });
    run
}

fn tiny(code: VolumeCode) -> Resolved {
    tiny_config(Method::Nv, |config| {
        config.nv = VolumeConfig { code, resolution: 16, divide: 16, warp_resolution: 4, ..VolumeConfig::default() };
    })
}

/// f32 by operations of our own and f64 by the same or candle's take the same steps.
#[test]
fn steps_in_f32_are_those_of_f64() {
    for code in [VolumeCode::Fixed, VolumeCode::Variational] {
        let steps = |dtype: DType| -> Vec<[f64; 3]> {
            let mut trainer = Trainer::new(&tiny(code), &tiny_scene(), dtype, runtime()).unwrap();
            let step = |_| {
                let stats = trainer.step(true).unwrap();
                [stats.loss, stats.mse, stats.term("mean_acc").unwrap()]
            };
            (0..4).map(step).collect()
        };
        for (single, double) in steps(DType::F32).iter().zip(steps(DType::F64)) {
            for (a, b) in single.iter().zip(double) {
                assert!((a - b).abs() < 2e-3 * b.abs(), "{code:?}: {single:?} {double:?}");
            }
        }
    }
}

#[test]
fn steps_are_the_same_with_any_number_of_threads() {
    let parameters = |threads: usize| -> Vec<f64> {
        let runtime = Runtime::new("cpu", Some(threads)).unwrap();
        let mut trainer = Trainer::new(&tiny(VolumeCode::Fixed), &tiny_scene(), DType::F32, &runtime).unwrap();
        (0..3).for_each(|_| drop(trainer.step(false).unwrap()));
        trainer.model().variables().iter().flat_map(|(_, var)| flat(var)).collect()
    };
    let one = parameters(1);
    assert!(one == parameters(2) && one == parameters(3));
}

/// A picture: colours from 0 to 1, distances between where rays enter the box and where they leave it, in steps of `directions`.
#[test]
fn pictures_are_of_the_box() {
    let (config, scene) = (tiny(VolumeCode::Fixed), tiny_scene());
    let camera = &scene.train[0].camera;
    let pixels: Vec<_> = (0..16).map(|i| (camera, i, 15 - i)).collect();
    let rays = RayBuffer::new(&pixels, None, PixelOrigin::Corner, RayParts::default());
    let volume = NeuralVolume::init(&config, DType::F32, &Device::Cpu).unwrap();
    let painter = VolumePainter::new(&volume, &config, &scene).unwrap();
    let painted = painter.paint(&rays.to_tensors(DType::F32, &Device::Cpu).unwrap()).unwrap();
    let [rgb, depth, acc] = [painted.rgb, painted.depth, painted.acc].map(|tensor| flat(&tensor));
    assert!(rgb.iter().all(|value| (0.0..=1.0).contains(value)), "{rgb:?}");
    // A decoder begins with opacities around ln 2: rays through the box are more than half full.
    assert!(acc.iter().all(|acc| (0.0..=1.0).contains(acc)) && acc.iter().any(|acc| *acc > 0.5), "{acc:?}");
    let half = config.nv.cube().unwrap().1;
    let centre = camera.pose.map(|row| row[3]);
    let distance = centre.iter().map(|at| at * at).sum::<f64>().sqrt();
    for (depth, acc) in depth.iter().zip(&acc).filter(|(_, acc)| **acc > 0.5) {
        let mean = depth / acc;
        assert!(
            mean > 0.5 * (distance - 3f64.sqrt() * half) && mean < distance + 3f64.sqrt() * half,
            "{mean} {distance}"
        );
    }
}

#[test]
fn a_run_that_was_cut_off_ends_as_one_that_was_not() {
    let dir = TempDir::new().unwrap();
    let out = dir.path().join("run");
    train(&out, "3");
    assert_same_files(small(), &out, &FLEETING);
    std::fs::remove_dir_all(out.join("checkpoints/step_000000040")).unwrap();
    succeed(&["resume", "--quiet", "--threads", "2", out.to_str().unwrap()]);
    assert_same_files(small(), &out, &FLEETING);
}

#[test]
fn a_run_has_its_terms_parameters_pictures_and_surface() {
    let run = small();
    let header = text(&run.join("scalars.csv"));
    for column in ["loss_image", "loss_accumulation", "loss_variation", "loss_code", "mean_acc", "psnr"] {
        assert!(header.lines().next().unwrap().split(',').any(|name| name == column), "{column}: {header}");
    }
    let state =
        candle_core::safetensors::load(run.join("checkpoints/step_000000040/state.safetensors"), &Device::Cpu).unwrap();
    for name in ["volume.code", "volume.template.4.weight", "volume.warp.weights.1.bias"] {
        assert!(state.keys().any(|key| key.ends_with(name)), "{name}: {:?}", state.keys());
    }
    let dir = TempDir::new().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    train(&dir.path().join("other"), "2");
    let name = run.to_str().unwrap();
    succeed(&["render", "--quiet", name, "--frames", "1", "--out", &at("path")]);
    succeed(&["compare", "--quiet", name, &at("other"), "--out", &at("compared")]);
    // Opacities have hardly moved from ln 2 per half a side of 2.4.
    succeed(&["mesh", "--quiet", name, "--threshold", "0.541", "--resolution", "12", "--out", &at("mesh")]);
    assert!(std::fs::metadata(dir.path().join("mesh/mesh.ply")).unwrap().len() > 100);
    let metrics = json(&run.join("metrics.json"));
    assert!(metrics["mean"]["psnr"].as_f64().unwrap() > 5.0, "{metrics}");
    assert!(metrics["protocol"]["nv"].as_str().unwrap().starts_with("16^3 from 64 channels, warp 4^3"), "{metrics}");
}

#[test]
fn what_a_volume_cannot_be_asked_is_refused() {
    let run = small().to_str().unwrap();
    refuse(&["measure", run], 2, &["trilinear"]);
    let dir = TempDir::new().unwrap();
    let forward = ["train", "--preset", "smoke", "--method", "nv", "--set", "data.kind=builtin-forward", "--out"];
    let out = dir.path().join("run");
    refuse(&[&forward[..], &[out.to_str().unwrap()]].concat(), 2, &["forward-facing", "bounded box"]);
}
