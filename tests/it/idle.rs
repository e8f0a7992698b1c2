//! Flags and settings that would change nothing: they are refused, or a note names them.

use crate::common::assert_says;
use crate::common::program::{Place, set};

/// Cameras that are written are not rendered.
#[test]
fn flags_of_images_are_refused_where_cameras_are_written() {
    let place = Place::new();
    let words = ["--write-cameras", "cannot be used with", "--out"];
    place.says("render none --write-cameras p.json --out DIR", 2, &words);
    for flag in ["--resolution 8x8", "--fps 2"] {
        // The file has both, so that only the run is missing.
        place.says(&format!("render none --write-cameras p.json {flag}"), 5, &["none"]);
    }
}

#[test]
fn settings_that_are_not_the_scene_s_are_refused() {
    let place = Place::new();
    for (line, words) in [
        ("data check --set train.steps=7", &["--set train.steps: not read by data check", "section data and seed"][..]),
        ("data check --set regularizer.kind=depth-smoothness", &["--set regularizer.kind: not read", "with --picture"]),
        ("data check builtin --set data.dir=/nope", &["--set data.dir: the argument DIR names the scene"]),
        ("data check builtin --set 'data={dir = \"/nope\"}'", &["--set data.dir: the argument DIR names the scene"]),
        // No setting at all is answered with the nearest one.
        ("data check --set data.widht=8", &["data.widht", "'data.width'"]),
        (
            "score none --data builtin --set train.steps=9",
            &["--set train.steps: not read by score", "section data and seed"],
        ),
        ("score none --data builtin --set data.dir=/nope", &["--set data.dir: --data names the scene"]),
    ] {
        place.says(line, 2, words);
    }
    // Settings that are read.
    let moved = |seed: u64| {
        place.printed(&format!("data check -q{} --set seed={seed}", set("data.width=8 data.corruption.kind=poses")))
    };
    assert_ne!(moved(1), moved(2));
    let forward = set("data.kind=builtin-forward data.width=16");
    let said = place.printed(&format!("data check builtin --json{forward}"));
    assert_says(&said, &["\"kind\":\"builtin-forward\""]);
    let draw = |set: &str| {
        let said = place.run(&format!("data check --set data.width=8 --picture scene.svg --set {set}"), 0);
        (said, place.text("scene.svg"))
    };
    let (said, drawn) = draw("regularizer.kind=depth-smoothness");
    assert!(drawn.contains("Purple") && !said.contains("no effect"), "{said}");
    let (said, drawn) = draw("regularizer.unseen_poses=sphere");
    assert_says(&said, &["--set regularizer.unseen_poses has no effect: regularizer.kind names no term"]);
    assert!(!drawn.contains("Purple"));
}

#[test]
fn settings_without_effect_are_named_by_every_command_that_trains() {
    let place = Place::new();
    let weights = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/nerf_pytorch.tar");
    let small = set("perturb.xyz.steps=3 train.rays=16 data.width=16");
    let idle = "--set perturb.xyz.steps has no effect: method nerf has no perturbed pass";

    let samples = set("sampling.coarse=24 sampling.fine=24");
    let said = place.run(&format!("import {weights} --out run{samples}{small}"), 0);
    assert!(said.contains(idle) && !said.contains("train.rays has"), "{said}");

    let bench = "bench --rays 8 --coarse 4 --fine 4 --width 8 --steps 1 --threads 1 --set perturb.xyz.steps=3";
    assert_says(&place.run(bench, 0), &[idle]);

    // Every term is measured, where the section says.
    let terms = set("regularizer.kind=tv regularizer.points_per_step=64 train.steps=5");
    let said = place.run(&format!("train --balance=1 --preset smoke{small}{terms}"), 0);
    assert_says(&said, &[idle, "--set regularizer.kind has no effect: --balance measures every term at weight 1"]);
    assert_says(&said, &["--set train.steps has no effect: --balance=STEPS names the steps"]);
    assert!(!said.contains("points_per_step has"), "{said}");
}
