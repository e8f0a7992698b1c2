//! Pictures of any program under our protocol, and rows of a real sweep under their names.

use std::path::{Path, PathBuf};

use crate::common::files::{entries, json, points_of, rows, text};
use crate::common::program::{self, augnerf};
use crate::common::{assert_says, needs};
use serde_json::Value;
use tempfile::TempDir;

const TINY: &str = r#"
title = "tiny"
preset = "smoke"
scenes = ["builtin"]
seeds = [0, 1]
metrics = ["psnr", "ssim"]
baseline = "NeRF"

[set]
"data.width" = 16
"field.width" = 16
"sampling.coarse" = 8
"sampling.fine" = 8
"train.rays" = 64
"train.steps" = 3
"train.eval_every" = 2
"train.log_every" = 1
"eval.pictures" = 100

[[row]]
name = "NeRF"

[[row]]
name = "Aug-NeRF"
set = { method = "aug-nerf" }
"#;

/// Runs in a folder, demands an exit code, and returns everything said.
#[track_caller]
fn demand(dir: &Path, arguments: &[&str], code: i32) -> String {
    program::demand(augnerf(arguments).current_dir(dir), code)
}

/// The line of JSON of a score.
#[track_caller]
fn scored(dir: &Path, arguments: &[&str]) -> Value {
    let said = demand(dir, &[&["score"], arguments, &["--quiet"]].concat(), 0);
    assert_eq!(said.lines().count(), 1, "{said}");
    serde_json::from_str(&said).unwrap()
}

/// A sweep of a few steps.
fn swept() -> TempDir {
    let dir = TempDir::new().unwrap();
    std::fs::write(dir.path().join("tiny.toml"), TINY).unwrap();
    demand(dir.path(), &["sweep", "run", "tiny.toml", "--quiet"], 0);
    dir
}

/// A point's run by its row and seed.
fn run(dir: &Path, row: &str, seed: u64) -> PathBuf {
    let points = points_of(&dir.join("results/tiny"));
    let point = points.iter().find(|point| point["row"] == row && point["seed"] == seed.to_string()).unwrap();
    dir.join("runs/tiny/points").join(&point["id"]).join("run")
}

/// Copies pictures under other names.
fn renamed(from: &Path, to: &Path, name: impl Fn(usize) -> String) {
    std::fs::create_dir_all(to).unwrap();
    let own = entries(from).into_iter().filter(|path| path.to_string_lossy().ends_with("_rgb.png"));
    for (index, path) in own.enumerate() {
        std::fs::copy(path, to.join(name(index))).unwrap();
    }
}

#[test]
fn a_run_s_own_pictures_score_what_it_measured() {
    let work = swept();
    let dir = work.path();
    let run = run(dir, "NeRF", 0);
    let (renders, metrics) = (run.join("renders"), json(&run.join("metrics.json")));
    let [renders, of] = [&renders, &run].map(|path| path.to_str().unwrap());
    let own = scored(dir, &[renders, of, "--out", "views.csv"]);
    for key in ["psnr", "ssim", "floor_psnr"] {
        assert!(own[key].is_f64());
        assert_eq!(own[key], metrics["mean"][key], "{key}");
    }
    assert!(own["psnr_float"].is_null() && own["psnr_of_mean"].is_null(), "{own}");
    assert_eq!(own["protocol"]["data_hash"], metrics["protocol"]["data_hash"]);
    assert_eq!(own["protocol"]["background"], "white");
    let views = rows(&text(&dir.join("views.csv")));
    assert_eq!(views.len(), metrics["views"].as_array().unwrap().len());
    for (row, view) in views.iter().zip(metrics["views"].as_array().unwrap()) {
        assert_eq!(row["name"], view["name"].as_str().unwrap());
        assert_eq!(row["psnr"].parse::<f64>().unwrap(), view["psnr"].as_f64().unwrap());
    }
    // Against the pictures of the photographs, and the scene read anew: the same numbers.
    let folders = scored(dir, &[renders, renders]);
    let scene = scored(dir, &[renders, "--data", "builtin", "--set", "data.width=16"]);
    assert_eq!((&folders["psnr"], &scene["psnr"]), (&own["psnr"], &own["psnr"]));
    assert_eq!((&folders["floor_psnr"], &scene["floor_psnr"]), (&Value::Null, &own["floor_psnr"]), "no training views");
    // Other names in the same order, and what equals its truth.
    let (other, numbered) = (dir.join("other"), |index: usize| format!("r_{}.png", index + 1));
    renamed(Path::new(renders), &other, numbered);
    let ordered = scored(dir, &["other", of, "--match", "order"]);
    assert_eq!(ordered["psnr"], own["psnr"], "more than nine views: r_2 is before r_10");
    let said = demand(dir, &["score", "other", "other", "--match", "order"], 0);
    assert_says(&said, &["infinite", "\"psnr\":null", "\"ssim\":1.0"]);
    // Black pictures.
    for path in entries(&other) {
        image::RgbImage::new(16, 16).save(path).unwrap();
    }
    assert_says(&demand(dir, &["score", "other", of, "--match", "order"], 0), &["no better than one colour"]);
}

/// In `AUGNERF_DATA`, and a folder before the built-in scene of its name.
#[test]
fn the_scene_of_images_is_found_as_in_training() {
    let dir = TempDir::new().unwrap();
    demand(dir.path(), &["data", "export-builtin", "data/synthetic/small", "--width", "16"], 0);
    let score = |data: &str, code: i32| {
        let arguments = ["score", "data/synthetic/small/test", "--data", data, "--set", "data.downscale=1", "--quiet"];
        let mut command = augnerf(&arguments);
        program::demand(command.env("AUGNERF_DATA", dir.path().join("data")).current_dir(dir.path()), code)
    };
    let line: Value = serde_json::from_str(&score("small", 0)).unwrap();
    assert_eq!((&line["truth"], &line["views"], &line["ssim"]), (&"small".into(), &8.into(), &1.0.into()));
    assert_says(&score("nowhere", 3), &["--data nowhere: no such folder, here or in AUGNERF_DATA"]);
    std::fs::create_dir(dir.path().join("builtin")).unwrap();
    assert_says(&score("builtin", 3), &["builtin is no scene"]);
}

#[test]
fn what_cannot_be_scored_is_refused() {
    let work = swept();
    let dir = work.path();
    let run = run(dir, "NeRF", 0);
    let (renders, of) = (run.join("renders"), run.to_str().unwrap());
    renamed(&renders, &dir.join("other"), |index| format!("x_{index}.png"));
    assert_says(&demand(dir, &["score", "other", of], 3), &["has no image of its name", "--match order"]);
    std::fs::remove_file(dir.join("other/x_0.png")).unwrap();
    assert_says(&demand(dir, &["score", "other", of, "--match", "order"], 3), &["images for", "one image a view"]);
    let renders = renders.to_str().unwrap();
    let small = ["score", renders, "--data", "builtin", "--set", "data.width=12"];
    assert_says(&demand(dir, &small, 3), &["is 16x16 pixels", "is 12x12", "data.width"]);
    assert_says(&demand(dir, &["score", renders], 2), &["no ground truth", "--data"]);
    std::fs::create_dir(dir.join("empty")).unwrap();
    assert_says(&demand(dir, &["score", "empty", of], 3), &["empty holds no PNG, JPEG or WebP files"]);
    assert_says(&demand(dir, &["score", "nowhere", of], 3), &["nowhere"]);
    std::fs::create_dir(dir.join("clear")).unwrap();
    image::RgbaImage::from_pixel(16, 16, image::Rgba([10, 20, 30, 40])).save(dir.join("clear/0.png")).unwrap();
    assert_says(&demand(dir, &["score", "clear", "clear"], 3), &["transparent", "--background"]);
    demand(dir, &["score", "clear", "clear", "--background", "black"], 0);
    std::fs::write(dir.join("clear/0.png"), "no picture").unwrap();
    assert_says(&demand(dir, &["score", "clear", "clear"], 3), &["0.png"]);
}

#[test]
fn rows_of_a_sweep_are_compared_by_their_names() {
    let work = swept();
    let dir = work.path();
    demand(dir, &["compare", "runs/tiny", "--rows", "Aug-NeRF,NeRF", "--seed", "1", "--out", "pair", "--quiet"], 0);
    let compared = json(&dir.join("pair/compare.json"));
    let text = compared.to_string();
    assert!(text.find("\"Aug-NeRF\"").unwrap() < text.find("\"NeRF\"").unwrap(), "{text}");
    let seeds: Vec<&Value> = compared["runs"].as_array().unwrap().iter().map(|run| &run["protocol"]["seed"]).collect();
    assert_eq!(seeds, [&Value::from(1), &Value::from(1)]);
    demand(dir, &["compare", "runs/tiny", "--ray", "8,8", "--out", "ray", "--quiet"], 0);
    assert_says(&demand(dir, &["compare", "runs/tiny", "--rows", "Nerf"], 2), &["'Nerf' is not a row", "Aug-NeRF"]);
    assert_says(&demand(dir, &["compare", "runs/tiny", "--seed", "7"], 2), &["--seed 7", "0, 1"]);
    assert_says(&demand(dir, &["compare", "runs/tiny", "--scene", "fern"], 2), &["--scene fern", "builtin"]);
    let run = run(dir, "NeRF", 0);
    let run = run.to_str().unwrap();
    assert_says(&demand(dir, &["compare", run, "--seed", "0"], 2), &["not a sweep"]);
    assert_says(&demand(dir, &["compare", "runs/tiny", run], 2), &["name it alone"]);
}

#[test]
#[ignore = "needs AUGNERF_LPIPS_WEIGHTS"]
fn lpips_and_the_average_are_those_of_an_evaluation() {
    let dir = TempDir::new().unwrap();
    let weights = needs::lpips_weights();
    let weights = weights.to_str().unwrap();
    let train = ["train", "--quiet", "--out", "run", "--preset", "smoke", "--lpips-weights", weights];
    let set = ["--set", "train.steps=2", "--set", "data.width=40", "--set", "eval.pictures=100"];
    demand(dir.path(), &[&train[..], &set].concat(), 0);
    let metrics = json(&dir.path().join("run/metrics.json"));
    let own = scored(dir.path(), &["run/renders", "run", "--lpips-weights", weights]);
    for key in ["psnr", "lpips_squeeze", "average_squeeze"] {
        assert!(metrics["mean"][key].is_f64(), "{key}");
        assert_eq!(own[key], metrics["mean"][key], "{key}");
    }
    assert_eq!(own["protocol"]["lpips_weights"], metrics["protocol"]["lpips_weights"]);
}
