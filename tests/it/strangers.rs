//! Captures of strangers: small copies of each kind of fault that was found in published scenes (tests/fixtures/captures3).

use std::fs;

use serde_json::json;

use crate::captures::{Folder, KEY, each, turn};
use crate::common::assert_says;
use crate::common::files::{copy, fixture};
use crate::common::program::{Place, set};

/// A copy of a capture after changes, and the command line that checks it. A case is the capture's name with settings and, each
/// after `; `, the changes: `mv FROM TO`, `cp FROM TO`, `rm FILES`, `put FILE TEXT` and `sub FILE OLD NEW`.
pub fn changed(case: &str) -> (Place, String) {
    let mut parts = case.split("; ");
    let first = parts.next().unwrap();
    let (name, settings) = first.split_once(' ').unwrap_or((first, ""));
    let place = Place::new();
    let folder = place.at(name);
    copy(&fixture("captures3").join(name), &folder);
    for change in parts {
        let words: Vec<&str> = change.split(' ').collect();
        let file = folder.join(words[1]);
        let to = || {
            let to = folder.join(words[2]);
            fs::create_dir_all(to.parent().unwrap()).unwrap();
            to
        };
        match words[0] {
            "mv" => fs::rename(file, to()).unwrap(),
            "cp" => assert!(fs::copy(file, to()).is_ok()),
            "rm" => words[1..].iter().for_each(|file| fs::remove_file(folder.join(file)).unwrap()),
            "put" => fs::write(file, words[2..].join(" ")).unwrap(),
            _ => {
                let text = fs::read_to_string(&file).unwrap();
                assert!(text.contains(words[2]), "{change}");
                fs::write(file, text.replace(words[2], words[3])).unwrap();
            }
        }
    }
    (place, format!("data check {name} --set data.downscale=1{}", set(settings)))
}

/// What `data check` says of a case has these words.
#[track_caller]
pub fn says(case: &str, words: &[&str]) -> String {
    let (place, line) = changed(case);
    let said = place.run(&line, 0);
    assert_says(&said, words);
    said
}

/// A case is refused with these words.
#[track_caller]
pub fn refuses(case: &str, words: &[&str]) {
    let (place, line) = changed(case);
    place.says(&line, 3, words);
}

#[test]
fn the_colmap_model_with_most_photos_is_read_and_the_others_are_named() {
    let models = "2 COLMAP models: sparse/0 (2 photos), sparse/1 (8 photos); sparse/1 is read";
    says("colmap_split", &[models, "sparse/1: "]);
    let words = ["6 of the 8 photos in images are not in the COLMAP model", "only 1 view trains"];
    says("colmap_split data.colmap_model=sparse/0", &words);
    says("colmap_only1", &["sparse/1: "]);
    let words = ["data.colmap_model = \"sparse/7\" is no COLMAP model", "sparse/1 (8 photos)"];
    refuses("colmap_split data.colmap_model=sparse/7", &words);
    let models = "2 COLMAP models: sparse/0 (2 photos), distorted/sparse/0 (8 photos); sparse/0 is read";
    says("colmap_split; mv sparse/1 distorted/sparse/0", &[models]);
    let words = "1 of the 1 photos in images/cam2 are not in the COLMAP model and are not used: 9.jpg";
    says("colmap_only1; cp images/0001.jpg images/cam2/9.jpg", &[words]);
}

#[test]
fn cameras_that_cannot_be_right_are_named() {
    says("axes_opencv", &["look away from their common point", "data.axes=opencv"]);
    let said = says("axes_opencv data.axes=opencv", &[]);
    assert!(!said.contains("look away"), "{said}");
    says("one_place", &["all 8 cameras stand in one place"]);
    says("one_place; sub transforms.json 16.0, 0.0,", &["principal point at 0.0, 0.0", "all 8 cameras stand in"]);
    says("axes_opencv; sub transforms.json 44.4 4444.4", &["degrees across"]);
    refuses("centre_outside", &["principal point", "more than half a picture outside", "\"w\" and \"h\""]);
    refuses("orthographic", &["\"orthographic\" says that the camera is orthographic"]);
    says("pose_null", &["1 frames have no pose", "are left out"]);
    let noted = |folder: Folder| folder.read(|_| {}).1.concat();
    let mixed = each(Folder::new(9), |number, frame| {
        if number % 4 == 0 {
            turn(frame);
        }
    });
    assert_says(&noted(mixed), &["3 of 9 cameras look away from the point at which the others look"]);
    let mut twice = Folder::new(9);
    twice.frames()[3][KEY] = twice.frames()[0][KEY].clone();
    assert_says(&noted(twice), &["have the same pose"]);
    let mut again = Folder::new(9);
    let frame = json!({"file_path": "./images/../images/0.png", KEY: again.frames()[0][KEY]});
    again.frames().push(frame);
    assert_says(&noted(again), &["1 frames are listed again and are left out"]);
}

#[test]
fn masks_that_lie_there_are_named_and_read() {
    for (name, changes, value) in [
        ("masks_llff", "", "masks"),
        ("masks_colmap", "", "masks"),
        ("masks_dynamic", "", "beside"),
        ("masks_llff", "; mv masks Object_Masks", "Object_Masks"),
        ("masks_llff", "; mv masks images/masks", "masks"),
    ] {
        let words = ["8 of 8 photos have masks in", "which are not used", &format!("data.masks={value} uses")];
        says(&format!("{name}{changes}"), &words);
        says(&format!("{name} data.masks={value}{changes}"), &["8 of 8 photos have masks, by data.masks"]);
        let said = says(&format!("{name} data.masks=none{changes}"), &[]);
        assert!(!said.contains("photos have masks"), "{name}: {said}");
    }
    says("masks_llff; mv masks other; cp other/0001.png masks/x.png", &["masks/ has 1 images that are called like no"]);
    refuses("masks_llff data.masks=nowhere", &["data.masks = \"nowhere\"", "has no mask of its 8 photos"]);
}

#[test]
fn photos_that_lie_elsewhere_are_found() {
    let found = "photos are not where \"file_path\" says, and were found elsewhere";
    says("elsewhere_root", &["8", found]);
    says("elsewhere_below", &["6", found]);
    for front in ["./data/fox/", "../other/", "data\\\\fox\\\\"] {
        says(&format!("axes_opencv; sub transforms.json images/ {front}images/"), &["8", found]);
    }
    // Of another machine's paths the ends count.
    for front in ["/home/someone/captures/me/images/", "C:\\\\Users\\\\me\\\\images\\\\"] {
        let said = says(&format!("axes_opencv; sub transforms.json images/ {front}"), &[]);
        assert!(!said.contains("elsewhere"), "{said}");
    }
    says("colmap_only1; mv images input", &["8 photos are not where the model says, and were found elsewhere"]);
    says("masks_llff; mv images input", &["8 of 8"]);
}

/// Names that mean one file: `Küche` in one piece in the file of poses, with the accent apart on the disk, and the like.
#[test]
#[cfg(target_os = "linux")]
fn names_in_another_letter_case_or_unicode_form_are_found() {
    says("letter_case", &["8 photos are not where \"file_path\" says, and were found elsewhere"]);
    let names = "sub sparse/1/images.txt 0001.jpg K\u{fc}che.jpg; sub sparse/1/images.txt 0002.jpg zwei.jpg";
    let files = "mv images/0001.jpg images/Ku\u{308}che.jpg; mv images/0002.jpg images/Zwei.JPG";
    let model = says(&format!("colmap_only1; {names}; {files}"), &["the names of 2"]);
    let kitchen = "mv images/0001.jpg images/Ku\u{308}che.jpg; sub transforms.json 0001.jpg K\u{fc}che.jpg";
    let frames = says(&format!("pose_null; {kitchen}"), &[]);
    assert!(!model.contains("are left out") && !frames.contains("are not there and are left out"), "{model} {frames}");
    // Two photos of the model, one file.
    let names = "sub sparse/1/images.txt 0001.jpg a.jpg; sub sparse/1/images.txt 0002.jpg A.jpg";
    let words = "1 of the 8 images of the COLMAP model are not there and are left out: \"A.jpg\"";
    says(&format!("colmap_only1; {names}; mv images/0001.jpg images/a.jpg; rm images/0002.jpg"), &[words]);
}

#[test]
fn a_scene_s_own_file_stands_for_its_folder_and_a_near_miss_is_named() {
    refuses("near_miss_name", &["transform_train.json is probably a scene's transforms_train.json; rename it"]);
    let (place, line) = changed("pose_null");
    place.says(&line.replace("pose_null", "pose_null/transforms.json"), 0, &["scene  pose_null"]);
    place.says("data check pose_null/images/0001.jpg", 3, &["is a file, but a scene is a folder"]);
}

/// Training views stand in for held-out ones that have no photos. The split is called by what it is, and weights are not chosen
/// on the views that are reported.
#[test]
fn training_views_are_held_out_where_no_test_view_was_rendered() {
    let (name, instead) = ("blender_no_test_pictures", "is held out instead");
    let no_photo = "no photo of transforms_test.json is there";
    says(name, &[no_photo, instead, "split  every-8\n"]);
    let empty = r#"put transforms_test.json {"camera_angle_x": 0.7, "frames": []}"#;
    says(&format!("{name}; {empty}"), &[instead]);
    let words = "are in no transforms_*.json that is read and are not used: other.png";
    says(&format!("{name}; rm transforms_test.json; cp train/0001.png train/other.png"), &[instead, words]);
    let no_val = format!("{name} data.eval_split=val; {empty}; cp transforms_test.json transforms_val.json");
    let words = ["neither transforms_val.json nor transforms_test.json has photos", "data.validation"];
    refuses(&no_val, &words);
    let capture = no_val.replace("=val;", "=val data.validation=3;") + "; mv transforms_train.json transforms.json";
    says(&capture, &["5 (0002, 0004, 0005, 0007, 0008)", "2 (0003, 0006)", "ignored keys  aabb_scale\n"]);
    let trained = "mv transforms_test.json transforms_val.json; cp transforms_train.json transforms_test.json";
    says(&format!("{name}; {trained}"), &["split  test\n"]);
    let words = ["no photo of transforms_val.json is there", "split  every-8-val\n"];
    says(&format!("{name} data.eval_split=val; {trained}"), &words);
}

#[test]
fn llff_folders_of_other_sizes_and_counts_are_read() {
    says("llff_scaled", &["the focal length is scaled with it"]);
    refuses("llff_sides_swapped", &["height and width stand in each other's place"]);
    says("llff_unregistered", &["6 of 8 photos have poses, by view_imgs.txt"]);
}

/// An object on black: the preset learns it. Without its limit of raw colours the run ends as collapsed.
#[test]
fn an_object_on_black_is_learned_or_said_to_be_lost() {
    let (place, _) = changed("black_background");
    let train = |settings: &str, code: i32| {
        let small = set(&format!("data.downscale=1 eval.train_views=0 {settings}"));
        place.run(&format!("train --data black_background --preset fast --quiet --overwrite --out run{small}"), code)
    };
    let said = train("train.steps=160 field.rgb_limit=0 train.collapse_steps=60", 6);
    assert_says(&said, &["training collapsed", "all rays had one colour, and the photos had not"]);
    let said = train("train.steps=160 field.rgb_limit=0 train.collapse_steps=0", 6);
    assert_says(&said, &["nothing was learned", "no better than one colour", "field.rgb_limit = 8"]);
    // Measured again, it is printed, and the code is the same.
    place.says("eval run --json -q", 6, &["nothing was learned", "\"mean\":{"]);
    // A sweep that asks for it counts the training with what it has.
    let head = "title = 'Lost'\npreset = 'fast'\nscenes = ['black_background']\nseeds = [0]\nmetrics = ['psnr']";
    let point = "'data.downscale' = 1\n'eval.train_views' = 0\n'train.steps' = 160\n'field.rgb_limit' = 0";
    place.write("lost.toml", format!("{head}\n[set]\n{point}\n'train.collapse_steps' = 0\n[[row]]\nname = 'NeRF'\n"));
    let words = ["nothing was learned", "it counts, because train.collapse_steps is 0"];
    place.says("sweep run lost.toml --out lost --data-root .", 0, &words);
    assert_says(&place.text("lost/results/table.md"), &["no better than one colour"]);
    train("train.steps=250", 0);
    let mean = &place.json("run/metrics.json")["mean"];
    let [psnr, floor] = ["psnr", "floor_psnr"].map(|key| mean[key].as_f64().unwrap());
    assert!(psnr > floor + 4.0, "{psnr} dB, one colour has {floor}");
}
