//! `--device gpu` as a user runs it. The nightly run builds the program with the feature; Mesa plays a device.

use serde_json::{Value, json};

use crate::common::files::{number, rows};
use crate::common::program::{Place, set};

/// A hash grid on small views of the built-in scene.
const SMALL: &str = "data.width=32 train.rays=64 sampling.kind=resampled \
     field.hash.log2_table=11 train.steps=80 train.log_every=20 eval.pictures=1";

fn train(out: &str, device: &str, more: &str) -> String {
    format!("train --quiet --overwrite --out {out} --device {device}{}{}", set(SMALL), set(more))
}

fn psnr(place: &Place, run: &str) -> f64 {
    place.json(&format!("{run}/metrics.json"))["mean"]["psnr"].as_f64().unwrap()
}

fn state(place: &Place, run: &str) -> Value {
    place.json(&format!("{run}/checkpoints/step_000000080/state.json"))
}

#[test]
fn a_training_ends_where_the_processor_s_does() {
    let place = Place::new();
    for method in ["method=nerf", "method=aug-nerf"] {
        let [on_gpu, on_cpu] = ["gpu", "cpu"].map(|device| {
            place.run(&train(device, device, method), 0);
            psnr(&place, device)
        });
        assert!((on_gpu - on_cpu).abs() < 0.3 && on_cpu > 16.0, "{method}: {on_gpu} dB and {on_cpu} dB");
        let state = state(&place, "gpu");
        assert_eq!(state["devices"], json!(["gpu"]));
        assert!(!state["adapters"][0].as_str().unwrap().is_empty());
        let device = &place.json("gpu/metrics.json")["protocol"]["device"];
        assert!(device.as_str().unwrap().starts_with("gpu ("), "{device}");
    }
}

/// Rows of the paper's tables on a small network.
#[test]
fn networks_end_where_the_processor_s_do() {
    let place = Place::new();
    let small = "data.width=24 train.rays=64 field.width=32 field.depth=2 field.skips=[] perturb.injection_layer=1 train.steps=200 \
                 train.decay_steps=200 train.learning_rate=5e-3 eval.train_views=0 eval.pictures=0 data.test_skip=4";
    let laplacian = "method=nerf regularizer.kind=laplacian regularizer.weight=1e-6";
    for method in ["method=mip-nerf", "method=aug-mip-nerf", laplacian] {
        let [on_gpu, on_cpu] = ["gpu", "cpu"].map(|device| {
            let train = format!("train --preset smoke --quiet --overwrite --out {device} --device {device}");
            place.run(&format!("{train}{}{}", set(small), set(method)), 0);
            psnr(&place, device)
        });
        println!("{method}: {on_gpu} dB and {on_cpu} dB");
        assert!((on_gpu - on_cpu).abs() < 0.3 && on_cpu > 13.0, "{method}: {on_gpu} dB and {on_cpu} dB");
    }
}

/// A surface and its smoothness, of a training with a term in space.
#[test]
fn surfaces_and_measures_are_the_processor_s() {
    let place = Place::new();
    place.run(&train("run", "gpu", "regularizer.kind=tv regularizer.weight=1e-5"), 0);
    let [on_gpu, on_cpu] = ["gpu", "cpu"].map(|device| {
        place.run(&format!("mesh run --device {device} --resolution 24 --threshold 1 --quiet"), 0);
        place.run(&format!("eval --smoothness run --device {device} --lattice 16 --quiet"), 0);
        let row = rows(&place.text("run/smoothness.csv")).remove(0);
        let [l1, tv, largest] = ["l1", "tv", "largest_density"].map(|name| number(&row, name));
        [place.json("run/mesh/mesh.json")["area"].as_f64().unwrap(), l1, tv, largest]
    });
    for (found, expected) in on_gpu.into_iter().zip(on_cpu) {
        assert!(expected > 0.0 && (found / expected - 1.0).abs() < 1e-3, "{on_gpu:?} and {on_cpu:?}");
    }
}

#[test]
fn a_run_goes_on_on_another_device() {
    let place = Place::new();
    for (first, second) in [("gpu", "cpu"), ("cpu", "gpu")] {
        place.run(&train(first, first, "train.checkpoint_every=40"), 0);
        let whole = psnr(&place, first);
        std::fs::remove_dir_all(place.at(first).join("checkpoints/step_000000080")).unwrap();
        place.run(&format!("resume {first} --device {second} --quiet"), 0);
        assert_eq!(state(&place, first)["devices"], json!([first, second]));
        let resumed = psnr(&place, first);
        assert!((resumed - whole).abs() < 0.3, "{first} then {second}: {resumed} dB and {whole} dB");
        let measured = place.printed(&format!("eval {first} --device {second}"));
        assert!(measured.contains("psnr"), "{measured}");
    }
}

/// A row that the device refuses runs on the processor, and the table says so.
#[test]
fn rows_of_a_sweep_can_stay_on_the_processor() {
    let place = Place::new();
    let sweep = |device: &str| {
        format!(
            "title = 'Two devices'\npreset = 'smoke'\nscenes = ['builtin']\nseeds = [0]\nmetrics = ['psnr']\nbaseline = 'NeRF'\n\
             set = {{ data.width = 16, train.rays = 32, train.steps = 4, eval.train_views = 0 }}\n\
             [[row]]\nname = 'NeRF'\n[[row]]\nname = 'SRN'\nset = {{ method = 'srn' }}\n{device}"
        )
    };
    place.write("refused.toml", sweep(""));
    place.says(
        "sweep run refused.toml --device gpu",
        2,
        &["SRN (builtin)", "method srn", "device = \"cpu\" in the sweep's file"],
    );
    place.write("two.toml", sweep("device = 'cpu'"));
    place.run("sweep run two.toml --device gpu --quiet", 0);
    let table = place.text("results/two/table.md");
    assert!(table.contains("rows differ in device: gpu (") && table.contains("(NeRF); cpu (SRN)"), "{table}");
    let budget = "device = 'cpu'\nbudget = { kind = 'seconds', like = 'NeRF' }";
    place.write("budget.toml", sweep(budget));
    place.says("sweep run budget.toml --device gpu", 2, &["names its own", "remove that device or the budget"]);
}

#[test]
fn devices_are_listed_and_timed() {
    let place = Place::new();
    let listed = place.printed("bench --devices");
    assert!(listed.starts_with("cpu ") && listed.contains("\ngpu:0 "), "{listed}");
    let timed = place.printed("bench --device gpu --rays 64 --coarse 8 --fine 8 --width 32 --steps 1");
    let timed: Value = serde_json::from_str(&timed).unwrap();
    assert!(timed["device"] == "gpu" && timed["seconds_per_step"].as_f64().unwrap() > 0.0, "{timed}");
    // The processor's products have no rows of padding or without a gradient.
    let on_cpu = place.printed("bench --rays 64 --coarse 8 --fine 8 --width 32 --steps 1");
    let on_cpu: Value = serde_json::from_str(&on_cpu).unwrap();
    let multiply_adds = |timed: &Value| timed["multiply_adds_per_step"].as_f64().unwrap();
    let ratio = multiply_adds(&timed) / multiply_adds(&on_cpu);
    assert!((1.0..1.5).contains(&ratio), "{timed} {on_cpu}");
    assert!(
        timed["dispatches_per_step"].as_u64().unwrap() > 50 && timed["product_bytes_per_step"].as_u64() > Some(1 << 20)
    );
    assert!(timed["gemm_peak_gflops"].is_null() && on_cpu["dispatches_per_step"].is_null(), "{timed} {on_cpu}");
}

#[test]
fn what_it_does_not_do_is_refused() {
    let place = Place::new();
    for (settings, words) in [
        ("method=srn", "method srn"),
        ("regularizer.kind=orientation", "regularizer orientation"),
        ("field.width=30", "width 30"),
    ] {
        place.says(&train("run", "gpu", settings), 2, &[words, "--device cpu"]);
    }
    place.says(&train("run", "gpu:99", ""), 2, &["augnerf bench --devices"]);
    place.says(&train("run", "cpu", "field.precision=f16"), 2, &["field.precision = \"f16\" needs --device gpu"]);
}
