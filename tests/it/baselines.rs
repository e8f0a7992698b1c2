//! SRN, Neural Volumes and LLFF through the trainer and through everything that is done with a run: steps that lower the error,
//! and runs that end as they would have without a stop.

use crate::common::files::{FLEETING, assert_same_files, rows};
use crate::common::program::{Place, set};
use crate::common::{built, runtime, tiny_config, tiny_scene};
use augnerf::data::Scene;
use augnerf::run::load_scene;
use augnerf::settings::{Method, Resolved, SrnConfig};
use augnerf::train::Trainer;
use candle_core::{DType, Device};

fn srn() -> Resolved {
    tiny_config(Method::Srn, |config| {
        config.srn = SrnConfig { width: 48, ..SrnConfig::default() };
        config.train.chunk = 16;
    })
}

fn located(settings: &str) -> (Resolved, Scene) {
    load_scene(built(None, settings).unwrap(), &()).unwrap()
}

/// Later steps have a smaller squared error: the mean of the last ten to that of the first ten, at most `ratio`.
#[track_caller]
fn assert_learns((config, scene): &(Resolved, Scene), steps: usize, ratio: f64) {
    let mut trainer = Trainer::new(config, scene, DType::F32, runtime()).unwrap();
    let errors: Vec<f64> = (0..steps).map(|_| trainer.step(false).unwrap().mse).collect();
    let mean = |errors: &[f64]| errors.iter().sum::<f64>() / errors.len() as f64;
    let (first, last) = (mean(&errors[..10]), mean(&errors[steps - 10..]));
    assert!(last < ratio * first, "{first} {last}");
}

#[test]
fn steps_lower_the_error() {
    assert_learns(&(srn(), tiny_scene()), 150, 0.5);
    // A volume before a plain background that learns from few rays, or at a high rate, empties itself.
    let volumes = "method=nv; data.width=16; train.rays=256; train.batching=all-images; train.precrop_steps=0; \
        nv.resolution=16; nv.divide=16; nv.warp_resolution=4";
    assert_learns(&located(volumes), 120, 0.5);
    // Later steps come nearer to the views that they leave out.
    let planes = "method=llff; data.kind=builtin-forward; data.ndc=false; data.width=32; llff.planes=8; llff.inputs=3; \
        llff.window=32; llff.crop=16; train.learning_rate=2e-3";
    assert_learns(&located(planes), 43, 0.7);
}

/// SRN's steps in f32 are those of f64. The norm is our own, the other operations are candle's.
#[test]
fn steps_are_the_same_in_both_precisions() {
    let steps = |dtype: DType| -> Vec<[f64; 3]> {
        let mut trainer = Trainer::new(&srn(), &tiny_scene(), dtype, runtime()).unwrap();
        let mut step = || trainer.step(true).unwrap();
        (0..4).map(|_| step()).map(|stats| [stats.loss, stats.mse, stats.term("depth_deviation").unwrap()]).collect()
    };
    for (single, double) in steps(DType::F32).iter().zip(steps(DType::F64)) {
        for (a, b) in single.iter().zip(double) {
            assert!((a - b).abs() < 2e-3 * b.abs(), "{single:?} {double:?}");
        }
    }
}

/// A run of a second with the same bytes on other threads and after a stop, which is evaluated, rendered and compared. Its
/// protocol describes the method.
#[track_caller]
fn used(method: &str, settings: &str, description: &str) -> Place {
    let place = Place::new();
    let small =
        "data.width=16 train.rays=64 train.steps=40 train.checkpoint_every=20 train.keep_checkpoints=2 eval.pictures=1";
    let small = set(&format!("{small} {settings}"));
    for (out, threads) in [("run", 1), ("other", 3)] {
        place.run(&format!("train --quiet --preset smoke --method {method} --threads {threads} --out {out}{small}"), 0);
    }
    let [run, other] = ["run", "other"].map(|name| place.at(name));
    assert_same_files(&run, &other, &FLEETING);
    std::fs::remove_dir_all(other.join("checkpoints/step_000000040")).unwrap();
    place.run("resume --quiet --threads 2 other", 0);
    assert_same_files(&run, &other, &FLEETING);
    let metrics = place.json("run/metrics.json");
    place.run("eval --quiet run", 0);
    assert_eq!(place.json("run/metrics.json"), metrics, "the checkpoint gives the numbers of the trained network");
    place.run("render --quiet run --frames 1 --out path", 0);
    place.run("compare --quiet run other --out compared", 0);
    assert!(metrics["mean"]["psnr"].as_f64().unwrap() > 5.0, "{metrics}");
    assert!(metrics["protocol"][method].as_str().unwrap().starts_with(description), "{metrics}");
    place
}

/// Demands columns of a run's log, and parameters of its last checkpoint by the ends of their names.
#[track_caller]
fn assert_keeps(place: &Place, columns: &[&str], parameters: &[&str]) {
    let log = rows(&place.text("run/scalars.csv")).remove(0);
    columns.iter().for_each(|column| assert!(log.contains_key(*column), "{column}: {log:?}"));
    let state = place.at("run/checkpoints/step_000000040/state.safetensors");
    let state = candle_core::safetensors::load(state, &Device::Cpu).unwrap();
    for name in parameters {
        assert!(state.keys().any(|key| key.ends_with(name)), "{name}: {:?}", state.keys());
    }
}

#[test]
fn a_run_of_srn_has_its_terms_parameters_and_pictures() {
    let place = used("srn", "srn.width=24 train.chunk=16", "width 24, 4 + 5 layers, 10 steps");
    let parameters = ["phi.0.weight", "phi.3.scale", "lstm.weight_hh", "head.bias", "pixel.5.bias"];
    assert_keeps(&place, &["loss_image", "loss_depth", "depth_deviation", "psnr"], &parameters);
    let metrics = place.json("run/metrics.json");
    assert!(metrics["protocol"]["learning_rate"].as_str().unwrap().ends_with(", constant"), "{metrics}");
}

#[test]
fn a_run_of_volumes_has_its_terms_parameters_pictures_and_surface() {
    let settings = "nv.resolution=16 nv.divide=16 nv.warp_resolution=4 nv.code=variational";
    let place = used("nv", settings, "16^3 from 64 channels, warp 4^3");
    let terms = ["loss_image", "loss_accumulation", "loss_variation", "loss_code", "mean_acc", "psnr"];
    assert_keeps(&place, &terms, &["volume.code", "volume.template.4.weight", "volume.warp.weights.1.bias"]);
    // Opacities have hardly moved from ln 2 per half a side of 2.4.
    place.run("mesh --quiet run --threshold 0.541 --resolution 12 --out mesh", 0);
    assert!(std::fs::metadata(place.at("mesh/mesh.ply")).unwrap().len() > 100);
}

#[test]
fn a_run_of_planes_has_pictures() {
    let settings = "data.kind=builtin-forward llff.planes=8 llff.inputs=3 llff.window=16 llff.crop=8";
    used("llff", settings, "8 planes");
}
