//! Captures of strangers: small copies of each kind of fault that was found in published scenes (tests/fixtures/captures3).

use std::path::{Path, PathBuf};

use serde_json::Value;
use tempfile::TempDir;

use crate::common::files::{copy, entries, json};
use crate::common::program::{demand, printed, refuse};
use crate::common::{assert_says, program};

/// The folder of a capture.
pub fn capture(name: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/captures3").join(name);
    folder.to_str().unwrap().to_string()
}

/// A copy of a capture, to be changed.
pub fn copied(name: &str) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    copy(Path::new(&capture(name)), dir.path());
    dir
}

/// What `data check` says of it, with further settings.
fn check(name: &str, settings: &[&str]) -> String {
    check_folder(Path::new(&capture(name)), settings)
}

pub fn check_folder(folder: &Path, settings: &[&str]) -> String {
    let mut arguments = vec!["data", "check", folder.to_str().unwrap(), "--set", "data.downscale=1"];
    settings.iter().for_each(|setting| arguments.extend(["--set", setting]));
    let out = program::succeed(&arguments);
    format!("{}{}", String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr))
}

/// It is refused with these words.
fn is_refused(name: &str, words: &[&str]) {
    refuse(&["data", "check", &capture(name), "--set", "data.downscale=1"], 3, words);
}

#[test]
fn the_colmap_model_with_most_photos_is_read_and_the_others_are_named() {
    let said = check("colmap_split", &[]);
    assert_says(&said, &["2 COLMAP models: sparse/0 (2 photos), sparse/1 (8 photos); sparse/1 is read", "sparse/1: "]);
    let said = check("colmap_split", &["data.colmap_model=sparse/0"]);
    assert_says(&said, &["6 of the 8 photos in images are not in the COLMAP model", "only 1 view trains"]);
    assert_says(&check("colmap_only1", &[]), &["sparse/1: "]);
    let folder = capture("colmap_split");
    let unknown = ["data", "check", &folder, "--set", "data.colmap_model=sparse/7"];
    refuse(&unknown, 3, &["data.colmap_model = \"sparse/7\" is no COLMAP model", "sparse/1 (8 photos)"]);
}

#[test]
fn cameras_that_cannot_be_right_are_named() {
    assert_says(&check("axes_opencv", &[]), &["look away from their common point", "data.axes=opencv"]);
    let said = check("axes_opencv", &["data.axes=opencv"]);
    assert!(!said.contains("look away"), "{said}");
    assert_says(&check("one_place", &[]), &["all 8 cameras stand in one place"]);
    is_refused("centre_outside", &["principal point", "more than half a picture outside", "\"w\" and \"h\""]);
    is_refused("orthographic", &["\"orthographic\" says that the camera is orthographic"]);
}

#[test]
fn masks_that_lie_there_are_named_and_read() {
    for (name, value) in [("masks_llff", "masks"), ("masks_colmap", "masks"), ("masks_dynamic", "beside")] {
        let said = check(name, &[]);
        assert_says(&said, &["8 of 8 photos have masks in", "which are not used", &format!("data.masks={value} uses")]);
        assert_says(&check(name, &[&format!("data.masks={value}")]), &["8 of 8 photos have masks, by data.masks"]);
        let said = check(name, &["data.masks=none"]);
        assert!(!said.contains("photos have masks"), "{name}: {said}");
    }
    let folder = capture("masks_llff");
    let other = ["data", "check", &folder, "--set", "data.downscale=1", "--set", "data.masks=nowhere"];
    refuse(&other, 3, &["data.masks = \"nowhere\"", "has no mask of its 8 photos"]);
}

#[test]
fn photos_that_lie_elsewhere_are_found() {
    for (name, count) in [("elsewhere_root", 8), ("elsewhere_below", 6), ("letter_case", 8)] {
        let words = format!("{count} photos are not where \"file_path\" says, and were found elsewhere");
        let said = check(name, &[]);
        // On file systems that ignore letter case they are where they are named.
        assert!(said.contains(&words) || name == "letter_case", "{name}: {said}");
    }
}

/// Names that mean one file: `Küche` in one piece in the file of poses, with the accent apart on the disk, and the like.
#[test]
fn names_in_another_letter_case_or_unicode_form_are_found() {
    let dir = copied("colmap_only1");
    let images = dir.path().join("images");
    let poses = dir.path().join("sparse/1/images.txt");
    let text = std::fs::read_to_string(&poses).unwrap();
    std::fs::write(&poses, text.replace("0001.jpg", "K\u{fc}che.jpg").replace("0002.jpg", "zwei.jpg")).unwrap();
    std::fs::rename(images.join("0001.jpg"), images.join("Ku\u{308}che.jpg")).unwrap();
    std::fs::rename(images.join("0002.jpg"), images.join("Zwei.JPG")).unwrap();
    let said = check_folder(dir.path(), &[]);
    let counted = said.split_once("the names of ").map(|(_, rest)| &rest[..1]);
    // File systems that ignore letter case or forms find some by themselves.
    assert!(cfg!(not(target_os = "linux")) || counted == Some("2"), "{said}");
    assert!(!said.contains("are left out"), "{said}");

    let dir = copied("pose_null");
    let poses = dir.path().join("transforms.json");
    let text = std::fs::read_to_string(&poses).unwrap();
    let first = entries(&dir.path().join("images")).remove(0);
    let name = first.file_name().unwrap().to_str().unwrap();
    std::fs::rename(&first, first.with_file_name("Ku\u{308}che.jpg")).unwrap();
    std::fs::write(&poses, text.replace(name, "K\u{fc}che.jpg")).unwrap();
    let said = check_folder(dir.path(), &[]);
    assert!(!said.contains("are not there and are left out"), "{said}");
}

#[test]
fn a_scene_s_own_file_stands_for_its_folder_and_a_near_miss_is_named() {
    is_refused("near_miss_name", &["transform_train.json is probably a scene's transforms_train.json; rename it"]);
    let file = format!("{}/transforms.json", capture("pose_null"));
    assert_says(&printed(&["data", "check", &file, "--set", "data.downscale=1"]), &["scene  pose_null"]);
    let frame = format!("{}/images/0001.jpg", capture("pose_null"));
    refuse(&["data", "check", &frame], 3, &["is a file, but a scene is a folder"]);
    let dir = tempfile::tempdir().unwrap();
    let poses = r#"{"camera_angle_x": 0.7, "frames": [{"file_path": "images/photo_l.png",
        "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]}]}"#;
    std::fs::write(dir.path().join("transforms.json"), poses).unwrap();
    std::fs::copy(&frame, dir.path().join("photo_1.jpg")).unwrap();
    refuse(&["data", "check", dir.path().to_str().unwrap()], 3, &["the nearest name there is photo_1.jpg"]);
}

/// A copy of a capture whose file of poses is changed.
fn changed(name: &str, file: &str, change: impl Fn(&mut Value)) -> TempDir {
    let dir = copied(name);
    let file = dir.path().join(file);
    let mut value = json(&file);
    change(&mut value);
    std::fs::write(file, value.to_string()).unwrap();
    dir
}

const POSES: &str = "transforms.json";

/// Changes each frame, by its number.
fn frames(value: &mut Value, change: impl Fn(usize, &mut Value)) {
    value["frames"].as_array_mut().unwrap().iter_mut().enumerate().for_each(|(number, frame)| change(number, frame));
}

fn says(dir: &TempDir, words: &[&str]) {
    assert_says(&check_folder(dir.path(), &[]), words);
}

fn refuses(dir: &TempDir, words: &[&str]) {
    refuse(&["data", "check", dir.path().to_str().unwrap(), "--set", "data.downscale=1"], 3, words);
}

#[test]
fn a_photo_is_one_however_it_is_spelt() {
    let again = |turn: bool| {
        changed("letter_case", POSES, |value| {
            let list = value["frames"].as_array_mut().unwrap();
            let mut frame = list[0].clone();
            let name = frame["file_path"].as_str().unwrap().replace(".jpg", ".JPG");
            list[0]["file_path"] = name.clone().into();
            frame["file_path"] = format!("./images/../{name}").into();
            frame["transform_matrix"][0][3] =
                (if turn { 7.0 } else { frame["transform_matrix"][0][3].as_f64().unwrap() }).into();
            list.push(frame);
        })
    };
    says(&again(false), &["1 frames are listed again and are left out"]);
    refuses(&again(true), &["twice, with two poses"]);
    // Two photos of the model, one file.
    let dir = copied("colmap_only1");
    let poses = dir.path().join("sparse/1/images.txt");
    let text = std::fs::read_to_string(&poses).unwrap();
    std::fs::write(&poses, text.replace("0001.jpg", "a.jpg").replace("0002.jpg", "A.jpg")).unwrap();
    let images = dir.path().join("images");
    std::fs::rename(images.join("0001.jpg"), images.join("a.jpg")).unwrap();
    std::fs::remove_file(images.join("0002.jpg")).unwrap();
    if !images.join("A.jpg").exists() {
        says(&dir, &["1 of the 8 images of the COLMAP model are not there and are left out: \"A.jpg\""]);
    }
}

#[test]
fn photos_are_found_by_the_longest_end_of_their_path_and_in_other_folders() {
    for front in ["./data/fox/", "../other/", "data\\\\fox\\\\"] {
        let front = front.replace("\\\\", "\\");
        let dir = changed("axes_opencv", POSES, |value| {
            frames(value, |_, frame| {
                frame["file_path"] =
                    format!("{front}{}", frame["file_path"].as_str().unwrap().trim_start_matches("./")).into();
            });
        });
        says(&dir, &["8 photos are not where \"file_path\" says, and were found elsewhere"]);
    }
    for (name, words) in
        [("colmap_only1", "8 photos are not where the model says, and were found elsewhere"), ("masks_llff", "8 of 8")]
    {
        let dir = copied(name);
        std::fs::rename(dir.path().join("images"), dir.path().join("input")).unwrap();
        says(&dir, &[words]);
    }
}

#[test]
fn masks_are_found_under_other_names() {
    let moved = |to: &dyn Fn(&Path, &str) -> PathBuf| {
        let dir = copied("masks_llff");
        for mask in entries(&dir.path().join("masks")) {
            let to = to(dir.path(), mask.file_stem().unwrap().to_str().unwrap());
            std::fs::create_dir_all(to.parent().unwrap()).unwrap();
            std::fs::rename(mask, to).unwrap();
        }
        let _ = std::fs::remove_dir(dir.path().join("masks"));
        dir
    };
    let in_folder = moved(&|dir, stem| dir.join("Object_Masks").join(format!("{stem}.PNG")));
    says(&in_folder, &["8 of 8 photos have masks in Object_Masks/", "data.masks=Object_Masks"]);
    let read = check_folder(in_folder.path(), &["data.masks=Object_Masks"]);
    assert_says(&read, &["8 of 8 photos have masks, by data.masks"]);
    let below = moved(&|dir, stem| dir.join("images/masks").join(format!("{stem}.png")));
    says(&below, &["8 of 8 photos have masks in masks/", "data.masks=masks"]);
    says(
        &moved(&|dir, stem| dir.join("masks").join(format!("x{stem}x.png"))),
        &["masks/ has 8 images that are called like no photo"],
    );
}

#[test]
fn masks_beside_their_photos_are_named() {
    let dir = copied("letter_case");
    let photo = entries(&dir.path().join("images")).remove(0);
    image::GrayImage::new(32, 32).save(photo.with_file_name("0001_mask.png")).unwrap();
    says(&dir, &["1 of 8 photos have masks in their own folder", "data.masks=beside"]);
}

#[test]
fn cameras_of_which_some_cannot_be_right_are_named() {
    let flip = |frame: &mut Value| {
        for row in frame["transform_matrix"].as_array_mut().unwrap().iter_mut().take(3) {
            (1..3).for_each(|column| row[column] = (-row[column].as_f64().unwrap()).into());
        }
    };
    let mixed = changed("axes_opencv", POSES, |value| {
        frames(value, |number, frame| {
            if number % 4 != 0 {
                flip(frame)
            }
        });
    });
    says(&mixed, &["2 of 8 cameras look away from the point at which the others look"]);
    let corner = changed("one_place", POSES, |value| {
        frames(value, |_, _| ());
        (value["cx"], value["cy"]) = (0.0.into(), 0.0.into());
    });
    says(&corner, &["principal point at 0.0, 0.0", "all 8 cameras stand in one place"]);
    let narrow = changed("axes_opencv", POSES, |value| value["fl_x"] = 4444.0.into());
    says(&narrow, &["degrees across"]);
    let twice = changed("axes_opencv", POSES, |value| {
        let pose = value["frames"][0]["transform_matrix"].clone();
        value["frames"][3]["transform_matrix"] = pose;
    });
    says(&twice, &["have the same pose"]);
}

#[test]
fn blender_scenes_without_test_views_hold_some_out_and_name_what_is_unused() {
    let name = "blender_no_test_pictures";
    let dir = changed(name, "transforms_test.json", |value| value["frames"] = Value::Array(Vec::new()));
    says(&dir, &["is held out instead"]);
    std::fs::remove_file(dir.path().join("transforms_test.json")).unwrap();
    says(&dir, &["is held out instead"]);
    let photo = entries(&dir.path().join("train")).remove(0);
    std::fs::copy(&photo, photo.with_file_name("other.png")).unwrap();
    says(&dir, &["are in no transforms_*.json that is read and are not used: other.png"]);
}

#[test]
fn models_in_other_folders_and_photos_in_others_are_named() {
    let dir = copied("colmap_split");
    std::fs::create_dir_all(dir.path().join("distorted/sparse")).unwrap();
    std::fs::rename(dir.path().join("sparse/1"), dir.path().join("distorted/sparse/0")).unwrap();
    says(&dir, &["2 COLMAP models: sparse/0 (2 photos), distorted/sparse/0 (8 photos); sparse/0 is read"]);
    let dir = copied("colmap_only1");
    let other = dir.path().join("images/cam2");
    std::fs::create_dir(&other).unwrap();
    std::fs::copy(dir.path().join("images/0001.jpg"), other.join("9.jpg")).unwrap();
    says(&dir, &["1 of the 1 photos in images/cam2 are not in the COLMAP model and are not used: 9.jpg"]);
}

#[test]
fn training_views_are_held_out_where_no_test_view_was_rendered() {
    let said = check("blender_no_test_pictures", &[]);
    assert_says(&said, &["no photo of transforms_test.json is there", "is held out instead", "split  every-8\n"]);
    // Weights are not to be chosen on the views that are reported.
    let name = "blender_no_test_pictures";
    let dir = changed(name, "transforms_test.json", |value| value["frames"] = Value::Array(Vec::new()));
    std::fs::copy(dir.path().join("transforms_test.json"), dir.path().join("transforms_val.json")).unwrap();
    let folder = dir.path().to_str().unwrap();
    let on_val = ["data", "check", folder, "--set", "data.downscale=1", "--set", "data.eval_split=val"];
    refuse(&on_val, 3, &["neither transforms_val.json nor transforms_test.json has photos", "data.validation"]);
    let poses = dir.path().join("transforms_train.json");
    std::fs::rename(&poses, poses.with_file_name("transforms.json")).unwrap();
    let validation = check_folder(dir.path(), &["data.eval_split=val", "data.validation=3"]);
    assert_says(&validation, &["5 (0002, 0004, 0005, 0007, 0008)", "2 (0003, 0006)"]);
}

/// Validation views have photos, or training views stand in for them. The split is called by what it is.
#[test]
fn training_views_in_place_of_validation_views_are_named_so() {
    let dir = copied("blender_no_test_pictures");
    let file = |split: &str| dir.path().join(format!("transforms_{split}.json"));
    std::fs::rename(file("test"), file("val")).unwrap();
    std::fs::copy(file("train"), file("test")).unwrap();
    assert_says(&check_folder(dir.path(), &[]), &["split  test\n"]);
    let said = check_folder(dir.path(), &["data.eval_split=val"]);
    assert_says(&said, &["no photo of transforms_val.json is there", "split  every-8-val\n"]);
}

#[test]
fn llff_folders_of_other_sizes_and_counts_are_read() {
    assert_says(&check("llff_scaled", &[]), &["the focal length is scaled with it"]);
    is_refused("llff_sides_swapped", &["height and width stand in each other's place"]);
    assert_says(&check("llff_unregistered", &[]), &["6 of 8 photos have poses, by view_imgs.txt"]);
}

#[test]
fn frames_without_a_pose_are_left_out() {
    assert_says(&check("pose_null", &[]), &["1 frames have no pose", "are left out"]);
}

/// An object on black: the preset learns it. Without its limit of raw colours the run ends as collapsed.
#[test]
fn an_object_on_black_is_learned_or_said_to_be_lost() {
    let dir = tempfile::tempdir().unwrap();
    let (folder, out) = (capture("black_background"), dir.path().join("run"));
    let train = |settings: &[&str]| {
        let mut arguments = vec!["train", "--data", &folder, "--preset", "fast", "--quiet", "--overwrite"];
        arguments.extend(["--out", out.to_str().unwrap(), "--set", "data.downscale=1", "--set", "eval.train_views=0"]);
        settings.iter().for_each(|setting| arguments.extend(["--set", setting]));
        program::augnerf(&arguments)
    };
    let said = demand(&mut train(&["train.steps=160", "field.rgb_limit=0", "train.collapse_steps=60"]), 6);
    assert_says(&said, &["training collapsed", "all rays had one colour, and the photos had not"]);
    let said = demand(&mut train(&["train.steps=160", "field.rgb_limit=0", "train.collapse_steps=0"]), 6);
    assert_says(&said, &["nothing was learned", "no better than one colour", "field.rgb_limit = 8"]);
    // Measured again, it is printed, and the code is the same.
    let said = demand(&mut program::augnerf(&["eval", out.to_str().unwrap(), "--json", "-q"]), 6);
    assert_says(&said, &["nothing was learned", "\"mean\":{"]);
    // A sweep that asks for it counts the training with what it has.
    let sweep = dir.path().join("lost.toml");
    let point = "\"data.downscale\" = 1\n\"eval.train_views\" = 0\n\"train.steps\" = 160\n\"field.rgb_limit\" = 0\n";
    let text = format!(
        "title = \"Lost\"\npreset = \"fast\"\nscenes = [\"black_background\"]\nseeds = [0]\nmetrics = [\"psnr\"]\n\
         [set]\n{point}\"train.collapse_steps\" = 0\n[[row]]\nname = \"NeRF\"\n"
    );
    std::fs::write(&sweep, text).unwrap();
    let root = Path::new(&folder).parent().unwrap();
    let arguments = ["sweep", "run", sweep.to_str().unwrap(), "--out", "lost", "--data-root", root.to_str().unwrap()];
    let said = demand(program::augnerf(&arguments).current_dir(dir.path()), 0);
    assert_says(&said, &["nothing was learned", "it counts, because train.collapse_steps is 0"]);
    let table = std::fs::read_to_string(dir.path().join("lost/results/table.md")).unwrap();
    assert_says(&table, &["no better than one colour"]);
    demand(&mut train(&["train.steps=250"]), 0);
    let mean = &json(&out.join("metrics.json"))["mean"];
    let [psnr, floor] = ["psnr", "floor_psnr"].map(|key| mean[key].as_f64().unwrap());
    assert!(psnr > floor + 4.0, "{psnr} dB, one colour has {floor}");
}
