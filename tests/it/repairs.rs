//! Captures that other programs, other machines and other people left: what is repaired is named, and what is not read is answered
//! with what to do.

use std::f64::consts::TAU;
use std::fs;

use augnerf::data::{Scene, View};
use augnerf::settings::{DataConfig, DataKind, EvalSplit, Split, build, parse_assignment};
use image::{Rgb, RgbImage, Rgba, RgbaImage, imageops};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::captures::{Folder, KEY, all, each, listed, names, read};
use crate::common::assert_says;
use crate::common::files::{self, copy};
use crate::common::program::Place;
use crate::strangers::{changed, refuses, says};

/// Gives a key another name, in frames or in the document.
fn renamed(folder: Folder, key: &'static str, other: &'static str) -> Folder {
    let rename = |object: &mut Value| {
        if let Some(value) = object.as_object_mut().unwrap().remove(key) {
            object[other] = value;
        }
    };
    let mut folder = each(folder, |_, frame| rename(frame));
    rename(folder.document_mut());
    folder
}

/// Multiplies the numbers of matrices: those of the first three columns, and the others.
fn scaled(axes: f64, others: f64) -> Folder {
    each(Folder::new(9), |_, frame| {
        for row in frame[KEY].as_array_mut().unwrap() {
            for (column, number) in row.as_array_mut().unwrap().iter_mut().enumerate() {
                *number = (number.as_f64().unwrap() * if column < 3 { axes } else { others }).into();
            }
        }
    })
}

/// The folder of photos has another name, and its photos are reduced.
fn moved(to: &str, reduced: u32) -> Folder {
    let folder = Folder::new(9);
    let (from, to) = (folder.path().join("images"), folder.path().join(to));
    fs::create_dir_all(&to).unwrap();
    for photo in files::entries(&from) {
        let image = image::open(&photo).unwrap();
        let small = image.resize_exact(16 / reduced, 12 / reduced, imageops::FilterType::Triangle);
        small.save(to.join(photo.file_name().unwrap())).unwrap();
    }
    fs::remove_dir_all(from).unwrap();
    folder
}

/// Frames from a number on stand under another key.
fn parted(key: &str, from: usize) -> Folder {
    let mut folder = Folder::new(9);
    let frames = folder.frames().split_off(from);
    folder.with(key, frames.into())
}

type Change = fn(&mut DataConfig);

fn as_it_is(_: &mut DataConfig) {}

/// What is read with a note: its training and held-out views, and what is said.
#[test]
fn what_is_repaired_is_named() {
    let (same, own) = ("1 2 3 4 5 6 7 | 0 8", "0 1 2 3 4 5 | 6 7 8");
    let every: Change = |data| data.split = Some(Split::Every);
    let val: Change = |data| data.eval_split = EvalSplit::Val;
    let fourth: Change = |data| data.downscale = Some(4);
    let second: Change = |data| data.downscale = Some(2);
    let plain = || Folder::new(9);
    let twice = each(plain(), |number, frame| frame["file_path"] = format!("images/{number}").into());
    (0..9).for_each(|i| RgbImage::new(16, 12).save(twice.path().join(format!("images/{i}.jpg"))).unwrap());
    let pruned = plain();
    (1..7).for_each(|i| pruned.remove(i));
    let lists = |val: &str| listed(&format!("train 0 1 2 3 4 5, val {val}, test 6 7 8"));
    let names_alone = plain().with("test_frames", json!(["images/6.png", "images/7.png", "images/8.png"]));
    let scale = "9 matrices are scaled as a whole (their last number is 0.004, not 1)";
    let angle = "\"fl_x\" is 20.0 and is used, but \"camera_angle_x\" would make it 39.5";
    let cases: [(Folder, Change, &str, &str); 21] = [
        (lists("6 7 8"), as_it_is, own, "3 of 3 test views are validation views, too"),
        (lists("6 7 8"), val, own, "3 of 3 test views"),
        (listed(&["train", "val", "test"].map(|role| format!("{role} 0 1 2 3 4 5 6 7 8")).join(", ")), every, same, ""),
        (lists("2 3 4 5 6"), as_it_is, own, "1 of 3 test views are validation views, too"),
        (parted("test_frames", 6), as_it_is, own, "the 3 views of \"test_frames\" are the test split"),
        (names_alone, as_it_is, own, ""),
        (parted("val_frames", 6), val, own, "the 3 views of \"val_frames\" are the val split"),
        (parted("test_frames", 6), every, "1 2 3 4 5 | 0", "are left out with data.split=every"),
        (moved("input", 1), as_it_is, same, "9 photos are not where"),
        (moved("input", 1), as_it_is, same, "images/0.png is input/0.png"),
        (moved("photos/all", 1), as_it_is, same, "images/0.png is photos/all/0.png"),
        (moved("images_4", 4), fourth, same, "as data.downscale=4 reads them"),
        (moved("images_4", 4), as_it_is, same, "the originals are not there"),
        (moved("images_2", 2), fourth, same, "only images_2 is there"),
        (moved("images_4", 4), second, same, "the originals are not there"),
        (scaled(0.004, 0.004), as_it_is, same, scale),
        (scaled(-2.0, -2.0), as_it_is, same, "their last number is -2"),
        (scaled(1.02, 1.0), as_it_is, same, "the axes of 9 matrices have the length 1.02, not 1, and are normalized"),
        (pruned, as_it_is, "7 | 0 8", "images/6.png. These are most of them: check"),
        (twice, as_it_is, same, "9 photos are there again with another ending and are not used, such as 0.jpg"),
        (plain().with("camera_angle_x", json!(0.4)), as_it_is, same, angle),
    ];
    let plain = plain().load(|_| {});
    for (folder, change, views, words) in cases {
        let (scene, notes) = folder.read(change);
        let (scene, notes) = (scene.unwrap(), notes.join("\n"));
        assert_eq!([&scene.train, &scene.test].map(|views| names(views).join(" ")).join(" | "), views, "{notes}");
        assert_says(&notes, &[words]);
        assert!(!notes.contains("have no pose"), "{notes}");
        // Each camera is where it is without the fault, and sees as much.
        for View { name, camera, .. } in all(&scene).filter(|_| views == same) {
            let right = all(&plain).find(|view| view.name == *name).unwrap().camera;
            let pairs = camera.pose.iter().flatten().zip(right.pose.iter().flatten());
            assert!(pairs.into_iter().all(|(a, b)| (a - b).abs() < 1e-9), "{notes}");
            let width = |camera: &augnerf::data::Camera| camera.focal[0] / camera.width as f64;
            assert!((width(camera) - width(&right)).abs() < 1e-9, "{notes}");
        }
    }
    // Nothing is said of what is sound.
    let (_, notes) =
        Folder::new(9).with("camera_angle_x", json!(2.0 * 0.4f64.atan())).with("sk_x", json!(0.0)).read(|_| {});
    assert!(notes.is_empty(), "{notes:?}");
}

/// Photos that are reduced already are reduced by the rest of the factor. Of several folders the smallest that suffices is read.
#[test]
fn a_factor_counts_from_the_originals() {
    let both = moved("images_4", 4);
    copy(&moved("images_2", 2).path().join("images_2"), &both.path().join("images_2"));
    let of_four = || moved("images_4", 4);
    for (folder, factor, width) in [(moved("images_2", 2), 4, 4), (of_four(), 4, 4), (of_four(), 1, 4), (both, 2, 8)] {
        let camera = folder.load(|data| data.downscale = Some(factor)).train[0].camera;
        assert_eq!((camera.width, camera.focal[0]), (width, 1.25 * width as f64), "{factor}");
    }
}

/// What is not read is answered with the reason and what to do.
#[test]
fn what_is_not_read_is_answered_with_what_to_do() {
    let plain = || Folder::new(9);
    let without_lens = || renamed(plain(), "fl_x", "unread");
    let transposed = each(plain(), |_, frame| {
        let old = frame[KEY].clone();
        (0..4).for_each(|row| (0..4).for_each(|column| frame[KEY][row][column] = old[column][row].clone()));
    });
    let no_last_row = each(plain(), |_, frame| frame[KEY][3] = json!([0.5, 0.0, 0.0, 1.0]));
    let uneven = each(plain(), |_, frame| frame[KEY][1][1] = 2.5.into());
    let none_there = each(plain(), |number, frame| frame["file_path"] = format!("images/x{number}.png").into());
    let two_folders = moved("photos", 1);
    copy(&two_folders.path().join("photos"), &two_folders.path().join("thumbs"));
    let cases: [(Folder, &[&str]); 11] = [
        (each(without_lens(), |_, frame| frame["K"] = json!([])), &["\"K\" is there: write its numbers as \"fl_x\""]),
        (without_lens().with("FovX", json!(60.0)), &["\"FovX\" is there", "\"camera_angle_x\", in radians"]),
        (plain().with("fl_x", json!("20.0")), &["\"fl_x\" is \"20.0\"", "take away the quotation marks"]),
        (renamed(plain(), KEY, "cam_to_world"), &["\"transform_matrix\" is missing; \"cam_to_world\" is there"]),
        (renamed(plain(), "file_path", "image_path"), &["\"image_path\" is there: rename it to \"file_path\""]),
        (renamed(plain(), "frames", "cameras"), &["\"frames\" is missing; \"cameras\" is there"]),
        (transposed, &["the last row", "must be [0, 0, 0, 1]: the matrix is probably transposed"]),
        (no_last_row, &["the last row of \"transform_matrix\" is [0.5,0.0,0.0,1.0], but it must be [0, 0, 0, 1]"]),
        (uneven, &["columns of length"]),
        (none_there, &["none of the 9 photos that \"frames\" names is there", "; missing are images/x0.png"]),
        (two_folders, &["none of the 9 photos", "; the nearest name there is", "/0.png; missing are images/0.png"]),
    ];
    for (folder, words) in cases {
        let said = folder.refuses(words);
        assert!(words.concat().contains("transposed") || !said.contains("transposed"), "{said}");
    }
}

/// Files that are called like photos or poses and are others.
#[test]
fn files_that_are_not_what_their_name_says_are_named() {
    let pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:07\nsize 8123456\n";
    for (name, content, words) in [
        ("images/0005.jpg", pointer, "it is a Git LFS pointer"),
        ("transforms.json", pointer, "run `git lfs pull`"),
        ("images/0005.jpg", "\0\0\0\x18ftypheic\0\0\0\0", "5.jpg is HEIC, whatever its name"),
        ("images/0005.jpg", "II*\0\x08\0\0\0", "5.jpg is TIFF or a raw photo, whatever its name"),
        ("images/0005.jpg", "<!DOCTYPE html>", "5.jpg is a web page or XML, whatever its name"),
        ("images/0005.jpg", "nothing", "may be truncated or damaged"),
    ] {
        refuses(&format!("axes_opencv; put {name} {content}"), &[words]);
    }
    for (name, file) in [("colmap_only1", "sparse/1/images.txt"), ("masks_llff", "poses_bounds.npy")] {
        refuses(&format!("{name}; put {file} {pointer}"), &[file, "Git LFS pointer"]);
    }
}

/// Names as Windows and other machines write them, with backslashes and drives.
#[test]
fn names_of_other_machines_are_read() {
    let colmap = |changes: &str| {
        let (place, _) = changed(&format!("colmap_only1{changes}"));
        let (scene, notes) = read(&place.at("colmap_only1"), |_| {});
        (scene.unwrap().hash(), notes.concat())
    };
    let (plain, _) = colmap("");
    for front in ["C:\\Users\\me\\capture\\images\\", "sub\\", "/home/me/capture/images/", "./"] {
        let of_photo = |i| format!("; sub sparse/1/images.txt 000{i}.jpg {front}000{i}.jpg");
        let names: String = (1..9).map(of_photo).collect();
        let below = if front == "sub\\" { "; mv images sub; mv sub images/sub" } else { "" };
        let (hash, notes) = colmap(&(names + below));
        assert_eq!(hash, plain, "{front}: {notes}");
        match front {
            "./" => assert!(!notes.contains("another machine"), "{notes}"),
            _ => assert_says(&notes, &["the names of 8 images are paths of another machine", front]),
        }
    }
}

/// The same for the formats without a `transforms.json`.
#[test]
fn photos_of_other_formats_are_found_and_chosen_by_a_stated_rule() {
    let again = "1 photos are there again with another ending and are not used, such as 0001.webp";
    says("masks_llff data.masks=none; cp images/0001.jpg images/0001.webp", &[again]);
    says("colmap_only1; cp images/0001.jpg images/0001.webp", &[again]);
    let input = "there is no folder images, and input, the only folder with an image for each pose, is read";
    says("masks_llff data.masks=none; mv images input", &[input]);
    let reduced = ["only images_4 is there", "the originals are not there"];
    says("masks_llff data.masks=none; mv images images_4", &reduced);
    says("colmap_only1; mv images images_4", &[reduced[1], "32 x 32 pixels"]);
    says("colmap_only1 data.downscale=4; mv images images_4", &["32 x 32 pixels"]);
    let pruned: String = (3..9).map(|i| format!(" images/000{i}.jpg")).collect();
    says(&format!("colmap_only1; rm{pruned}"), &["6 of the 8 images", "most of them: check that the model"]);
}

/// A Blender folder around an object of another size: cameras at `distance`, the object half as large as what they see.
fn export(distance: f64, photo: impl Fn(u32, u32) -> [u8; 3]) -> TempDir {
    let dir = TempDir::new().unwrap();
    for (split, count) in [("train", 6), ("test", 2)] {
        fs::create_dir(dir.path().join(split)).unwrap();
        let frame = |i: usize| {
            let name = format!("{split}/{i}");
            RgbImage::from_fn(24, 24, |x, y| Rgb(photo(x, y))).save(dir.path().join(format!("{name}.png"))).unwrap();
            let (sin, cos) = (TAU * (i as f64 + 0.1) / count as f64).sin_cos();
            let pose =
                json!([[cos, 0, sin, distance * sin], [0, 1, 0, 0], [-sin, 0, cos, distance * cos], [0, 0, 0, 1]]);
            json!({ "file_path": name, KEY: pose })
        };
        let frames: Vec<Value> = (0..count).map(frame).collect();
        let document = json!({"camera_angle_x": 0.69, "frames": frames});
        fs::write(dir.path().join(format!("transforms_{split}.json")), document.to_string()).unwrap();
    }
    dir
}

#[test]
fn blender_folders_of_another_size_have_bounds_and_a_box_that_fit() {
    let object = |x: u32, y: u32| if (8..16).contains(&x) && (8..16).contains(&y) { [90, 20, 20] } else { [255; 3] };
    let photo = |x: u32, y: u32| [(x * 10) as u8, (y * 10) as u8, 90];
    let load = |dir: &TempDir, change: Change| -> (Scene, String) {
        let (scene, notes) = read(dir.path(), |data| {
            data.downscale = Some(1);
            change(data);
        });
        (scene.unwrap(), notes.concat())
    };
    let radius = |distance: f64| distance * 0.345f64.sin();
    for distance in [6.0, 1.0, 40.0] {
        let (scene, notes) = load(&export(distance, object), as_it_is);
        let (near, far) = (distance - radius(distance), distance + radius(distance));
        assert!((scene.near - near).abs() < 1e-6 && (scene.far - far).abs() < 1e-6, "{:?}", scene.bounds());
        let expected = format!("rays run from {near:.4} to {far:.4} instead");
        assert_says(&notes, &[&format!("is {distance:.3} away"), "outside of 2 to 6", &expected]);
        assert!(!notes.contains("data.kind"), "{notes}");
        assert_eq!((scene.kind, scene.background), ("blender", Some([1.0; 3])));
        let [low, high] = scene.space.domain.unwrap();
        assert!((high[0] - radius(distance)).abs() < 1e-6 && (low[0] + high[0]).abs() < 1e-6);
    }
    // Photos have a background, and may be read as a capture.
    let (scene, notes) = load(&export(6.0, photo), as_it_is);
    assert!(scene.near < 2.0 + 1e-9 && scene.far > 12.0, "{:?}", scene.bounds());
    assert_says(&notes, &["--set data.kind=transforms reads the folder as a capture of photos"]);
    // What fits stays as it was published, and so does what is set.
    let (scene, notes) = load(&export(4.0, object), as_it_is);
    assert!(scene.bounds() == (2.0, 6.0) && scene.space.domain.is_none() && notes.is_empty(), "{notes}");
    let set: Change = |data| (data.near, data.far) = (Some(2.0), Some(6.0));
    let (scene, notes) = load(&export(6.0, object), set);
    assert!(scene.bounds() == (2.0, 6.0) && scene.space.domain.is_none());
    assert_says(&notes, &["outside of 2 to 6 (the bounds of this run)", "3.9708 to 8.0292 would hold it"]);
    let (scene, _) = load(&export(6.0, object), |data| data.near = Some(1.0));
    assert!(scene.near == 1.0 && scene.far > 8.0);
    // Held-out cameras change nothing, and the unit stays the format's.
    let apart = export(6.0, object);
    let others = export(40.0, object);
    fs::copy(others.path().join("transforms_test.json"), apart.path().join("transforms_test.json")).unwrap();
    let (plain, _) = load(&export(6.0, object), as_it_is);
    for scene in [load(&apart, as_it_is).0, load(&export(6.0, object), |data| data.rescale = true).0] {
        assert_eq!((scene.bounds(), scene.space.domain), (plain.bounds(), plain.space.domain));
        assert_eq!(scene.train[0].camera, plain.train[0].camera);
    }
    let volume = build(None, None, &[parse_assignment("method=nv").unwrap()]).unwrap();
    assert_eq!(volume.resolve(DataKind::Blender, plain.extent()).unwrap().nv.bounds, plain.space.domain);
    // Transparent renders are renders, whatever their colours.
    let clear = export(6.0, photo);
    for photo in files::entries(&clear.path().join("train")) {
        let alpha = |x: u32, y: u32| if (4..20).contains(&x) && (4..20).contains(&y) { 255 } else { 0 };
        RgbaImage::from_fn(24, 24, |x, y| Rgba([(x * 10) as u8, 80, 90, alpha(x, y)])).save(photo).unwrap();
    }
    let (scene, _) = load(&clear, as_it_is);
    assert!((scene.near - (6.0 - radius(6.0))).abs() < 1e-6);
}

/// What the table has not is said, and so is all that was noted before an error.
#[test]
fn data_check_says_what_its_table_has_not() {
    let check = |folder: Folder, flags: &str, code: i32| {
        folder.write();
        Place::new().run(&format!("data check {}{flags}", folder.path().display()), code)
    };
    let long = "have the length 2.5";
    // A note of the table is not printed before it.
    assert_eq!(check(scaled(2.5, 1.0), " --json", 0).matches(long).count(), 1);
    assert_says(&check(scaled(2.5, 1.0), " --set data.bound_factor=0.5", 0), &["data.bound_factor"]);
    assert_says(&check(scaled(2.5, 1.0).with("k1", json!(1e6)), "", 3), &[long, "distortion"]);
}
