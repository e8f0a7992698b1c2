//! A run and its scene: read again as it was when the run began, by whatever version, or refused.

use std::fs;

use augnerf::data::{Scene, View};
use serde_json::json;

use crate::captures::Folder;
use crate::common::files::{seal, text};
use crate::common::program::{Place, set};

/// A folder with a run on a capture, `run`.
fn trained(folder: &Folder) -> Place {
    folder.load(|_| {});
    let place = Place::new();
    let small =
        "data.downscale=1 field.width=16 field.depth=2 field.skips=[] train.rays=32 eval.pictures=0 train.steps=2";
    let data = folder.path().display();
    place.run(&format!("train --data {data} --preset smoke --out run -q{}", set(small)), 0);
    place
}

#[test]
fn a_scene_that_has_changed_is_refused_whatever_reads_the_run() {
    let folder = Folder::new(17);
    let place = trained(&folder);
    let before = place.text("run/metrics.json");
    let views = &place.json("run/scene.json")["views"];
    assert_eq!(views["evaluated"], json!(["0", "16", "9"]), "every 8th by the files' names");
    assert_eq!(views["trained"].as_array().unwrap().len(), 14);
    place.run("eval run -q", 0);
    place.run("eval run -q --split train", 0);
    let refused = |words: &[&str]| {
        for command in ["eval run", "render run --frames 1", "resume run", "mesh run --resolution 8"] {
            place.says(command, 3, &[&["scene.json", "--data"], words].concat());
        }
        assert_eq!(place.text("run/metrics.json"), before);
    };
    let gone = folder.path().join("images/1.png");
    let kept = fs::read(&gone).unwrap();
    fs::remove_file(&gone).unwrap();
    refused(&["trained on", "1 are gone (1)"]);
    fs::write(&gone, &kept).unwrap();
    place.run("eval run -q", 0);
    // A single transparent pixel puts a background behind all rays.
    let mut clear = image::open(&gone).unwrap().to_rgba8();
    clear.get_pixel_mut(0, 0).0[3] = 0;
    clear.save(&gone).unwrap();
    refused(&["its background was none, but now is white"]);
    fs::write(&gone, kept).unwrap();
    place.run("eval run -q", 0);
    // Another pose moves all of them.
    let sound = text(&folder.path().join("transforms.json"));
    fs::write(folder.path().join("transforms.json"), sound.replacen("0.5]", "0.75]", 1)).unwrap();
    refused(&["other coordinates", "restore its files, name their folder"]);
    // An earlier version may have read the same files otherwise.
    let checkpoint = "run/checkpoints/step_000000002";
    let mut state = place.json(&format!("{checkpoint}/state.json"));
    state["revisions"][0] = "0a1b2c3d4e5f".into();
    place.write(&format!("{checkpoint}/state.json"), state.to_string());
    seal(&place.at(checkpoint));
    let other = "revision 0a1b2c3d4e5f, which trained the run, may have read the same files otherwise";
    refused(&["other coordinates", other]);
}

/// It leaves its place, and no other view changes place or side.
#[test]
fn a_photograph_that_is_gone_moves_no_other() {
    let folder = Folder::new(17);
    let whole = folder.load(|_| {});
    folder.remove(1);
    let without = folder.load(|_| {});
    let told = |views: &[View]| {
        let told = views.iter().filter(|view| view.name != "1").map(|view| (view.name.clone(), view.camera.pose));
        told.collect::<Vec<_>>()
    };
    assert_eq!(whole.train.len(), without.train.len() + 1);
    assert_eq!((told(&whole.train), told(&whole.test)), (told(&without.train), told(&without.test)));
    assert_eq!(whole.space.world, without.space.world);
    assert_eq!(whole.path.len(), without.path.len());
    // A name is of the whole list, too.
    let folder = Folder::new(9);
    let mut frames = folder.document()["frames"].clone();
    fs::create_dir(folder.path().join("other")).unwrap();
    fs::rename(folder.path().join("images/3.png"), folder.path().join("other/2.png")).unwrap();
    frames[3]["file_path"] = "other/2.png".into();
    let folder = folder.with("frames", frames);
    let name = |scene: &Scene| scene.train.iter().chain(&scene.test).any(|view| view.name == "images_2");
    assert!(name(&folder.load(|_| {})));
    fs::remove_file(folder.path().join("other/2.png")).unwrap();
    assert!(name(&folder.load(|_| {})));
}
