//! A run and its scene: read again as it was when the run began, by whatever version, or refused.

use std::fs;
use std::path::{Path, PathBuf};

use augnerf::data::npy::read_array;
use augnerf::data::pose::Pose;
use augnerf::data::{Scene, View};
use augnerf::settings::Axes;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::captures::Folder;
use crate::common::files::{json as read_json, seal, text};
use crate::common::program::{Place, refuse, set, succeed};

fn train(data: &Path, out: &Path, further: &str) {
    let small =
        "data.downscale=1 field.width=16 field.depth=2 field.skips=[] train.rays=32 eval.pictures=0 train.steps=2";
    let [data, out] = [data, out].map(|path| path.to_str().unwrap());
    Place::new().run(&format!("train --data {data} --preset smoke --out {out} -q{}{further}", set(small)), 0);
}

#[test]
fn a_scene_that_has_changed_is_refused_whatever_reads_the_run() {
    let (folder, out) = (Folder::new(17), TempDir::new().unwrap());
    folder.load(|_| {});
    let run = out.path().join("run");
    train(folder.path(), &run, "");
    let (name, before) = (run.to_str().unwrap(), text(&run.join("metrics.json")));
    let views = &read_json(&run.join("scene.json"))["views"];
    assert_eq!(views["evaluated"], json!(["0", "16", "9"]), "every 8th by the files' names");
    assert_eq!(views["trained"].as_array().unwrap().len(), 14);
    succeed(&["eval", name, "-q"]);
    succeed(&["eval", name, "-q", "--split", "train"]);
    let refused = |words: &[&str]| {
        for command in [&["eval"][..], &["render", "--frames", "1"], &["resume"], &["mesh", "--resolution", "8"]] {
            refuse(&[command, &[name]].concat(), 3, &[&["scene.json", "--data"], words].concat());
        }
        assert_eq!(text(&run.join("metrics.json")), before);
    };
    let gone = folder.path().join("images/1.png");
    let kept = fs::read(&gone).unwrap();
    fs::remove_file(&gone).unwrap();
    refused(&["trained on", "1 are gone (1)"]);
    fs::write(&gone, kept).unwrap();
    succeed(&["eval", name, "-q"]);
    // A single transparent pixel puts a background behind all rays.
    let kept = fs::read(&gone).unwrap();
    let mut clear = image::open(&gone).unwrap().to_rgba8();
    clear.get_pixel_mut(0, 0).0[3] = 0;
    clear.save(&gone).unwrap();
    refused(&["its background was none, but now is white"]);
    fs::write(&gone, kept).unwrap();
    succeed(&["eval", name, "-q"]);
    // Another pose moves all of them.
    let sound = text(&folder.path().join("transforms.json"));
    fs::write(folder.path().join("transforms.json"), sound.replacen("0.5]", "0.75]", 1)).unwrap();
    refused(&["other coordinates", "restore its files, name their folder"]);
    // An earlier version may have read the same files otherwise.
    let checkpoint = run.join("checkpoints/step_000000002");
    let mut state = read_json(&checkpoint.join("state.json"));
    state["revisions"][0] = "0a1b2c3d4e5f".into();
    fs::write(checkpoint.join("state.json"), state.to_string()).unwrap();
    seal(&checkpoint);
    refused(&[
        "other coordinates",
        "revision 0a1b2c3d4e5f, which trained the run, may have read the same files otherwise",
    ]);
}

/// A capture's own file has the capture's cameras, whatever the axes of its matrices. Files that are written have OpenGL's.
#[test]
fn the_cameras_of_a_capture_s_own_file_are_its_views() {
    let turned = |frame: &Value| {
        let mut frame = frame.clone();
        for row in frame["transform_matrix"].as_array_mut().unwrap().iter_mut().take(3) {
            (1..3).for_each(|column| row[column] = (-row[column].as_f64().unwrap()).into());
        }
        frame
    };
    let folder = Folder::new(9).with("w", 16.into()).with("h", 12.into());
    let frames: Vec<Value> = folder.document()["frames"].as_array().unwrap().iter().map(turned).collect();
    let folder = folder.with("frames", frames.into());
    let scene = folder.load(|config| config.axes = Axes::Opencv);
    let dir = TempDir::new().unwrap();
    let run = dir.path().join("run");
    train(folder.path(), &run, &set("data.axes=opencv"));
    let copied = |from: &Path, to: &str| -> PathBuf {
        let to = dir.path().join(to);
        let [run, from, file] = [run.as_path(), from, to.as_path()].map(|path| path.to_str().unwrap());
        succeed(&["render", run, "--cameras", from, "--write-cameras", file, "-q"]);
        to
    };
    let poses = |file: &Path| -> Vec<Pose> {
        let values = read_array(file).unwrap().values;
        let pose =
            |of: &[f64]| -> Pose { std::array::from_fn(|row| std::array::from_fn(|column| of[4 * row + column])) };
        values.chunks_exact(12).map(pose).collect()
    };
    let close = |a: &Pose, b: &Pose| a.iter().flatten().zip(b.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-9);
    let own = folder.path().join("transforms.json");
    let array = copied(&own, "own.npy");
    let written = poses(&array);
    assert_eq!(written.len(), 9);
    for View { name, camera, .. } in scene.train.iter().chain(&scene.test) {
        let number: usize = name.parse().unwrap();
        assert!(close(&scene.space.world.camera(&written[number]), &camera.pose), "{name}");
    }
    let path = copied(&own, "path.json");
    for again in [copied(&array, "again.npy"), copied(&path, "of_path.npy")] {
        assert!(poses(&again).iter().zip(&written).all(|(a, b)| close(a, b)), "{}", again.display());
    }
}

/// It leaves its place, and no other view changes place or side.
#[test]
fn a_photograph_that_is_gone_moves_no_other() {
    let folder = Folder::new(17);
    let whole = folder.load(|_| {});
    folder.remove(1);
    let without = folder.load(|_| {});
    let told = |views: &[augnerf::data::View]| {
        let told = views.iter().filter(|view| view.name != "1").map(|view| (view.name.clone(), view.camera.pose));
        told.collect::<Vec<_>>()
    };
    assert_eq!(whole.train.len(), without.train.len() + 1);
    assert_eq!((told(&whole.train), told(&whole.test)), (told(&without.train), told(&without.test)));
    assert_eq!(whole.space.world, without.space.world);
    assert_eq!(whole.path.len(), without.path.len());
    // A name is of the whole list, too.
    let rename = |folder: Folder| {
        let mut frames = folder.document()["frames"].clone();
        fs::create_dir(folder.path().join("other")).unwrap();
        fs::rename(folder.path().join("images/3.png"), folder.path().join("other/2.png")).unwrap();
        frames[3]["file_path"] = "other/2.png".into();
        folder.with("frames", frames)
    };
    let folder = rename(Folder::new(9));
    let name = |scene: &Scene| scene.train.iter().chain(&scene.test).any(|view| view.name == "images_2");
    assert!(name(&folder.load(|_| {})));
    fs::remove_file(folder.path().join("other/2.png")).unwrap();
    assert!(name(&folder.load(|_| {})));
}

/// What others are given tells nothing of where things lie here, and they name the scene.
#[test]
fn exported_weights_tell_no_folders() {
    let (folder, out) = (Folder::new(9), TempDir::new().unwrap());
    folder.load(|_| {});
    let [run, file, back] = ["run", "a.safetensors", "back"].map(|name| out.path().join(name));
    train(folder.path(), &run, "");
    let [name, file, back] = [&run, &file, &back].map(|path| path.to_str().unwrap());
    succeed(&["export", name, file, "-q"]);
    let bytes = fs::read(file).unwrap();
    let (_, header) = safetensors::SafeTensors::read_metadata(&bytes).unwrap();
    let said = &header.metadata().as_ref().unwrap()["augnerf"];
    assert!(!said.contains(folder.path().to_str().unwrap()), "{said}");
    refuse(&["import", file, "--out", back], 2, &["data.dir"]);
    succeed(&["import", file, "--out", back, "--data", folder.path().to_str().unwrap(), "-q"]);
    succeed(&["eval", back, "-q"]);
    let psnr = |run: &str| read_json(&Path::new(run).join("metrics.json"))["mean"]["psnr"].clone();
    assert_eq!(psnr(back), psnr(name));
}
