//! How much of photographs is read: headers where they are enough, pixels where they count; turned, transparent and many ones.

use std::fs;
use std::path::Path;

use augnerf::data::Photos;
use augnerf::run::load_scene_with;
use augnerf::settings::Config;
use image::{Rgb, RgbImage, Rgba, RgbaImage};
use serde_json::Value;
use tempfile::TempDir;

use crate::captures::{Folder, Notes, photograph, turned_jpeg};
use crate::colmap::{arc_of, fuzz_model, threshold};
use crate::common::assert_says;
use crate::common::files::{json, text};
use crate::common::program::{augnerf, demand, printed, refuse, succeed};

/// Damages a PNG's pixels behind its header.
fn damage(file: &Path) {
    let mut bytes = fs::read(file).unwrap();
    let at = bytes.windows(4).position(|four| four == b"IDAT").unwrap();
    bytes[at + 6..at + 12].fill(0xff);
    fs::write(file, bytes).unwrap();
}

/// A folder of nine photographs, of which every 8th is held out, with its transforms.json.
fn capture() -> (Folder, String) {
    let folder = Folder::new(9);
    folder.write();
    let name = folder.path().display().to_string();
    (folder, name)
}

/// Trains a few steps; returns the run's folder.
fn train(data: &str, out: &Path) -> String {
    let out = out.display().to_string();
    let small =
        ["--preset", "smoke", "--set", "train.steps=2", "--set", "train.rays=16", "--set", "data.downscale=1", "-q"];
    succeed(&[&["train", "--data", data, "--out", &out], &small[..]].concat());
    out
}

/// Photographs whose pixels are damaged are named by what decodes them, and by nothing else.
#[test]
fn pixels_are_read_only_where_they_count() {
    let (folder, data) = capture();
    let dir = TempDir::new().unwrap();
    let run = train(&data, &dir.path().join("run"));
    let photo = |i: usize| folder.path().join(format!("images/{i}.png"));
    (1..9).for_each(|i| damage(&photo(i)));
    let check = ["data", "check", &data, "--set", "data.downscale=1"];
    assert_says(&printed(&check), &["7 (1, 2,", "2 (0, 8)", "16 x 12 pixels", "--pixels"]);
    let hash = |more: &[&str]| -> Value {
        let all = printed(&[&check[..], &["--json"], more].concat());
        serde_json::from_str::<Value>(&all).unwrap()["data_hash"].clone()
    };
    assert!(hash(&[]).is_null());
    refuse(&[&check[..], &["--pixels"]].concat(), 3, &["images/1.png", "damaged"]);
    refuse(&["train", "--data", &data, "--out", "never"], 3, &["images/1.png", "damaged"]);

    let out = |name: &str| dir.path().join(name).display().to_string();
    let mesh = ["mesh", &run, "--resolution", "8", "--cap", "--out", &out("mesh"), "-q"];
    succeed(&[&mesh[..], &["--threshold", &threshold(&mesh)]].concat());
    let protocol = |file: &str| json(Path::new(file))["protocol"]["data_hash"].clone();
    assert!(protocol(&format!("{}/mesh.json", out("mesh"))).is_string());
    assert_eq!(protocol(&format!("{}/mesh.json", out("mesh"))), protocol(&format!("{run}/metrics.json")));
    succeed(&["eval", "--smoothness", &run, "--lattice", "8", "-q"]);
    succeed(&["render", &run, "--frames", "1", "--resolution", "16x16", "--out", &out("path"), "-q"]);
    succeed(&["export", &run, &out("run.safetensors"), "-q"]);
    // One photograph is compared with, which is whole; the other is not.
    succeed(&["compare", &run, "--view", "0", "--out", &out("compared"), "-q"]);
    refuse(&["compare", &run, "--view", "8", "--out", &out("damaged"), "-q"], 3, &["images/8.png", "damaged"]);
    refuse(&["render", &run, "--what", "views", "--out", &out("views"), "-q"], 3, &["images/8.png", "damaged"]);
    refuse(&["eval", &run], 3, &["damaged"]);
    // Without an evaluation nothing else knows the hash of all pixels.
    fs::remove_file(format!("{run}/metrics.json")).unwrap();
    refuse(&[&mesh[..], &["--threshold", "1"]].concat(), 3, &["images/1.png", "damaged"]);
}

/// Loads a folder; returns the views' sizes, and what is said.
fn load(dir: &Path, photos: Photos) -> Result<(Vec<(usize, usize)>, String), String> {
    let mut config = Config::default();
    (config.data.dir, config.data.downscale) = (dir.display().to_string(), Some(1));
    let notes = Notes::default();
    let (_, scene) = load_scene_with(config, photos, &notes).map_err(|error| error.to_string())?;
    let views: Vec<_> = scene.train.iter().chain(&scene.test).map(|view| view.read().unwrap()).collect();
    for view in &views {
        assert_eq!((view.image.width, view.image.height), (view.camera.width, view.camera.height));
        assert_eq!(view.image.pixels.len(), view.image.width * view.image.height * 3);
    }
    Ok((views.iter().map(|view| (view.camera.width, view.camera.height)).collect(), notes.text()))
}

/// Photographs that are stored 16 x 12 and meant 12 x 16, as an EXIF orientation says.
#[test]
fn turned_photographs_are_turned_if_only_that_fits_their_cameras() {
    let write = |dir: &Path, model: [u64; 2], count: usize, numbered: fn(usize) -> String| {
        fs::remove_dir_all(dir.join("images")).ok();
        fs::create_dir_all(dir.join("images")).unwrap();
        for i in 0..count {
            fs::write(dir.join("images").join(numbered(i)), turned_jpeg(photograph(i, 16, 12), 6)).unwrap();
        }
        model
    };
    let colmap = |size: [u64; 2]| {
        let dir = TempDir::new().unwrap();
        let [width, height] = write(dir.path(), size, 4, |i| format!("{i}.jpg"));
        let centre = [width as f64 / 2.0, height as f64 / 2.0];
        let mut model = fuzz_model();
        model.photographs.iter_mut().for_each(|photo| photo.name = photo.name.replace("png", "jpg"));
        model.cameras = [1, 2].map(|id| (id, 0, "SIMPLE_PINHOLE", size, vec![15.0, centre[0], centre[1]])).into();
        model.write(&dir.path().join("sparse/0"), true);
        dir
    };
    let llff = |size: [u64; 2]| {
        let dir = TempDir::new().unwrap();
        arc_of(dir.path(), 20.0, size.map(|side| side as f64));
        write(dir.path(), size, 12, |i| format!("{i:02}.jpg"));
        dir
    };
    let transforms = |[width, height]: [u64; 2]| {
        let mut folder = Folder::new(9).with("w", width.into()).with("h", height.into());
        write(folder.path(), [width, height], 9, |i| format!("{i}.jpg"));
        folder.name_files(|i| format!("images/{i}.jpg"));
        folder.write();
        folder.into_dir()
    };
    for (what, make) in
        [("colmap", &colmap as &dyn Fn([u64; 2]) -> TempDir), ("llff", &llff), ("transforms", &transforms)]
    {
        for photos in [Photos::Read, Photos::Later] {
            for (size, said) in [([12, 16], "is applied"), ([16, 12], "is not applied")] {
                let (sizes, notes) = load(make(size).path(), photos).unwrap_or_else(|error| panic!("{what}: {error}"));
                assert!(sizes.iter().all(|found| *found == (size[0] as usize, size[1] as usize)), "{what}: {sizes:?}");
                assert_says(&notes, &["EXIF orientation", said, "images/"]);
            }
        }
        // Neither fits.
        assert!(load(make([20, 10]).path(), Photos::Later).is_err(), "{what}");
    }
}

/// Photographs with alpha, by their numbers.
fn with_alpha(count: usize, alpha: impl Fn(usize, u32) -> u8) -> Folder {
    let folder = Folder::new(count);
    for i in 0..count {
        let plain = photograph(i, 16, 12);
        let pixel = |x: u32, y: u32| {
            let Rgb([r, g, b]) = *plain.get_pixel(x, y);
            Rgba([r, g, b, alpha(i, x)])
        };
        RgbaImage::from_fn(16, 12, pixel).save(folder.path().join(format!("images/{i}.png"))).unwrap();
    }
    folder.write();
    folder
}

#[test]
fn photographs_that_show_nothing_are_told() {
    for photos in [Photos::Read, Photos::Later] {
        let folder = with_alpha(9, |_, _| 0);
        let error = load(folder.path(), photos).unwrap_err();
        assert_says(&error, &["all 9 photos are wholly transparent", "alpha", "mogrify -alpha off", "images/0.png"]);
        // As a Blender scene.
        fs::copy(folder.path().join("transforms.json"), folder.path().join("transforms_train.json")).unwrap();
        assert_says(&load(folder.path(), photos).unwrap_err(), &["train photos are wholly transparent"]);
        // One that shows something is enough for the others to be noted.
        let (_, notes) = load(with_alpha(9, |i, x| if i < 2 { 0 } else { 16 * x as u8 }).path(), photos).unwrap();
        assert_says(&notes, &["2 of 9 photos are wholly transparent", "images/0.png, images/1.png"]);
        let (_, notes) = load(with_alpha(9, |_, _| 255).path(), photos).unwrap();
        assert!(!notes.contains("transparent"), "{notes}");
    }
    // Only as many are decoded as tell whether there is a background: the others may be damaged.
    let folder = with_alpha(9, |_, x| 16 * x as u8);
    (1..9).for_each(|i| damage(&folder.path().join(format!("images/{i}.png"))));
    let said = printed(&["data", "check", folder.path().to_str().unwrap(), "--set", "data.downscale=1"]);
    assert_says(&said, &["background  [1.0, 1.0, 1.0]"]);

    // Opaque ones of one colour, the held-out ones alone.
    let folder = Folder::new(9);
    for i in [0, 8] {
        RgbImage::from_pixel(16, 12, Rgb([90; 3])).save(folder.path().join(format!("images/{i}.png"))).unwrap();
    }
    folder.write();
    let (_, notes) = load(folder.path(), Photos::Read).unwrap();
    assert_says(&notes, &["all 2 held-out views are of one and the same colour"]);
    RgbImage::from_pixel(16, 12, Rgb([10; 3])).save(folder.path().join("images/8.png")).unwrap();
    let (_, notes) = load(folder.path(), Photos::Read).unwrap();
    assert!(!notes.contains("colour"), "{notes}");
}

/// The numbers of a text after a word at the start of a line.
fn numbers(text: &str, word: &str) -> Vec<[f64; 3]> {
    let lines = text.lines().filter_map(|line| line.strip_prefix(word));
    lines
        .map(|line| {
            line.split_whitespace().take(3).map(|v| v.parse().unwrap()).collect::<Vec<f64>>().try_into().unwrap()
        })
        .collect()
}

/// A mesh of poses in a national grid: single precision has steps of 0.5 there, and the cameras are 4 from the middle.
#[test]
fn meshes_of_georeferenced_captures_keep_their_precision() {
    let dir = TempDir::new().unwrap();
    let drawn = |name: &str, shift: [f64; 3]| {
        let folder = Folder::new(9).moved(shift);
        folder.write();
        let run = train(folder.path().to_str().unwrap(), &dir.path().join(name));
        let out = dir.path().join(format!("{name} mesh"));
        let mesh = ["mesh", &run, "--resolution", "12", "--cap", "--units", "capture", "--format", "ply,obj", "--out"];
        let mesh = [&mesh[..], &[out.to_str().unwrap()]].concat();
        let said = demand(&mut augnerf(&[&mesh[..], &["--threshold", &threshold(&mesh)]].concat()), 0);
        let report = json(&out.join("mesh.json"));
        let [x, y, z]: [f64; 3] = serde_json::from_value(report["offset"].clone()).unwrap();
        let obj = text(&out.join("mesh.obj"));
        let places: Vec<[f64; 3]> = numbers(&obj, "v ").into_iter().map(|[a, b, c]| [a + x, b + y, c + z]).collect();
        assert_eq!(places.len() as u64, report["vertices"].as_u64().unwrap());
        (report, places, said, (out, folder))
    };
    let (near, at_0, said, _) = drawn("near", [0.0; 3]);
    assert!(near["offset"] == serde_json::json!([0.0, 0.0, 0.0]) && !said.contains("offset"), "{said}");
    let shift = [441_547.0, 5_121_946.0, -30.0];
    let (far, there, said, (out, _folder)) = drawn("far", shift);
    assert_says(&said, &["less an offset of 441", ", 5121", "mesh.json"]);
    // One field in scene units, and so one mesh, but for the rounding of the poses' mean.
    assert_eq!(at_0.len(), there.len());
    for (a, b) in at_0.iter().zip(&there) {
        (0..3).for_each(|i| assert!((a[i] + shift[i] - b[i]).abs() < 1e-3, "{a:?} {b:?}"));
    }
    let area = |report: &Value| report["area"].as_f64().unwrap();
    assert!((area(&near) / area(&far) - 1.0).abs() < 1e-3 && near["closed"] == far["closed"]);
    // Both files are read back to where the mesh is.
    let files = ["mesh.ply", "mesh.obj"].map(|name| out.join(name).display().to_string());
    let compared: Value =
        serde_json::from_str(&printed(&["mesh", &files[0], "--chamfer", &files[1], "--points", "500", "--json"]))
            .unwrap();
    assert!(compared["distance"]["chamfer"].as_f64().unwrap() < 1e-6, "{compared}");
    // A file's name is no folder's.
    for name in ["r.ply", "R.OBJ", "film.mp4"] {
        let run = dir.path().join("far").display().to_string();
        refuse(&["mesh", &run, "--out", name], 2, &["--out", name, "name a folder"]);
        refuse(&["render", &run, "--out", name], 2, &["--out", name, "name a folder"]);
        assert!(!std::env::temp_dir().join(name).exists());
    }
}

/// Within a limit of address space too little memory is told, not met.
#[cfg(target_os = "linux")]
#[test]
fn limits_of_memory_are_told() {
    let dir = TempDir::new().unwrap();
    let folder = Folder::new(9).with("fl_x", 5000.into());
    let photo = |i: usize| folder.path().join(format!("images/{i}.png"));
    let save = |side: u32| {
        RgbImage::from_fn(side, side, |x, y| Rgb([x as u8, y as u8, 7])).save(photo(0)).unwrap();
        (1..9).for_each(|i| assert!(fs::copy(photo(0), photo(i)).is_ok()));
    };
    save(4000);
    folder.write();
    let data = folder.path().display().to_string();
    let out = dir.path().join("out").display().to_string();
    let limited = |command: &str, code: i32, words: &[&str]| {
        let program = env!("CARGO_BIN_EXE_augnerf");
        let line = format!("ulimit -v 1500000; exec {program} {command}");
        let mut shell = std::process::Command::new("sh");
        shell.args(["-c", &line]).env("AUGNERF_DATA", "").env("RAYON_NUM_THREADS", "1");
        assert_says(&demand(&mut shell, code), words);
    };
    for command in [
        format!("data check {data} --set data.downscale=1"),
        format!("train --data {data} --set data.downscale=1 --threads 1 --out {out}"),
    ] {
        limited(&command, 3, &["9 images of 4000x4000 pixels take 1.6 GiB of memory", "are free", "data.downscale"]);
    }
    save(500);
    limited(&format!("data check {data} --pixels --set data.downscale=50"), 0, &["10 x 10 pixels"]);
    // Not even one can be decoded: it takes more than the limit.
    image::GrayImage::new(18_000, 18_000).save(photo(0)).unwrap();
    limited(
        &format!("data check {data} --pixels --set data.width=80"),
        3,
        &["images/0.png takes up to", "MiB are free"],
    );
}
