//! Weights of nerf-pytorch, safetensors that say what they are, and runs that begin with another's weights.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use tempfile::TempDir;

use crate::common::files::{json as read_json, newest, rows, text};
use crate::common::program::{refuse, run, succeed};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(name)
}

fn path(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A training of some steps on the embedded scene.
fn train(out: &Path, further: &[&str]) -> std::process::Output {
    let small = [
        "train",
        "--preset",
        "smoke",
        "--set",
        "data.width=12",
        "--set",
        "field.width=16",
        "--set",
        "train.rays=32",
        "--set",
        "eval.pictures=0",
        "--set",
        "train.log_every=4",
        "-q",
        "--out",
    ];
    run(&[&small[..], &[path(out)], further].concat())
}

/// The parameters of a run's newest checkpoint.
fn weights(run: &Path) -> Vec<u8> {
    std::fs::read(newest(&run.join("checkpoints")).join("state.safetensors")).unwrap()
}

/// Imports the fixture with its own number of samples.
fn import(out: &Path) {
    let file = fixture("nerf_pytorch.tar");
    let samples = ["--set", "sampling.coarse=24", "--set", "sampling.fine=24"];
    let small = ["--set", "data.width=16", "--set", "train.rays=32"];
    succeed(&[&["import", path(&file), "--out", path(out)], &samples[..], &small].concat());
}

/// tools/nerf_pytorch_fixture.py wrote the weights and the picture that PyTorch renders of them.
#[test]
fn a_checkpoint_of_nerf_pytorch_renders_as_there() {
    let dir = TempDir::new().unwrap();
    let (run, cameras, out) = (dir.path().join("run"), dir.path().join("camera.json"), dir.path().join("out"));
    import(&run);
    let there = read_json(&fixture("nerf_pytorch.json"));
    let number = |key: &str| there[key].as_f64().unwrap();
    let matrix: Vec<&Value> =
        there["pose"].as_array().unwrap().iter().flat_map(|row| row.as_array().unwrap()).collect();
    let camera = json!({"camera_to_world": matrix, "fl_x": there["focal"], "fl_y": there["focal"]});
    let film = json!({"render_width": there["width"], "render_height": there["height"], "camera_path": [camera]});
    std::fs::write(&cameras, film.to_string()).unwrap();
    succeed(&["render", path(&run), "--cameras", path(&cameras), "--out", path(&out), "-q"]);
    let found = image::open(out.join("rgb_000.png")).unwrap().to_rgb8();
    assert_eq!((f64::from(found.width()), f64::from(found.height())), (number("width"), number("height")));
    let expected: Vec<f64> = there["rgb"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap() * 255.0).collect();
    assert_eq!(found.as_raw().len(), expected.len());
    let apart = found.as_raw().iter().zip(&expected).map(|(a, b)| (f64::from(*a) - b).abs());
    let worst = apart.fold(0.0, f64::max);
    // Half a step is 8-bit rounding.
    assert!(worst < 1.0, "{worst} / 255");
    let spread =
        expected.iter().fold(f64::INFINITY, |a, b| a.min(*b)) - expected.iter().fold(0.0, |a: f64, b| a.max(*b));
    assert!(spread < -100.0, "a picture that shows something");
    let said = text(&run.join("config.toml"));
    assert!(said.contains("parent = \"weights ") && said.contains("steps = 1234"), "{said}");
    // It ends there unless more steps are asked for, of which the first is no longer than Adam's first.
    let more = dir.path().join("more");
    let file = fixture("nerf_pytorch.tar");
    let steps = |steps: &'static str| ["import", path(&file), "--out", path(&more), "--set", steps].map(String::from);
    let refused = steps("train.steps=1000");
    refuse(&refused.each_ref().map(String::as_str), 2, &["step 1234", "train.steps = 1000"]);
    let further = steps("train.steps=1235");
    let small = ["--set", "data.width=16", "--set", "train.rays=32", "--set", "eval.pictures=0"];
    succeed(&[&further.each_ref().map(String::as_str)[..], &small].concat());
    let (before, rate) = (weights(&more), 5e-4);
    succeed(&["resume", path(&more), "-q"]);
    let after = weights(&more);
    let values = |bytes: &[u8]| -> Vec<f32> {
        let read = safetensors::SafeTensors::deserialize(bytes).unwrap();
        let mut named: Vec<_> = read.iter().filter(|(name, _)| !name.starts_with("adam.")).collect();
        named.sort_by_key(|(name, _)| name.to_string());
        let numbers = |data: &[u8]| data.chunks_exact(4).map(|v| f32::from_le_bytes(v.try_into().unwrap())).collect();
        named.iter().flat_map(|(_, view)| -> Vec<f32> { numbers(view.data()) }).collect()
    };
    let moved = values(&before).into_iter().zip(values(&after)).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(moved > 0.5 * rate && moved < 1.01 * rate, "{moved}");
}

/// Out and in again, the weights are the same; what the parent was is told.
#[test]
fn weights_go_out_and_come_back() {
    let dir = TempDir::new().unwrap();
    let [run, own, back, on] = ["run", "a.safetensors", "back", "on"].map(|name| dir.path().join(name));
    assert!(train(&run, &["--set", "train.steps=8"]).status.success());
    succeed(&["export", path(&run), path(&own)]);
    let parameters = |run: &Path| {
        let bytes = weights(run);
        let read = safetensors::SafeTensors::deserialize(&bytes).unwrap();
        let mut named: Vec<(String, Vec<u8>)> = read
            .iter()
            .filter(|(name, _)| !name.starts_with("adam."))
            .map(|(name, view)| (name.to_string(), view.data().to_vec()))
            .collect();
        named.sort();
        named
    };
    succeed(&["import", path(&own), "--out", path(&back)]);
    assert_eq!(parameters(&back), parameters(&run));
    // It can be measured, and taken further.
    succeed(&["eval", path(&back), "-q"]);
    let psnr = |run: &Path| read_json(&run.join("metrics.json"))["mean"]["psnr"].as_f64().unwrap();
    assert!((psnr(&back) - psnr(&run)).abs() < 1e-6, "{} {}", psnr(&back), psnr(&run));
    succeed(&["train", "--from", path(&back), "--set", "train.steps=10", "--out", path(&on), "-q"]);
    let bytes = std::fs::read(&own).unwrap();
    let (_, header) = safetensors::SafeTensors::read_metadata(&bytes).unwrap();
    let said: Value = serde_json::from_str(&header.metadata().as_ref().unwrap()["augnerf"]).unwrap();
    assert_eq!((&said["step"], &said["architecture"]["width"]), (&json!(8), &json!(16)));
    assert_eq!((&said["encodings"]["position"], &said["networks"]), (&json!("positional"), &json!(["coarse", "fine"])));
    assert!(said["config_hash"].as_str().is_some_and(|hash| hash.len() == 12) && said["world_to_scene"].is_array());
    // The same bytes twice.
    let again = dir.path().join("b.safetensors");
    succeed(&["export", path(&run), path(&again)]);
    assert!(bytes == std::fs::read(&again).unwrap());
}

/// Twice as many steps in two runs, or in one: the same weights.
#[test]
fn more_steps_are_the_steps_that_a_longer_run_takes() {
    let dir = TempDir::new().unwrap();
    let [short, long, more, fresh] = ["short", "long", "more", "fresh"].map(|name| dir.path().join(name));
    assert!(train(&short, &["--set", "train.steps=6"]).status.success());
    assert!(train(&long, &["--set", "train.steps=12"]).status.success());
    succeed(&["train", "--from", path(&short), "--set", "train.steps=12", "--out", path(&more), "-q"]);
    assert!(weights(&more) == weights(&long));
    let hash =
        |run: &Path| read_json(&run.join("metrics.json"))["protocol"]["config_hash"].as_str().unwrap().to_string();
    let parent = |run: &Path| rows(&text(&run.join("metrics.csv")))[0]["parent"].clone();
    assert_eq!(parent(&more), format!("h{}@6", hash(&short)));
    assert_eq!(parent(&long), "");
    assert!(hash(&more) != hash(&long) && text(&more.join("scalars.csv")).lines().nth(1).unwrap().starts_with("8,"));
    // From step 0 with other settings.
    let restart =
        ["--restart", "--set", "train.steps=4", "--set", "train.learning_rate=0.001", "--out", path(&fresh), "-q"];
    succeed(&[&["train", "--from", path(&short)], &restart[..]].concat());
    assert_eq!(parent(&fresh), format!("h{}@6 restarted", hash(&short)));
    // A run that begins with weights of elsewhere goes on as any other.
    succeed(&["resume", path(&more), "-q"]);
}

#[test]
fn what_cannot_be_taken_over_is_refused() {
    let dir = TempDir::new().unwrap();
    let [short, out, bad] = ["short", "out", "bad.tar"].map(|name| dir.path().join(name));
    assert!(train(&short, &["--set", "train.steps=2"]).status.success());
    let from = |further: &[&str], code: i32, words: &[&str]| {
        refuse(&[&["train", "--from", path(&short), "--out", path(&out), "-q"], further].concat(), code, words);
        assert!(!out.join("config.toml").exists());
    };
    from(&[], 2, &["step 2", "train.steps=4", "--restart"]);
    from(&["--set", "train.steps=4", "--set", "field.width=8"], 5, &["shape", "another architecture"]);
    // The checks of a start with random weights.
    let tv = ["--restart", "--set", "regularizer.kind=tv", "--set"];
    let far = "regularizer.domain=[[50,50,50],[51,51,51]]";
    from(&[&tv[..], &[far]].concat(), 2, &["regularizer.domain", "outside"]);
    from(&["--set", "train.steps=4", "--set", "regularizer.kind=tv", "--set", far], 2, &["regularizer.domain"]);
    let endless = ["regularizer.points=full", "--set", "regularizer.lattice=1024", "--set", "train.steps=1000000000"];
    from(&[&tv[..], &endless].concat(), 2, &["regularizer.lattice = 1024", "days", "sampled"]);
    let parent = ["train", "--preset", "smoke", "--set", "train.parent=abc", "--out", path(&out), "-q"];
    refuse(&parent, 2, &["train.parent", "--from"]);
    std::fs::write(&bad, "no archive").unwrap();
    refuse(&["import", path(&bad), "--out", path(&out)], 3, &["bad.tar", "weight file", "torch.save(torch.load("]);
    refuse(&["import", "weights.bin", "--out", path(&out)], 2, &["weights.bin", ".safetensors"]);
    for name in ["x.onnx", "x.tar"] {
        refuse(&["export", path(&short), path(&dir.path().join(name))], 2, &[name, ".safetensors"]);
    }
    let file = fixture("nerf_pytorch.tar");
    refuse(
        &["import", path(&file), "--set", "field.width=8", "--out", path(&out)],
        3,
        &["pts_linears.0.weight", "shape"],
    );
    // Before the folder is there: such a run could not be measured.
    refuse(&["import", path(&file), "--lpips-weights", "/nope", "--out", path(&out)], 3, &["LPIPS weights /nope"]);
    assert!(!out.join("config.toml").exists());
    let hash = dir.path().join("hash");
    let grid = ["--preset", "fast", "--set", "train.steps=1", "--set", "data.width=8", "--set", "eval.pictures=0"];
    succeed(&[&["train", "--out", path(&hash), "-q"], &grid[..]].concat());
    let empty = ["--restart", "--set", "field.hash.bounds=[[50,50,50],[51,51,51]]"];
    let outside = [&["train", "--from", path(&hash), "--out", path(&out), "-q"], &empty[..]].concat();
    refuse(&outside, 2, &["field.hash.bounds", "outside"]);
    let file = fixture("nerf_pytorch.tar");
    let imported = ["import", path(&file), "--set", "regularizer.kind=tv", "--set", far, "--out", path(&out)];
    refuse(&imported, 2, &["regularizer.domain", "outside"]);
}
