//! Pictures of any program under our protocol, and rows of a real sweep under their names.

use std::path::Path;

use crate::common::files::{entries, points_of, rows};
use crate::common::program::{Place, demand, set, tiny_sweep};
use crate::common::{assert_says, needs};
use serde_json::Value;

/// The line of JSON of a score.
#[track_caller]
fn scored(place: &Place, further: &str) -> Value {
    let said = place.run(&format!("score {further} --quiet"), 0);
    assert_eq!(said.lines().count(), 1, "{said}");
    serde_json::from_str(&said).unwrap()
}

/// A sweep of a few steps.
fn swept() -> Place {
    Place::once("score", |place| {
        let settings = "train.steps=3 train.eval_every=2 train.log_every=1 eval.pictures=100";
        let rows = [("Aug-NeRF", "method = \"aug-nerf\"")];
        place.write("tiny.toml", tiny_sweep(&[0, 1], &["psnr", "ssim"], settings, &rows));
        place.run("sweep run tiny.toml --quiet", 0);
    })
}

/// A point's run, by its row and seed.
fn run(place: &Place, row: &str, seed: u64) -> String {
    let points = points_of(&place.at("results/tiny"));
    let point = points.iter().find(|point| point["row"] == row && point["seed"] == seed.to_string()).unwrap();
    format!("runs/tiny/points/{}/run", point["id"])
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
    let place = swept();
    let run = run(&place, "NeRF", 0);
    let (renders, metrics) = (format!("{run}/renders"), place.json(&format!("{run}/metrics.json")));
    let own = scored(&place, &format!("{renders} {run} --out views.csv"));
    for key in ["psnr", "ssim", "floor_psnr"] {
        assert!(own[key].is_f64());
        assert_eq!(own[key], metrics["mean"][key], "{key}");
    }
    assert!(own["psnr_float"].is_null() && own["psnr_of_mean"].is_null(), "{own}");
    assert_eq!(own["protocol"]["data_hash"], metrics["protocol"]["data_hash"]);
    assert_eq!(own["protocol"]["background"], "white");
    let views = rows(&place.text("views.csv"));
    assert_eq!(views.len(), metrics["views"].as_array().unwrap().len());
    for (row, view) in views.iter().zip(metrics["views"].as_array().unwrap()) {
        assert_eq!(row["name"], view["name"].as_str().unwrap());
        assert_eq!(row["psnr"].parse::<f64>().unwrap(), view["psnr"].as_f64().unwrap());
    }
    // Against the pictures of the photographs, and the scene read anew: the same numbers.
    let folders = scored(&place, &format!("{renders} {renders}"));
    let scene = scored(&place, &format!("{renders} --data builtin --set data.width=16"));
    assert_eq!((&folders["psnr"], &scene["psnr"]), (&own["psnr"], &own["psnr"]));
    assert_eq!((&folders["floor_psnr"], &scene["floor_psnr"]), (&Value::Null, &own["floor_psnr"]), "no training views");
    // Other names in the same order, and what equals its truth.
    let other = place.at("other");
    renamed(&place.at(&renders), &other, |index| format!("r_{}.png", index + 1));
    let ordered = scored(&place, &format!("other {run} --match order"));
    assert_eq!(ordered["psnr"], own["psnr"], "more than nine views: r_2 is before r_10");
    place.says("score other other --match order", 0, &["infinite", "\"psnr\":null", "\"ssim\":1.0"]);
    // Black pictures.
    for path in entries(&other) {
        image::RgbImage::new(16, 16).save(path).unwrap();
    }
    place.says(&format!("score other {run} --match order"), 0, &["no better than one colour"]);
}

/// In `AUGNERF_DATA`, and a folder before the built-in scene of its name.
#[test]
fn the_scene_of_images_is_found_as_in_training() {
    let place = Place::new();
    place.run("data export-builtin data/synthetic/small --width 16", 0);
    let score = |data: &str, code: i32| {
        let line = format!("score data/synthetic/small/test --data {data} --set data.downscale=1 --quiet");
        demand(place.command(&line).env("AUGNERF_DATA", place.at("data")), code)
    };
    let line: Value = serde_json::from_str(&score("small", 0)).unwrap();
    assert_eq!((&line["truth"], &line["views"], &line["ssim"]), (&"small".into(), &8.into(), &1.0.into()));
    assert_says(&score("nowhere", 3), &["--data nowhere: no such folder, here or in AUGNERF_DATA"]);
    std::fs::create_dir(place.at("builtin")).unwrap();
    assert_says(&score("builtin", 3), &["builtin is no scene"]);
}

#[test]
fn what_cannot_be_scored_is_refused() {
    let place = swept();
    let run = run(&place, "NeRF", 0);
    let renders = &format!("{run}/renders");
    renamed(&place.at(renders), &place.at("other"), |index| format!("x_{index}.png"));
    renamed(&place.at(renders), &place.at("fewer"), |index| format!("x_{}.png", index / 2));
    for folder in ["empty", "clear"] {
        std::fs::create_dir(place.at(folder)).unwrap();
    }
    image::RgbaImage::from_pixel(16, 16, image::Rgba([10, 20, 30, 40])).save(place.at("clear/0.png")).unwrap();
    place.write("broken/0.png", "no picture");
    place.run("score clear clear --background black", 0);
    for (line, code, words) in [
        (format!("other {run}"), 3, &["has no image of its name", "--match order"][..]),
        (format!("fewer {run} --match order"), 3, &["images for", "one image a view"]),
        (format!("{renders} --data builtin --set data.width=12"), 3, &["is 16x16 pixels", "is 12x12", "data.width"]),
        (renders.clone(), 2, &["no ground truth", "--data"]),
        (format!("empty {run}"), 3, &["empty holds no PNG, JPEG or WebP files"]),
        (format!("nowhere {run}"), 3, &["nowhere"]),
        ("clear clear".into(), 3, &["transparent", "--background"]),
        ("broken broken".into(), 3, &["0.png"]),
    ] {
        place.says(&format!("score {line}"), code, words);
    }
}

#[test]
fn rows_of_a_sweep_are_compared_by_their_names() {
    let place = swept();
    place.run("compare runs/tiny --rows Aug-NeRF,NeRF --seed 1 --out pair --quiet", 0);
    let compared = place.json("pair/compare.json");
    let text = compared.to_string();
    assert!(text.find("\"Aug-NeRF\"").unwrap() < text.find("\"NeRF\"").unwrap(), "{text}");
    let seeds: Vec<&Value> = compared["runs"].as_array().unwrap().iter().map(|run| &run["protocol"]["seed"]).collect();
    assert_eq!(seeds, [&Value::from(1), &Value::from(1)]);
    place.run("compare runs/tiny --ray 8,8 --out ray --quiet", 0);
    place.says("compare runs/tiny --rows Nerf", 2, &["'Nerf' is not a row", "Aug-NeRF"]);
    place.says("compare runs/tiny --seed 7", 2, &["--seed 7", "0, 1"]);
    place.says("compare runs/tiny --scene fern", 2, &["--scene fern", "builtin"]);
    let run = run(&place, "NeRF", 0);
    place.says(&format!("compare {run} --seed 0"), 2, &["not a sweep"]);
    place.says(&format!("compare runs/tiny {run}"), 2, &["name it alone"]);
}

#[test]
#[ignore = "needs AUGNERF_LPIPS_WEIGHTS"]
fn lpips_and_the_average_are_those_of_an_evaluation() {
    let place = Place::new();
    let weights = needs::lpips_weights();
    let weights = format!("--lpips-weights {}", weights.display());
    let small = set("train.steps=2 data.width=40 eval.pictures=100");
    place.run(&format!("train --quiet --out run --preset smoke {weights}{small}"), 0);
    let metrics = place.json("run/metrics.json");
    let own = scored(&place, &format!("run/renders run {weights}"));
    for key in ["psnr", "lpips_squeeze", "average_squeeze"] {
        assert!(metrics["mean"][key].is_f64(), "{key}");
        assert_eq!(own[key], metrics["mean"][key], "{key}");
    }
    assert_eq!(own["protocol"]["lpips_weights"], metrics["protocol"]["lpips_weights"]);
}
