//! Broken scenes: each message names the file and says what was found.

use std::fs;
use std::path::Path;

use crate::captures::Folder;
use crate::common::assert_says;
use crate::common::files::{edit, files, npy, write_poses};
use augnerf::data;
use augnerf::settings::{DataConfig, DataKind, EvalSplit};
use tempfile::TempDir;

/// A row of `poses_bounds.npy`: the camera at (x, 0, 0) that looks along -z.
fn row(x: f64) -> [f64; 17] {
    // Columns down, right, back, origin, (height, width, focal).
    [0.0, 1.0, 0.0, x, 12.0, -1.0, 0.0, 0.0, 0.0, 16.0, 0.0, 0.0, 1.0, 0.0, 14.0, 1.0, 5.0]
}

fn write_image(path: &Path, width: u32, height: u32) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let paint = |x: u32, y: u32| image::Rgb([(x * 13) as u8, (y * 17) as u8, (x * y) as u8]);
    image::RgbImage::from_fn(width, height, paint).save(path).unwrap();
}

/// A sound LLFF scene of four views.
fn llff() -> TempDir {
    let dir = TempDir::new().unwrap();
    write_poses(dir.path(), &[0.0, 0.1, 0.2, 0.3].map(row));
    for i in 0..4 {
        write_image(&dir.path().join(format!("images/{i}.png")), 16, 12);
    }
    dir
}

/// A sound scene of four views with these files of poses.
fn transforms(files: &[&str], keys: &str) -> Folder {
    let folder = Folder::new(4);
    let text = format!("{{{keys}, \"frames\": {}}}", folder.document()["frames"]);
    files.iter().for_each(|file| fs::write(folder.path().join(file), &text).unwrap());
    folder
}

const SPLITS: [&str; 2] = ["transforms_train.json", "transforms_test.json"];
const ANGLE: &str = "\"camera_angle_x\": 0.7";

fn config(dir: &Path) -> DataConfig {
    DataConfig { dir: dir.display().to_string(), downscale: Some(1), ..DataConfig::default() }
}

fn try_load(mut config: DataConfig) -> augnerf::base::Result<data::Scene> {
    config.kind = data::detect(&config)?;
    data::load(&config, 0, &())
}

/// The message of a scene that must be refused as bad data, which has to hold all `words`.
#[track_caller]
fn refuses(config: DataConfig, words: &[&str]) {
    let error = try_load(config).expect_err("must be refused");
    let message = error.to_string();
    assert_says(&message, words);
    assert_eq!(error.exit_code(), 3, "{message}");
    println!("{message}");
}

#[test]
fn settings_that_contradict_the_scene() {
    let dir = llff();
    let spherified = DataConfig { spherify: true, ..config(dir.path()) };
    assert_eq!(try_load(spherified).unwrap_err().exit_code(), 2);
    let enlarged = DataConfig { width: 17, ..config(dir.path()) };
    refuses(enlarged, &["data.width = 17", "images"]);
    let bounds = DataConfig { near: Some(1.5), ..config(dir.path()) };
    assert!(try_load(bounds).unwrap_err().to_string().contains("data.near = 1.5"));
    let nothing = DataConfig { kind: DataKind::Llff, ..DataConfig::default() };
    assert!(try_load(nothing).unwrap_err().to_string().contains("data.dir is empty"));
}

#[test]
fn image_folders() {
    let dir = llff();
    fs::rename(dir.path().join("images"), dir.path().join("images_3")).unwrap();
    // The only one is read as it is, if it is complete.
    fs::remove_file(dir.path().join("images_3/0.png")).unwrap();
    let eighth = DataConfig { downscale: Some(8), ..config(dir.path()) };
    refuses(eighth, &["images_8", "images_3", "data.downscale"]);
    fs::remove_dir_all(dir.path().join("images_3")).unwrap();
    refuses(config(dir.path()), &["no images_* folder at all"]);
    fs::create_dir(dir.path().join("images")).unwrap();
    refuses(config(dir.path()), &["no images", "it has images"]);
}

#[test]
fn images_that_cannot_be_decoded() {
    for name in ["2.png", "2.jpg"] {
        let dir = llff();
        fs::remove_file(dir.path().join("images/2.png")).unwrap();
        let path = dir.path().join("images").join(name);
        write_image(&path, 16, 12);
        let whole = fs::read(&path).unwrap();
        let cut = &whole[..whole.len() - 40];
        for (bytes, word) in [(cut, "truncated"), (&whole[..20], "cannot decode"), (&[], "")] {
            fs::write(&path, bytes).unwrap();
            refuses(config(dir.path()), &[name, word]);
        }
    }
}

#[test]
fn images_that_do_not_fit() {
    let dir = llff();
    write_image(&dir.path().join("images/2.png"), 12, 16);
    refuses(config(dir.path()), &["0.png is 16x12", "2.png is 12x16"]);
    let dir = llff();
    write_image(&dir.path().join("images/4.png"), 16, 12);
    refuses(config(dir.path()), &["5 images", "4 poses", "poses_bounds.npy"]);
}

#[test]
fn pose_files() {
    let dir = llff();
    let file = dir.path().join("poses_bounds.npy");
    for (bytes, words) in [
        (npy("<f8", [4, 15], &[0; 4 * 15 * 8]), vec!["[4, 15]", "17"]),
        (npy("<f8", [0, 17], &[]), vec!["[0, 17]"]),
        (npy("<i8", [4, 17], &[0; 4 * 17 * 8]), vec!["<i8", "float64"]),
        (npy("<f8", [4, 17], &[0; 100]), vec!["4 x 17", "100 bytes", "truncated"]),
        (npy("<f8", [4, 17], &[0; 4 * 17 * 8]), vec!["view 0", "bounds 0 and 0"]),
        (b"PK\x03\x04 zipped".to_vec(), vec!["no .npy file"]),
        (b"\x93NUMPY".to_vec(), vec!["truncated"]),
    ] {
        fs::write(&file, bytes).unwrap();
        refuses(config(dir.path()), &[vec!["poses_bounds.npy"], words].concat());
    }
}

#[test]
fn pose_values() {
    let dir = llff();
    let with = |column: usize, value: f64| {
        let mut rows = [0.0, 0.1, 0.2, 0.3].map(row);
        rows[2][column] = value;
        write_poses(dir.path(), &rows);
    };
    for (column, value, words) in [
        (3, f64::NAN, ["view 2", "NaN in column 3"]),
        (16, f64::INFINITY, ["view 2", "inf in column 16"]),
        (15, 9.0, ["view 2", "bounds 9 and 5"]),
        (14, 28.0, ["view 2", "one camera"]),
        (12, -1.0, ["view 2", "mirrored"]),
        (12, 3.0, ["view 2", "length 1.0000, 1.0000 and 3.0000"]),
        // Numbers that f32 cannot hold, as they are and after poses are scaled.
        (15, 5e-324, ["view 2", "depth bounds"]),
        (3, 1e39, ["view 2", "column 3"]),
    ] {
        with(column, value);
        refuses(config(dir.path()), &[&words[..], &["poses_bounds.npy"]].concat());
    }
    let scaled =
        [0.0, 1e11, 0.2, 0.3].map(|x| std::array::from_fn(|column| if column == 15 { 2e-6 } else { row(x)[column] }));
    write_poses(dir.path(), &scaled);
    refuses(config(dir.path()), &["view", "1e12"]);
    // Turned by half a turn about the up axis: still a rotation, but not facing forward.
    let mut rows = [0.0, 0.1, 0.2, 0.3].map(row);
    rows[2][1] = -1.0;
    rows[2][12] = -1.0;
    write_poses(dir.path(), &rows);
    refuses(config(dir.path()), &["view 2", "data.ndc=false"]);
    write_poses(dir.path(), &[row(0.0)]);
    for i in 1..4 {
        fs::remove_file(dir.path().join(format!("images/{i}.png"))).unwrap();
    }
    refuses(config(dir.path()), &["0 views to train on", "1 held out"]);
}

#[test]
fn blender_files() {
    let dir = transforms(&SPLITS, ANGLE);
    let val = DataConfig { eval_split: EvalSplit::Val, ..config(dir.path()) };
    refuses(val, &["transforms_val.json", "data.eval_split=test"]);
    fs::remove_file(dir.path().join("transforms_test.json")).unwrap();
    let file = "transforms_train.json";
    for (from, to, words) in [
        ("camera_angle_x", "camera_angle", vec!["neither \"fl_x\" nor \"camera_angle_x\""]),
        ("0.7", "3.5", vec!["camera_angle_x", "3.5"]),
        ("0.7", "\"wide\"", vec!["camera_angle_x", "wide", "finite number"]),
        ("file_path", "path", vec!["frame 0", "\"file_path\" is missing"]),
        ("images/0", "images/zero", vec!["none of the 4 photos", "images/zero"]),
        ("transform_matrix", "matrix", vec!["frame 0", "\"transform_matrix\" is missing"]),
        ("[[1.0,0.0,0.0,0.0]", "[[1,0,0]", vec!["frame 0", "transform_matrix", "4x4"]),
        ("[[1.0,0.0,0.0,0.0]", "[[1,0,0,1e39]", vec!["frame 0", "transform_matrix"]),
        ("[[1.0,0.0,0.0,0.0]", "[[1,0,0,-1e308]", vec!["frame 0", "transform_matrix"]),
        ("[[1.0,0.0,0.0,0.0]", "[[2,0,0,0.0]", vec!["frame 0", "rotation", "2.0000"]),
        ("\"frames\"", "\"views\"", vec!["\"frames\" is missing"]),
        ("}]}", "}]", vec!["not valid JSON", "line 1"]),
        ("[{", "[3, {", vec!["frame 0", "a number"]),
    ] {
        let dir = transforms(&SPLITS, ANGLE);
        // A missing photo is no error while others are there.
        (1..4)
            .filter(|_| to.ends_with("zero"))
            .for_each(|i| edit(&dir.path().join(file), &format!("images/{i}"), &format!("images/no{i}")));
        edit(&dir.path().join(file), from, to);
        refuses(config(dir.path()), &[vec![file], words].concat());
    }
    let dir = transforms(&SPLITS, ANGLE);
    for (text, word) in [("[]", "an array"), ("{\"camera_angle_x\": 0.7, \"frames\": []}", "empty")] {
        fs::write(dir.path().join(file), text).unwrap();
        refuses(config(dir.path()), &[file, word]);
    }
}

#[test]
fn captures_of_unknown_lenses() {
    for (keys, words) in [
        ("\"scale\": 1", vec!["fl_x", "camera_angle_x"]),
        ("\"fl_x\": -3", vec!["fl_x", "-3", "positive"]),
        ("\"fl_x\": 20, \"camera_model\": \"OPENCV_FISHEYE\"", vec!["OPENCV_FISHEYE", "PINHOLE", "undistort"]),
        ("\"fl_x\": 20, \"is_fisheye\": true", vec!["is_fisheye", "is true", "pinhole"]),
        ("\"fl_x\": 20, \"is_fisheye\": 1", vec!["is_fisheye", "1", "true or false"]),
        ("\"fl_x\": 20, \"is_fisheye\": \"true\"", vec!["is_fisheye", "true or false"]),
        ("\"fl_x\": 20, \"k4\": 0.1", vec!["k4", "0.1", "undistort"]),
        ("\"fl_x\": 20, \"k1\": -5", vec!["cannot be undone"]),
        ("\"fl_x\": 20, \"w\": 12, \"h\": 16", vec!["16x12", "12x16"]),
        ("\"fl_x\": 20, \"k1\": \"small\"", vec!["k1", "small"]),
        // Numbers that f32 cannot hold.
        ("\"camera_angle_x\": 5e-324", vec!["camera_angle_x"]),
        ("\"camera_angle_x\": 3.14159265358979", vec!["camera_angle_x"]),
        ("\"fl_x\": 1e39", vec!["fl_x"]),
        ("\"fl_x\": 5e-324", vec!["fl_x"]),
        ("\"fl_x\": 20, \"cx\": -1e300", vec!["cx"]),
        ("\"fl_x\": 20, \"w\": 1e-300, \"h\": 1e-300", vec!["\"w\""]),
    ] {
        let dir = transforms(&["transforms.json"], keys);
        refuses(config(dir.path()), &[vec!["transforms.json"], words].concat());
    }
}

/// Folders of smaller images are taken where they serve: averaged further, and passed over where images are missing.
#[test]
fn smaller_images_are_averaged_and_incomplete_folders_passed_over() {
    let dir = llff();
    let columns = |factor: u32| {
        let before = files(dir.path(), &[]);
        let scene = try_load(DataConfig { downscale: Some(factor), holdout: 2, ..config(dir.path()) }).unwrap();
        assert!(files(dir.path(), &[]) == before, "something is left in the data");
        let passed = scene.space.notes.iter().find(|note| note.0 == "passed over").map(|note| note.1.clone());
        let camera = scene.train[0].camera;
        assert_eq!(camera.focal[0] / camera.width as f64, 14.0 / 16.0);
        (camera.width, passed)
    };
    assert_eq!(columns(2), (8, None));
    write_image(&dir.path().join("images_2/0.png"), 8, 6);
    let (width, passed) = columns(2);
    assert!(width == 8 && passed.unwrap().contains("images_2 has 1 images for 4 poses"));
    (1..4).for_each(|i| write_image(&dir.path().join(format!("images_2/{i}.png")), 8, 6));
    fs::remove_dir_all(dir.path().join("images")).unwrap();
    assert_eq!([2, 4].map(columns), [(8, None), (4, None)]);
}
