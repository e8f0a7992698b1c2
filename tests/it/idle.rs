//! Flags and settings that would change nothing: they are refused, or a note names them.

use std::path::Path;

use crate::common::assert_says;
use crate::common::program::{printed, refuse, succeed};
use tempfile::TempDir;

/// What a command says besides its result.
fn noted(arguments: &[&str]) -> String {
    String::from_utf8(succeed(arguments).stderr).unwrap()
}

/// A mesh that is there is drawn as it is, and nothing else is written.
#[test]
fn flags_that_extract_a_mesh_are_refused_for_one_that_is_there() {
    let dir = TempDir::new().unwrap();
    let [picture, out] = ["mesh.png", "out"].map(|name| dir.path().join(name));
    let draw = ["mesh", "builtin", "--picture", picture.to_str().unwrap()];
    for flags in [
        &["--data", "/nope"][..],
        &["--resolution", "16"],
        &["--threshold", "1"],
        &["--bbox", "-1,-1,-1,1,1,1"],
        &["--preset", "paper"],
        &["--cap"],
        &["--largest"],
        &["--out", out.to_str().unwrap()],
        &["--format", "ply"],
        &["--units", "scene"],
        &["--normals", "triangles"],
        &["--density"],
        &["--memory", "5"],
    ] {
        let words = format!("{}: builtin is already a mesh", flags[0]);
        refuse(&[&draw[..], flags].concat(), 2, &[&words, "name a run folder"]);
    }
    assert!(!picture.exists() && !out.exists());
}

/// Cameras that are written are not rendered, and poses alone have no size.
#[test]
fn flags_of_images_are_refused_where_cameras_are_written() {
    let dir = TempDir::new().unwrap();
    let run = dir.path().join("none");
    let write = |file: &'static str| ["render", run.to_str().unwrap(), "--write-cameras", file];
    refuse(
        &[&write("p.json")[..], &["--out", "DIR"]].concat(),
        2,
        &["--write-cameras", "cannot be used with", "--out"],
    );
    for flag in [["--resolution", "8x8"], ["--fps", "2"]] {
        let words = format!("{}: p.npy holds poses alone", flag[0]);
        refuse(&[&write("p.npy")[..], &flag].concat(), 2, &[&words, ".json"]);
        // The other file has both, so that only the run is missing.
        refuse(&[&write("p.json")[..], &flag].concat(), 5, &["none"]);
    }
}

#[test]
fn settings_that_are_not_the_scene_s_are_refused() {
    let dir = TempDir::new().unwrap();
    let check = |further: &[&str], words: &[&str]| refuse(&[&["data", "check"], further].concat(), 2, words);
    check(&["--set", "train.steps=7"], &["--set train.steps: not read by data check", "section data and seed"]);
    check(&["--set", "regularizer.kind=depth-smoothness"], &["--set regularizer.kind: not read", "with --picture"]);
    for folder in ["data.dir=/nope", "data={dir = \"/nope\"}"] {
        check(&["builtin", "--set", folder], &["--set data.dir: the argument DIR names the scene"]);
    }
    // No setting at all is answered with the nearest one.
    check(&["--set", "data.widht=8"], &["data.widht", "'data.width'"]);
    let score = |set: &str, words: &[&str]| refuse(&["score", "none", "--data", "builtin", "--set", set], 2, words);
    score("train.steps=9", &["--set train.steps: not read by score", "section data and seed"]);
    score("data.dir=/nope", &["--set data.dir: --data names the scene"]);

    // Settings that are read.
    let small = ["data", "check", "-q", "--set", "data.width=8", "--set"];
    let moved = |seed: &str| printed(&[&small[..], &["data.corruption.kind=poses", "--set", seed]].concat());
    assert_ne!(moved("seed=1"), moved("seed=2"));
    let forward = ["--json", "--set", "data.kind=builtin-forward", "--set", "data.width=16"];
    assert_says(&printed(&[&["data", "check", "builtin"], &forward[..]].concat()), &["\"kind\":\"builtin-forward\""]);
    let picture = dir.path().join("scene.svg");
    let draw = |set: &str| {
        let drawn = ["data", "check", "--set", "data.width=8", "--picture", picture.to_str().unwrap(), "--set", set];
        (noted(&drawn), std::fs::read_to_string(&picture).unwrap())
    };
    let (said, drawn) = draw("regularizer.kind=depth-smoothness");
    assert!(drawn.contains("Purple") && !said.contains("no effect"), "{said}");
    let (said, drawn) = draw("regularizer.unseen_poses=sphere");
    assert_says(&said, &["--set regularizer.unseen_poses has no effect: regularizer.kind names no term"]);
    assert!(!drawn.contains("Purple"));
}

#[test]
fn settings_without_effect_are_named_by_every_command_that_trains() {
    let dir = TempDir::new().unwrap();
    let out = dir.path().join("run");
    let weights = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/nerf_pytorch.tar");
    let set = ["--set", "perturb.xyz.steps=3", "--set", "train.rays=16", "--set", "data.width=16"];
    let idle = "--set perturb.xyz.steps has no effect: method nerf has no perturbed pass";

    let samples = ["--set", "sampling.coarse=24", "--set", "sampling.fine=24"];
    let import = ["import", weights.to_str().unwrap(), "--out", out.to_str().unwrap()];
    let said = noted(&[&import[..], &samples, &set].concat());
    assert!(said.contains(idle) && !said.contains("train.rays has"), "{said}");

    let bench = "bench --rays 8 --coarse 4 --fine 4 --width 8 --steps 1 --threads 1";
    assert_says(&noted(&[&bench.split(' ').collect::<Vec<_>>()[..], &set[..2]].concat()), &[idle]);

    // Every term is measured, where the section says.
    let terms = ["--set", "regularizer.kind=tv", "--set", "regularizer.points_per_step=64", "--set", "train.steps=5"];
    let said = noted(&[&["train", "--balance=1", "--preset", "smoke"], &set[..], &terms].concat());
    assert_says(&said, &[idle, "--set regularizer.kind has no effect: --balance measures every term at weight 1"]);
    assert_says(&said, &["--set train.steps has no effect: --balance=STEPS names the steps"]);
    assert!(!said.contains("points_per_step has"), "{said}");
}
