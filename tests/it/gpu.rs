//! `--device gpu` as a user runs it. The nightly run builds the program with the feature; Mesa plays a device.

use std::fs;
use std::path::Path;

use crate::common::files::json;
use crate::common::program::{augnerf, demand, printed, succeed};

/// A hash grid on small views of the built-in scene.
const SMALL: [&str; 6] = [
    "data.width=32",
    "train.rays=64",
    "field.hash.log2_table=11",
    "train.steps=80",
    "train.log_every=20",
    "eval.pictures=1",
];

fn train<'a>(out: &'a str, device: &'a str, more: &'a [&'a str]) -> Vec<&'a str> {
    let mut arguments = vec!["train", "--quiet", "--overwrite", "--out", out, "--device", device];
    SMALL.iter().chain(more).for_each(|setting| arguments.extend(["--set", setting]));
    arguments
}

fn psnr(run: &Path) -> f64 {
    json(&run.join("metrics.json"))["mean"]["psnr"].as_f64().unwrap()
}

fn state(run: &Path, step: u64) -> serde_json::Value {
    json(&run.join(format!("checkpoints/step_{step:09}/state.json")))
}

#[test]
fn a_training_ends_where_the_processor_s_does() {
    let dir = tempfile::tempdir().unwrap();
    for method in ["method=nerf", "method=aug-nerf"] {
        let runs = ["gpu", "cpu"].map(|device| {
            let run = dir.path().join(format!("{device}-{method}"));
            succeed(&train(run.to_str().unwrap(), device, &[method]));
            run
        });
        let [on_gpu, on_cpu] = runs.each_ref().map(|run| psnr(run));
        assert!((on_gpu - on_cpu).abs() < 0.3 && on_cpu > 16.0, "{method}: {on_gpu} dB and {on_cpu} dB");
        let state = state(&runs[0], 80);
        assert_eq!(state["devices"], serde_json::json!(["gpu"]));
        assert!(!state["adapters"][0].as_str().unwrap().is_empty());
        let metrics = json(&runs[0].join("metrics.json"));
        let device = metrics["protocol"]["device"].as_str().unwrap();
        assert!(device.starts_with("gpu ("), "{device}");
    }
}

/// A surface and its smoothness, of a training with a term in space.
#[test]
fn surfaces_and_measures_are_the_processor_s() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let path = run.to_str().unwrap();
    succeed(&train(path, "gpu", &["regularizer.kind=tv", "regularizer.weight=1e-5"]));
    let [on_gpu, on_cpu] = ["gpu", "cpu"].map(|device| {
        succeed(&["mesh", path, "--device", device, "--resolution", "24", "--threshold", "1", "--quiet"]);
        let mesh = json(&run.join("mesh/mesh.json"));
        succeed(&["eval", "--smoothness", path, "--device", device, "--lattice", "16", "--quiet"]);
        let mut smoothness = csv::Reader::from_path(run.join("smoothness.csv")).unwrap();
        let head = smoothness.headers().unwrap().clone();
        let values = smoothness.records().next().unwrap().unwrap();
        let of = |name: &str| -> f64 { values[head.iter().position(|known| known == name).unwrap()].parse().unwrap() };
        [mesh["area"].as_f64().unwrap(), of("l1"), of("tv"), of("largest_density")]
    });
    for (found, expected) in on_gpu.into_iter().zip(on_cpu) {
        assert!(expected > 0.0 && (found / expected - 1.0).abs() < 1e-3, "{on_gpu:?} and {on_cpu:?}");
    }
}

#[test]
fn a_run_goes_on_on_another_device() {
    let dir = tempfile::tempdir().unwrap();
    for (first, second) in [("gpu", "cpu"), ("cpu", "gpu")] {
        let run = dir.path().join(first);
        let path = run.to_str().unwrap();
        succeed(&train(path, first, &["train.checkpoint_every=40"]));
        let whole = psnr(&run);
        fs::remove_dir_all(run.join("checkpoints/step_000000080")).unwrap();
        succeed(&["resume", path, "--device", second, "--quiet"]);
        assert_eq!(state(&run, 80)["devices"], serde_json::json!([first, second]));
        assert!((psnr(&run) - whole).abs() < 0.3, "{first} then {second}: {} dB and {whole} dB", psnr(&run));
        let measured = printed(&["eval", path, "--device", second]);
        assert!(measured.contains("psnr"), "{measured}");
    }
}

#[test]
fn devices_are_listed_and_timed() {
    let listed = printed(&["bench", "--devices"]);
    assert!(listed.starts_with("cpu ") && listed.contains("\ngpu:0 "), "{listed}");
    let arguments =
        ["bench", "--device", "gpu", "--rays", "64", "--coarse", "8", "--fine", "8", "--width", "32", "--steps", "1"];
    let timed: serde_json::Value = serde_json::from_str(&printed(&arguments)).unwrap();
    assert!(timed["device"] == "gpu" && timed["seconds_per_step"].as_f64().unwrap() > 0.0, "{timed}");
}

#[test]
fn what_it_does_not_do_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    let out = out.to_str().unwrap();
    for (setting, words) in [
        ("method=mip-nerf", "method mip-nerf"),
        ("field.encoding=positional", "regularizer laplacian"),
        ("field.width=30", "width 30"),
    ] {
        let laplacian = if words.contains("laplacian") { "regularizer.kind=laplacian" } else { "regularizer.kind=[]" };
        let said = demand(&mut augnerf(&train(out, "gpu", &[setting, laplacian])), 2);
        assert!(said.contains(words) && said.contains("--device cpu"), "{said}");
    }
    let said = demand(&mut augnerf(&train(out, "gpu:99", &[])), 2);
    assert!(said.contains("augnerf bench --devices"), "{said}");
    let said = demand(&mut augnerf(&train(out, "cpu", &["field.precision=f16"])), 2);
    assert!(said.contains("field.precision = \"f16\" needs --device gpu"), "{said}");
}
