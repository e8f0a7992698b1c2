//! Weights of nerf-pytorch, and runs that begin with another's weights.

use safetensors::SafeTensors;
use serde_json::{Value, json};

use crate::common::files::{fixture, json as read_json, newest, rows};
use crate::common::program::{Place, set};

/// A training of some steps on the embedded scene.
fn train(place: &Place, out: &str, steps: usize) {
    let small = set("data.width=12 field.width=16 train.rays=32 eval.pictures=0 train.log_every=4");
    place.run(&format!("train --preset smoke{small} -q --out {out} --set train.steps={steps}"), 0);
}

/// The bytes of a run's newest checkpoint.
fn state(place: &Place, run: &str) -> Vec<u8> {
    std::fs::read(newest(&place.at(run).join("checkpoints")).join("state.safetensors")).unwrap()
}

/// The parameters in there, by name.
fn parameters(place: &Place, run: &str) -> Vec<(String, Vec<u8>)> {
    let bytes = state(place, run);
    let read = SafeTensors::deserialize(&bytes).unwrap();
    let own = read.iter().filter(|(name, _)| !name.starts_with("adam."));
    let mut named: Vec<_> = own.map(|(name, view)| (name.to_string(), view.data().to_vec())).collect();
    named.sort();
    named
}

/// tools/nerf_pytorch_fixture.py wrote the weights and the picture that PyTorch renders of them.
#[test]
fn a_checkpoint_of_nerf_pytorch_renders_as_there() {
    let place = Place::new();
    let small = set("data.width=16 train.rays=32 eval.pictures=0");
    let import = format!("import {}", fixture("nerf_pytorch.tar").display());
    // With its own number of samples.
    place.run(&format!("{import} --out run{small}{}", set("sampling.coarse=24 sampling.fine=24")), 0);
    let there = read_json(&fixture("nerf_pytorch.json"));
    let number = |key: &str| there[key].as_f64().unwrap();
    let matrix: Vec<&Value> =
        there["pose"].as_array().unwrap().iter().flat_map(|row| row.as_array().unwrap()).collect();
    let camera = json!({"camera_to_world": matrix, "fl_x": there["focal"], "fl_y": there["focal"]});
    let film = json!({"render_width": there["width"], "render_height": there["height"], "camera_path": [camera]});
    place.write("camera.json", film.to_string());
    place.run("render run --cameras camera.json --out out -q", 0);
    let found = image::open(place.at("out/rgb_000.png")).unwrap().to_rgb8();
    assert_eq!((f64::from(found.width()), f64::from(found.height())), (number("width"), number("height")));
    let expected: Vec<f64> = there["rgb"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap() * 255.0).collect();
    assert_eq!(found.as_raw().len(), expected.len());
    let apart = found.as_raw().iter().zip(&expected).map(|(a, b)| (f64::from(*a) - b).abs());
    let worst = apart.fold(0.0, f64::max);
    // Half a step is 8-bit rounding.
    assert!(worst < 1.0, "{worst} / 255");
    let [least, most] = [f64::min, f64::max].map(|pick| expected.iter().copied().reduce(pick).unwrap());
    assert!(most - least > 100.0, "a picture that shows something");
    let said = place.text("run/config.toml");
    assert!(said.contains("parent = \"weights ") && said.contains("steps = 1234"), "{said}");
    // It ends there unless more steps are asked for, of which the first is no longer than Adam's first.
    let steps = |steps: usize| format!("{import} --out more --set train.steps={steps}{small}");
    place.says(&steps(1000), 2, &["step 1234", "train.steps = 1000"]);
    place.run(&steps(1235), 0);
    let (before, rate) = (parameters(&place, "more"), 5e-4);
    place.run("resume more -q", 0);
    let values = |named: Vec<(String, Vec<u8>)>| -> Vec<f32> {
        let bytes: Vec<u8> = named.into_iter().flat_map(|(_, bytes)| bytes).collect();
        bytes.chunks_exact(4).map(|v| f32::from_le_bytes(v.try_into().unwrap())).collect()
    };
    let moved = values(before).into_iter().zip(values(parameters(&place, "more"))).map(|(a, b)| (a - b).abs());
    let moved = moved.fold(0.0, f32::max);
    assert!(moved > 0.5 * rate && moved < 1.01 * rate, "{moved}");
}

/// Twice as many steps in two runs, or in one: the same weights.
#[test]
fn more_steps_are_the_steps_that_a_longer_run_takes() {
    let place = Place::new();
    train(&place, "short", 6);
    train(&place, "long", 12);
    place.run("train --from short --set train.steps=12 --out more -q", 0);
    assert!(state(&place, "more") == state(&place, "long"));
    let hash = |run: &str| {
        let metrics = place.json(&format!("{run}/metrics.json"));
        metrics["protocol"]["config_hash"].as_str().unwrap().to_string()
    };
    let parent = |run: &str| rows(&place.text(&format!("{run}/metrics.csv")))[0]["parent"].clone();
    assert_eq!([parent("more"), parent("long")], [format!("h{}@6", hash("short")), String::new()]);
    assert!(hash("more") != hash("long"));
    assert!(place.text("more/scalars.csv").lines().nth(1).unwrap().starts_with("8,"));
    // From step 0 with other settings.
    let restart = set("train.steps=4 train.learning_rate=0.001");
    place.run(&format!("train --from short --restart{restart} --out fresh -q"), 0);
    assert_eq!(parent("fresh"), format!("h{}@6 restarted", hash("short")));
    // A run that begins with weights of elsewhere goes on as any other.
    place.run("resume more -q", 0);
}

#[test]
fn what_cannot_be_taken_over_is_refused() {
    let place = Place::new();
    train(&place, "short", 2);
    let grid =
        set("train.steps=1 data.width=8 train.rays=16 field.hash.levels=2 field.hash.log2_table=8 eval.pictures=0");
    place.run(&format!("train --preset fast{grid} --out hash -q"), 0);
    place.write("bad.tar", "no archive");
    let tar = &fixture("nerf_pytorch.tar").display().to_string();
    let far = "regularizer.kind=tv regularizer.domain=[[50,50,50],[51,51,51]]";
    let from = |flags: &str, settings: &str| format!("train --from {flags}{} --out out -q", set(settings));
    for (line, code, words) in [
        (from("short", ""), 2, &["step 2", "train.steps=4", "--restart"][..]),
        (from("short", "train.steps=4 field.width=8"), 5, &["shape", "another architecture"]),
        // The checks of a start with random weights.
        (from("short --restart", far), 2, &["regularizer.domain", "outside"]),
        (from("short", &format!("train.steps=4 {far}")), 2, &["regularizer.domain"]),
        (from("hash --restart", "field.hash.bounds=[[50,50,50],[51,51,51]]"), 2, &["field.hash.bounds", "outside"]),
        ("train --preset smoke --set train.parent=abc --out out -q".into(), 2, &["train.parent", "--from"]),
        ("import x.tar --out out".into(), 3, &["cannot read x.tar: No such file"]),
        ("import bad.tar --out out".into(), 3, &["bad.tar", "weight file", "torch.save(torch.load("]),
        ("import weights.safetensors --out out".into(), 2, &["weights.safetensors", ".tar", "its folder"]),
        (format!("import {tar} --set field.width=8 --out out"), 3, &["pts_linears.0.weight", "shape"]),
        // Before the folder is there: such a run could not be measured.
        (format!("import {tar} --lpips-weights /nope --out out"), 3, &["LPIPS weights /nope"]),
        (format!("import {tar}{} --out out", set(far)), 2, &["regularizer.domain", "outside"]),
    ] {
        place.says(&line, code, words);
        assert!(!place.at("out/config.toml").exists(), "{line}");
    }
}
