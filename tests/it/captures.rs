//! Captures of photographs as people have them: files that are missing, turned, masked, of several sizes, split by their author.

use std::f64::consts::TAU;
use std::fs;
use std::path::Path;
use std::sync::Mutex;

use crate::common::{assert_says, files, parameters, runtime, tiny_config, tiny_scene};
use augnerf::base::{Event, Listener, Result};
use augnerf::data::{Photos, Scene, View};
use augnerf::metrics::PSNR;
use augnerf::run::{Viewer, load_scene_with};
use augnerf::settings::{Config, DataConfig, DataKind, EvalSplit, Method, Resolved, Split};
use augnerf::train::Trainer;
use candle_core::DType;
use image::{DynamicImage, GrayImage, ImageFormat, Luma, Rgb, RgbImage};
use serde_json::{Value, json};
use tempfile::TempDir;

/// What was said.
#[derive(Default)]
struct Notes(Mutex<Vec<String>>);

impl Listener for Notes {
    fn on(&self, event: Event<'_>) {
        if let Event::Note(note) = event {
            self.0.lock().unwrap().push(note.to_string());
        }
    }
}

/// A capture that is being made: photographs on a ring around the origin, 16 x 12.
pub struct Folder {
    dir: TempDir,
    document: Value,
}

/// A photograph whose colours tell its number, column and row.
pub fn photograph(number: usize, width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| Rgb([(20 * number) as u8, (x * 10) as u8, (y * 12) as u8]))
}

pub const KEY: &str = "transform_matrix";

fn frame(number: usize, path: &str) -> Value {
    let (sin, cos) = (TAU * number as f64 / 12.0).sin_cos();
    json!({
        "file_path": path,
        KEY: [[cos, 0.0, sin, 4.0 * sin], [0.0, 1.0, 0.0, 0.5], [-sin, 0.0, cos, 4.0 * cos], [0.0, 0.0, 0.0, 1.0]],
    })
}

/// Changes each frame's object.
pub fn each(mut folder: Folder, change: impl Fn(usize, &mut Value)) -> Folder {
    folder.frames().iter_mut().enumerate().for_each(|(number, frame)| change(number, frame));
    folder
}

/// Gives a frame's camera the axes of OpenCV's.
pub fn turn(frame: &mut Value) {
    for row in frame[KEY].as_array_mut().unwrap().iter_mut().take(3) {
        (1..3).for_each(|column| row[column] = (-row[column].as_f64().unwrap()).into());
    }
}

impl Folder {
    pub fn new(count: usize) -> Folder {
        let folder = Folder { dir: TempDir::new().unwrap(), document: json!({"fl_x": 20.0}) };
        fs::create_dir(folder.path().join("images")).unwrap();
        (0..count).for_each(|i| folder.save(&format!("images/{i}.png"), photograph(i, 16, 12).into()));
        let frames: Vec<Value> = (0..count).map(|i| frame(i, &format!("images/{i}.png"))).collect();
        folder.with("frames", frames.into())
    }

    pub fn with(mut self, key: &str, value: Value) -> Folder {
        self.document[key] = value;
        self
    }

    pub fn path(&self) -> &Path {
        self.dir.path()
    }

    pub fn document(&self) -> &Value {
        &self.document
    }

    pub fn document_mut(&mut self) -> &mut Value {
        &mut self.document
    }

    pub fn frames(&mut self) -> &mut Vec<Value> {
        self.document["frames"].as_array_mut().unwrap()
    }

    fn save(&self, name: &str, picture: DynamicImage) {
        picture.save(self.path().join(name)).unwrap();
    }

    pub fn remove(&self, number: usize) {
        fs::remove_file(self.path().join(format!("images/{number}.png"))).unwrap();
    }

    pub fn into_dir(self) -> TempDir {
        self.dir
    }

    /// Moves all cameras.
    pub fn moved(self, shift: [f64; 3]) -> Folder {
        each(self, |_, frame| {
            for (row, shift) in shift.into_iter().enumerate() {
                frame[KEY][row][3] = (frame[KEY][row][3].as_f64().unwrap() + shift).into();
            }
        })
    }

    pub fn write(&self) {
        fs::write(self.path().join("transforms.json"), self.document.to_string()).unwrap();
    }

    /// Writes the document and loads the scene as the program does; what is said comes back, too.
    pub fn read(&self, change: impl FnOnce(&mut DataConfig)) -> (Result<Scene>, Vec<String>) {
        self.write();
        read(self.path(), change)
    }

    pub fn load(&self, change: impl FnOnce(&mut DataConfig)) -> Scene {
        self.read(change).0.unwrap()
    }

    #[track_caller]
    pub fn refuses(&self, words: &[&str]) -> String {
        let error = self.read(|_| {}).0.expect_err("must be refused");
        assert_eq!(error.exit_code(), 3, "{error}");
        assert_says(&error.to_string(), words);
        error.to_string()
    }
}

pub fn read(dir: &Path, change: impl FnOnce(&mut DataConfig)) -> (Result<Scene>, Vec<String>) {
    let (loaded, notes) = load(dir, Photos::Read, |config| change(&mut config.data));
    (loaded.map(|(_, scene)| scene), notes)
}

/// The same with all settings.
pub fn load(dir: &Path, photos: Photos, change: impl FnOnce(&mut Config)) -> (Result<(Resolved, Scene)>, Vec<String>) {
    let mut config = Config::default();
    config.data.dir = dir.display().to_string();
    change(&mut config);
    let notes = Notes::default();
    let loaded = load_scene_with(config, photos, &notes);
    (loaded, notes.0.into_inner().unwrap())
}

pub fn names(views: &[View]) -> Vec<&str> {
    views.iter().map(|view| view.name.as_str()).collect()
}

pub fn all(scene: &Scene) -> impl Iterator<Item = &View> {
    scene.train.iter().chain(&scene.test)
}

/// What the scene says of itself under a label.
fn told(scene: &Scene, label: &str) -> String {
    let row = scene.describe().into_iter().find(|(own, _)| own == label);
    row.unwrap_or_else(|| panic!("no line '{label}'")).1
}

fn view<'a>(scene: &'a Scene, name: &str) -> &'a View {
    all(scene).find(|view| view.name == name).unwrap()
}

#[test]
fn missing_photographs_are_left_out_and_named() {
    let folder = Folder::new(10);
    (0..5).for_each(|i| folder.remove(2 * i + 1));
    let (scene, notes) = folder.read(|_| {});
    let scene = scene.unwrap();
    // Every 8th of those that are listed is held out.
    assert_eq!((names(&scene.train), names(&scene.test)), (vec!["2", "4", "6"], vec!["0", "8"]));
    assert_eq!(notes.len(), 1, "{notes:?}");
    assert_says(&notes[0], &["transforms.json: 5 of 10", "images/1.png", "images/5.png", "images/9.png"]);
    assert!(!notes[0].contains("images/0.png"));
    // It stays with the scene, whoever was quiet, without the folder that the scene lies in.
    let kept = told(&scene, "noted");
    assert_says(&kept, &["transforms.json: 5 of 10", "images/1.png"]);
    assert!(!kept.contains(&folder.path().display().to_string()), "{kept}");
    (0..5).for_each(|i| folder.remove(2 * i));
    folder.refuses(&["none of the 10 photos", "images/0.png", "images/9.png"]);
}

/// A capture with lists of its author's, their paths spelt in three ways.
pub fn listed(lists: &str) -> Folder {
    let name = |i: &str| [format!("images/{i}.png"), format!("./images/{i}.png"), format!("images\\{i}.png")];
    lists.split(", ").fold(Folder::new(9), |folder, list| {
        let (role, views) = list.split_once(' ').unwrap();
        let views: Vec<String> = views.split(' ').enumerate().map(|(k, i)| name(i)[k % 3].clone()).collect();
        folder.with(&format!("{role}_filenames"), views.into())
    })
}

/// A list that is not there has what the others leave.
#[test]
fn the_author_s_split_is_kept_and_every_nth_view_is_held_out_on_demand() {
    let all = "train 1 3 5 6, val 7, test 0 2";
    let val: fn(&mut DataConfig) = |data| data.eval_split = EvalSplit::Val;
    for (lists, change, train, test) in [
        (all, (|_| {}) as fn(&mut DataConfig), "1 3 5 6", "0 2"),
        (all, val, "1 3 5 6", "7"),
        (all, |data| data.test_skip = 2, "1 3 5 6", "0"),
        (all, |data| data.split = Some(Split::Every), "1 2 3 4 5 6 7", "0 8"),
        ("test 0 4", |_| {}, "1 2 3 5 6 7 8", "0 4"),
        ("train 0 4", |_| {}, "0 4", "1 2 3 5 6 7 8"),
        ("train 0 4, val 1", |_| {}, "0 4", "2 3 5 6 7 8"),
        ("train 0 4, test 1", val, "0 4", "2 3 5 6 7 8"),
    ] {
        let scene = listed(lists).load(change);
        assert_eq!([&scene.train, &scene.test].map(|views| names(views).join(" ")), [train, test], "{lists}");
    }
    let folder = listed(all);
    let error = folder.read(|data| data.validation = 4).0.expect_err("must be refused");
    assert_says(&error.to_string(), &["data.validation = 4", "data.eval_split=val", "data.split=every"]);
    // Missing photographs may be named; a name of nothing may not.
    folder.remove(5);
    assert_eq!(names(&folder.load(|_| {}).train), ["1", "3", "6"]);
    let named = |folder: &Folder, split: Option<Split>| {
        let (loaded, _) = load(folder.path(), Photos::Read, |config| config.data.split = split);
        loaded.map(|(config, _)| config.data.split)
    };
    assert_eq!(named(&folder, None).unwrap(), Some(Split::Own));
    let plain = Folder::new(9);
    plain.write();
    let refusal = named(&plain, Some(Split::Own)).unwrap_err().to_string();
    assert_says(&refusal, &["data.split = \"own\"", "train_filenames"]);
    listed("val 0 12").refuses(&["val_filenames", "images/12.png", "no frame"]);
    listed("val 0").refuses(&["no views for data.eval_split=test", "data.eval_split=val"]);
    Folder::new(6).with("val_filenames", json!([1])).refuses(&["val_filenames", "a list of texts"]);
}

/// Writes `transforms_{split}.json` with four of the folder's photographs from `first` on.
fn write_split(folder: &Folder, split: &str, first: usize, keys: &[(&str, Value)]) {
    let frames: Vec<Value> = (first..first + 4).map(|i| frame(i, &format!("./images/{i}"))).collect();
    let mut document = json!({"frames": frames});
    keys.iter().for_each(|(key, value)| document[*key] = value.clone());
    fs::write(folder.path().join(format!("transforms_{split}.json")), document.to_string()).unwrap();
}

#[test]
fn split_files_have_their_intrinsics_honoured() {
    let folder = Folder::new(8);
    let keys = [("fl_x", 40), ("fl_y", 38), ("cx", 15), ("cy", 13), ("w", 32), ("h", 24)];
    let keys = keys.map(|(key, value)| (key, json!(value)));
    write_split(&folder, "train", 0, &keys);
    write_split(&folder, "test", 4, &[("camera_angle_x", json!(0.7))]);
    let (scene, notes) = read(folder.path(), |data| data.downscale = Some(2));
    let scene = scene.unwrap();
    assert_eq!((scene.kind, scene.train.len(), scene.test.len(), notes.len()), ("blender", 4, 4, 0));
    let camera = scene.train[0].camera;
    assert_eq!((camera.width, camera.height, camera.focal, camera.centre), (8, 6, [10.0, 9.5], [3.75, 3.25]));
    let other = scene.test[0].camera;
    assert_eq!((other.focal, other.centre), ([4.0 / (0.35f64).tan(); 2], [4.0, 3.0]));
    // Distortion is undone, and the author's split stays.
    write_split(&folder, "train", 0, &[&keys[..], &[("k1", json!(0.1))]].concat());
    let bent = read(folder.path(), |data| data.downscale = Some(2)).0.unwrap();
    assert!(bent.train[0].camera.focal[0] > 10.0 && bent.train.len() == 4);
    // As captures: recentred, with bounds of captures, by the same split.
    let capture = read(folder.path(), |data| (data.kind, data.downscale) = (DataKind::Transforms, Some(1)));
    let capture = capture.0.unwrap();
    assert_eq!((capture.kind, capture.train.len(), capture.test.len()), ("transforms", 4, 4));
    assert!(all(&capture).all(|view| view.camera.pose.iter().all(|row| row[3].abs() <= 1.0 + 1e-12)));
}

#[test]
fn photographs_that_are_trained_on_and_evaluated_are_named() {
    let folder = Folder::new(8);
    write_split(&folder, "train", 0, &[("fl_x", json!(20))]);
    write_split(&folder, "test", 2, &[("fl_x", json!(20))]);
    let (scene, notes) = read(folder.path(), |data| data.downscale = Some(1));
    assert_eq!(scene.unwrap().test.len(), 4);
    assert_says(&notes.concat(), &["2 of 4", "images/2", "images/3", "not of unseen views"]);
    let every = |data: &mut DataConfig| (data.kind, data.split) = (DataKind::Transforms, Some(Split::Every));
    assert_eq!(all(&read(folder.path(), every).0.unwrap()).count(), 6);
    // One of them has another pose there.
    let test = folder.path().join("transforms_test.json");
    let mut document: Value = files::json(&test);
    document["frames"][1][KEY][0][3] = json!(1.5);
    fs::write(&test, document.to_string()).unwrap();
    let refusal = read(folder.path(), every).0.unwrap_err().to_string();
    assert_says(&refusal, &["images/3.png", "twice", "two poses"]);
}

fn grey(width: u32, height: u32, value: impl Fn(u32, u32) -> u8) -> DynamicImage {
    GrayImage::from_fn(width, height, |x, y| Luma([value(x, y)])).into()
}

#[test]
fn masks_of_frames_and_of_all_frames_say_which_pixels_count() {
    let mut folder = Folder::new(9);
    // Of the frame's mask, larger than its photograph, one pixel of the original is black; of the other, the right half.
    folder.save("one.png", grey(32, 24, |x, y| u8::from((x, y) != (5, 2))));
    folder.save("half.png", grey(16, 12, |x, _| if x < 8 { 255 } else { 0 }));
    folder.document["frames"][1]["mask_path"] = "one.png".into();
    let folder = folder.with("mask_path", "half".into());
    let scene = folder.load(|data| data.downscale = Some(2));
    let counted = |name: &str| view(&scene, name).mask.as_ref().unwrap().iter().filter(|counts| **counts).count();
    assert_eq!((counted("1"), counted("0"), counted("5")), (47, 24, 24));
    // (5, 2) of 32 x 24 lies in (1, 0) of 8 x 6.
    assert!(!view(&scene, "1").mask.as_ref().unwrap()[1]);
    let plain = Folder::new(9).load(|data| data.downscale = Some(2));
    assert!(all(&plain).all(|view| view.mask.is_none()) && plain.hash() != scene.hash());
    assert_eq!(plain.train[0].image, scene.train[0].image);
}

/// Distortion moves masks as it moves photographs.
#[test]
fn masks_are_undistorted_with_their_photographs() {
    let folder = Folder::new(9).with("k1", json!(0.3)).with("mask_path", "mask.png".into());
    (0..9).for_each(|i| {
        let ring = |x: u32, y: u32| (f64::from(x) - 7.5).hypot(f64::from(y) - 5.5);
        let picture = RgbImage::from_fn(16, 12, |x, y| Rgb([if ring(x, y) < 4.0 { 255 } else { 0 }; 3]));
        folder.save(&format!("images/{i}.png"), picture.clone().into());
        folder.save("mask.png", DynamicImage::from(picture).into_luma8().into());
    });
    let scene = folder.load(|_| {});
    let View { image, mask, .. } = &scene.train[0];
    let mask = mask.as_ref().unwrap();
    let counted = mask.iter().filter(|counts| **counts).count();
    // A pixel counts where the photograph is white through and through.
    assert!(counted > 10 && counted < 16 * 12 / 2, "{counted}");
    for (texel, &counts) in image.pixels.chunks_exact(3).zip(mask.iter()) {
        assert_eq!(counts, texel[0] >= 1.0 - 1e-4, "{texel:?}");
    }
}

/// JPEG turns black beside white into dark grey.
#[test]
fn masks_that_lost_values_count_where_they_are_bright() {
    let folder = Folder::new(9).with("mask_path", "mask.jpg".into());
    let half = grey(16, 12, |x, _| if x < 5 { 255 } else { 0 });
    folder.save("mask.jpg", half.clone());
    let stored = image::open(folder.path().join("mask.jpg")).unwrap().into_luma8();
    assert!(stored.pixels().any(|pixel| (1..128).contains(&pixel.0[0])), "nothing leaks");
    let scene = folder.load(|_| {});
    let mask = scene.train[0].mask.as_ref().unwrap();
    let expected: Vec<bool> = half.into_luma8().pixels().map(|pixel| pixel.0[0] > 0).collect();
    assert_eq!(&mask[..], expected);
}

#[test]
fn masks_that_cannot_be_meant() {
    let with = |mask: DynamicImage| {
        let folder = Folder::new(9).with("mask_path", "mask.png".into());
        folder.save("mask.png", mask);
        folder
    };
    with(grey(16, 12, |_, _| 0)).refuses(&["mask.png", "no pixel", "0.png"]);
    with(grey(8, 6, |_, _| 255)).refuses(&["mask.png is 8x6", "16x12"]);
    with(grey(24, 24, |_, _| 255)).refuses(&["mask.png is 24x24", "16x12"]);
    Folder::new(9).with("mask_path", "nowhere.png".into()).refuses(&["mask_path", "nowhere.png", "no such image"]);
    Folder::new(9).with("mask_path", json!(3)).refuses(&["mask_path", "3", "a text"]);
}

/// What is masked can be anything: weights, losses, gains and metrics stay.
#[test]
fn masked_pixels_take_no_part_in_training_or_metrics() {
    let mask: std::sync::Arc<[bool]> = (0..256).map(|pixel| pixel % 16 < 10).collect();
    let of = |masked_colour: Option<f32>| {
        let mut scene = tiny_scene();
        for view in scene.train.iter_mut().chain(&mut scene.test) {
            let mut image = (*view.image).clone();
            let texels = image.pixels.chunks_exact_mut(3).zip(mask.iter()).filter(|(_, counts)| !**counts);
            texels.for_each(|(texel, _)| masked_colour.into_iter().for_each(|colour| texel.fill(colour)));
            (view.image, view.mask) = (image.into(), masked_colour.is_some().then(|| mask.clone()));
        }
        let config = tiny_config(Method::AugNerf, |config| config.train.rays = 40);
        let mut trainer = Trainer::new(&config, &scene, DType::F32, runtime()).unwrap();
        (0..5).for_each(|_| drop(trainer.step(false).unwrap()));
        let viewer = Viewer { model: trainer.model().unwrap(), config: &config, scene: &scene, runtime: runtime() };
        let evaluated = viewer.evaluate(&[], &(), || Ok(()), |_, _, _| Ok(())).unwrap().remove(0);
        (parameters(&trainer, &["coarse", "fine"]), evaluated)
    };
    let (dark, bright, unmasked) = (of(Some(0.0)), of(Some(0.9)), of(None));
    assert!(dark.0 == bright.0 && dark.1 == bright.1);
    assert!(dark.0 != unmasked.0 && dark.1.get(&PSNR) != unmasked.1.get(&PSNR));
}

#[test]
fn webp_is_read_with_and_without_its_ending() {
    let mut folder = Folder::new(9);
    for (i, path) in [(2, "images/2.webp"), (5, "images/5")] {
        folder.remove(i);
        folder.save(&format!("images/{i}.webp"), photograph(i, 16, 12).into());
        folder.frames()[i]["file_path"] = path.into();
    }
    let (scene, notes) = folder.read(|_| {});
    assert!(notes.is_empty(), "{notes:?}");
    // Lossless, so the same as from PNG.
    assert_eq!(scene.unwrap().hash(), Folder::new(9).load(|_| {}).hash());
    fs::write(folder.path().join("images/2.tif"), b"II*\x00").unwrap();
    folder.document["frames"][2]["file_path"] = "images/2.tif".into();
    folder.refuses(&["2.tif is there", "PNG, JPEG and WebP"]);
}

/// A JPEG with an EXIF orientation.
pub fn turned_jpeg(picture: RgbImage, orientation: u8) -> Vec<u8> {
    let mut plain = std::io::Cursor::new(Vec::new());
    DynamicImage::from(picture).write_to(&mut plain, ImageFormat::Jpeg).unwrap();
    let plain = plain.into_inner();
    // One entry, 0x0112 (orientation), a single short.
    let tiff = [&b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0"[..], &[orientation, 0, 0, 0], &[0; 4]].concat();
    let exif = [&b"Exif\0\0"[..], &tiff].concat();
    let length = (exif.len() as u16 + 2).to_be_bytes();
    [&plain[..2], &[0xff, 0xe1], &length, &exif, &plain[2..]].concat()
}

#[test]
fn portraits_stand_beside_landscapes() {
    let folder = Folder::new(9);
    folder.save("images/4.png", photograph(4, 12, 16).into());
    folder.save("images/8.png", photograph(8, 32, 24).into());
    let sizes = |change: fn(&mut DataConfig)| {
        let scene = folder.load(change);
        ["0", "4", "8"].map(|name| {
            let View { camera, image, .. } = view(&scene, name);
            assert_eq!((camera.width, camera.height), (image.width, image.height));
            assert_eq!(camera.centre, [camera.width as f64 / 2.0, camera.height as f64 / 2.0]);
            (camera.width, camera.height)
        })
    };
    assert_eq!(sizes(|data| data.downscale = Some(2)), [(8, 6), (6, 8), (16, 12)]);
    // One scale for all, the widest as wide as asked for.
    assert_eq!(sizes(|data| data.width = 16), [(8, 6), (6, 8), (16, 12)]);
    assert_says(&folder.read(|data| data.width = 33).0.unwrap_err().to_string(), &["data.width = 33", "32"]);
}

/// The box that most cameras look at is as wide as a Blender scene's, and all lengths have its unit.
#[test]
fn a_rescaled_capture_has_the_unit_of_a_blender_scene() {
    let folder = Folder::new(12);
    let (own, rescaled) = (folder.load(|_| {}), folder.load(|config| config.rescale = true));
    let [lower, upper] = own.space.domain.unwrap();
    let longest = (0..3).map(|axis| upper[axis] - lower[axis]).fold(0.0, f64::max);
    let factor = 3.0 / longest;
    assert!((factor - 1.0).abs() > 0.01);
    let close = |a: f64, b: f64| (a - b).abs() < 1e-9;
    let [low, high] = rescaled.space.domain.unwrap();
    for axis in 0..3 {
        let middle = (lower[axis] + upper[axis]) / 2.0;
        assert!(close(low[axis], (lower[axis] - middle) * factor) && close(high[axis], -low[axis]));
        for (own, rescaled) in all(&own).zip(all(&rescaled)) {
            let (own, rescaled) = (own.camera.pose[axis], rescaled.camera.pose[axis]);
            assert_eq!(own[..3], rescaled[..3]);
            assert!(close(rescaled[3], (own[3] - middle) * factor));
        }
    }
    assert!(close(rescaled.near, own.near * factor) && close(rescaled.far, own.far * factor));
    // Cameras in the capture's own units, such as those of a path, still lead to the same place.
    for (before, after) in all(&own).zip(all(&rescaled)) {
        let capture = own.space.world.to_capture(before.camera.pose.map(|row| row[3]));
        let placed = rescaled.space.world.point(capture);
        assert!((0..3).all(|axis| close(placed[axis], after.camera.pose[axis][3])));
    }
    assert!(told(&rescaled, "rescaled").contains("3 wide"));
    // Parallel cameras have no box.
    let parallel = |i: usize| json!([[1, 0, 0, i], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]);
    let folder = each(Folder::new(12), |i, frame| frame[KEY] = parallel(i));
    let error = folder.read(|config| config.rescale = true).0.expect_err("must be refused");
    assert_eq!(error.exit_code(), 3, "{error}");
    assert_says(&error.to_string(), &["data.rescale", "no common point", "set data.rescale=false"]);
}
