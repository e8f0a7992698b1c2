//! How much of photographs is read: headers where they are enough, pixels where they count; turned, transparent and many ones.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use augnerf::base::Image;
use augnerf::data::Photos;
use augnerf::mesh::{chamfer, read_mesh, sample};
use image::{Rgb, RgbImage, Rgba, RgbaImage};
use serde_json::Value;
use tempfile::TempDir;

use crate::captures::{self, Folder, all, each, photograph, turned_jpeg};
use crate::colmap::{arc_of, draw_mesh};
use crate::common::assert_says;
use crate::common::files::{copy, fixture};
use crate::common::program::{Place, demand, set};

/// Damages a PNG's pixels behind its header.
fn damage(file: &Path) {
    let mut bytes = fs::read(file).unwrap();
    let at = bytes.windows(4).position(|four| four == b"IDAT").unwrap();
    bytes[at + 6..at + 12].fill(0xff);
    fs::write(file, bytes).unwrap();
}

/// Trains a few steps.
fn train(place: &Place, data: &Path, out: &str) {
    let small = set("train.steps=2 train.rays=16 data.downscale=1");
    place.run(&format!("train --data {} --out {out} --preset smoke -q{small}", data.display()), 0);
}

/// Photographs whose pixels are damaged are named by what decodes them, and by nothing else.
#[test]
fn pixels_are_read_only_where_they_count() {
    let (folder, place) = (Folder::new(9), Place::new());
    folder.write();
    let data = folder.path().display();
    train(&place, folder.path(), "run");
    (1..9).for_each(|i| damage(&folder.path().join(format!("images/{i}.png"))));
    let check = format!("data check {data} --set data.downscale=1");
    place.says(&check, 0, &["7 (1, 2,", "2 (0, 8)", "16 x 12 pixels", "--pixels"]);
    let checked: Value = serde_json::from_str(&place.printed(&format!("{check} --json"))).unwrap();
    assert!(checked["data_hash"].is_null());
    let mesh = "mesh run --resolution 8 --cap --out mesh -q";
    draw_mesh(&place, mesh);
    let protocol = |file: &str| place.json(file)["protocol"]["data_hash"].clone();
    assert!(protocol("mesh/mesh.json").is_string());
    assert_eq!(protocol("mesh/mesh.json"), protocol("run/metrics.json"));
    for line in [
        "eval --smoothness run --lattice 8 -q",
        "render run --frames 1 --resolution 16x16 --out path -q",
        // One photograph is compared with, which is whole; the other is not.
        "compare run --view 0 --out compared -q",
    ] {
        place.run(line, 0);
    }
    for (line, photo) in [
        (&format!("{check} --pixels")[..], "images/1.png"),
        (&format!("train --data {data} --out never"), "images/1.png"),
        ("compare run --view 8 --out damaged -q", "images/8.png"),
        ("render run --what views --out views -q", "images/8.png"),
        ("eval run", ""),
    ] {
        place.says(line, 3, &[photo, "damaged"]);
    }
    // Without an evaluation nothing else knows the hash of all pixels.
    fs::remove_file(place.at("run/metrics.json")).unwrap();
    place.says(&format!("{mesh} --threshold 1"), 3, &["images/1.png", "damaged"]);
}

/// Loads a folder; returns the views' pictures, and what is said.
fn load(dir: &Path, photos: Photos) -> Result<(Vec<Arc<Image>>, String), String> {
    let (loaded, notes) = captures::load(dir, photos, |config| config.data.downscale = Some(1));
    let (_, scene) = loaded.map_err(|error| error.to_string())?;
    let views: Vec<_> = all(&scene).map(|view| view.read().unwrap()).collect();
    for view in &views {
        assert_eq!((view.image.width, view.image.height), (view.camera.width, view.camera.height));
        assert_eq!(view.image.pixels.len(), view.image.width * view.image.height * 3);
    }
    Ok((views.into_iter().map(|view| view.image).collect(), notes.join("\n")))
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
        copy(&fixture("captures3/colmap_only1"), dir.path());
        let [width, height] = write(dir.path(), size, 8, |i| format!("000{}.jpg", i + 1));
        let camera = format!("1 SIMPLE_PINHOLE {width} {height} 15 {} {}", width / 2, height / 2);
        fs::write(dir.path().join("sparse/1/cameras.txt"), camera).unwrap();
        dir
    };
    let llff = |size: [u64; 2]| {
        let dir = TempDir::new().unwrap();
        arc_of(dir.path(), 20.0, size.map(|side| side as f64));
        write(dir.path(), size, 12, |i| format!("{i:02}.jpg"));
        dir
    };
    let transforms = |[width, height]: [u64; 2]| {
        let folder = Folder::new(9).with("w", width.into()).with("h", height.into());
        write(folder.path(), [width, height], 9, |i| format!("{i}.jpg"));
        let folder = each(folder, |i, frame| frame["file_path"] = format!("images/{i}.jpg").into());
        folder.write();
        folder.into_dir()
    };
    for (what, make) in
        [("colmap", &colmap as &dyn Fn([u64; 2]) -> TempDir), ("llff", &llff), ("transforms", &transforms)]
    {
        for photos in [Photos::Read, Photos::Later] {
            for (size, said) in [([12, 16], "is applied"), ([16, 12], "is not applied")] {
                let (views, notes) = load(make(size).path(), photos).unwrap_or_else(|error| panic!("{what}: {error}"));
                for Image { width, height, pixels, .. } in views.iter().map(|view| &**view) {
                    assert_eq!([*width as u64, *height as u64], size, "{what}");
                    // Green grows to the right as it is stored, and downwards after a turn by 90 degrees.
                    let green = |x: usize, y: usize| pixels[(y * width + x) * 3 + 1] * 255.0;
                    let turned = size == [12, 16];
                    let [first, last] = [1, 14].map(|at| if turned { green(6, at) } else { green(at, 6) });
                    assert!(first < 25.0 && last > 125.0, "{what}: {first} {last}");
                }
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
    let (_, notes) = load(with_alpha(9, |_, _| 0).path(), Photos::Read).unwrap();
    assert_says(&notes, &["all 2 held-out views are of one and the same colour", "alpha channel"]);
    // Only as many are decoded as tell whether there is a background: the others may be damaged.
    let folder = with_alpha(9, |_, x| 16 * x as u8);
    (1..9).for_each(|i| damage(&folder.path().join(format!("images/{i}.png"))));
    let said = Place::new().printed(&format!("data check {} --set data.downscale=1", folder.path().display()));
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

/// A mesh of poses in a national grid: single precision has steps of 0.5 there, and the cameras are 4 from the middle.
#[test]
fn meshes_of_georeferenced_captures_keep_their_precision() {
    let place = Place::new();
    let drawn = |name: &str, shift: [f64; 3]| {
        let folder = Folder::new(9).moved(shift);
        folder.write();
        train(&place, folder.path(), name);
        let mesh = format!("mesh {name} --resolution 12 --cap --units capture --format ply,obj --out {name}_mesh");
        let said = draw_mesh(&place, &mesh);
        let report = place.json(&format!("{name}_mesh/mesh.json"));
        let offset: [f64; 3] = serde_json::from_value(report["offset"].clone()).unwrap();
        let vertex = |line: &str| -> Option<[f64; 3]> {
            let mut numbers = line.strip_prefix("v ")?.split(' ').map(|number| number.parse::<f64>().unwrap());
            Some(offset.map(|offset| offset + numbers.next().unwrap()))
        };
        let vertices: Vec<_> = place.text(&format!("{name}_mesh/mesh.obj")).lines().filter_map(vertex).collect();
        assert_eq!(vertices.len() as u64, report["vertices"].as_u64().unwrap());
        (report, vertices, said)
    };
    let (near, at_0, said) = drawn("near", [0.0; 3]);
    assert!(near["offset"] == serde_json::json!([0.0, 0.0, 0.0]) && !said.contains("offset"), "{said}");
    let shift = [441_547.0, 5_121_946.0, -30.0];
    let (far, there, said) = drawn("far", shift);
    assert_says(&said, &["less an offset of 441", ", 5121", "mesh.json"]);
    // One field in scene units, and so one mesh, but for the rounding of the poses' mean.
    assert_eq!(at_0.len(), there.len());
    for (a, b) in at_0.iter().zip(&there) {
        (0..3).for_each(|i| assert!((a[i] + shift[i] - b[i]).abs() < 1e-3, "{a:?} {b:?}"));
    }
    let area = |report: &Value| report["area"].as_f64().unwrap();
    assert!((area(&near) / area(&far) - 1.0).abs() < 1e-3 && near["closed"] == far["closed"]);
    // Both files are read back to where the mesh is.
    let read = |name: &str| sample(&read_mesh(&place.at(&format!("far_mesh/{name}"))).unwrap(), 500, 0).unwrap();
    assert!(chamfer(&read("mesh.ply"), &read("mesh.obj"), 0.1).unwrap().chamfer < 1e-6);
}

/// Within a limit of address space too little memory is told, not met.
#[cfg(target_os = "linux")]
#[test]
fn limits_of_memory_are_told() {
    let dir = TempDir::new().unwrap();
    let folder = Folder::new(9).with("fl_x", 5000.into());
    let photo = |i: usize| folder.path().join(format!("images/{i}.png"));
    // Only the header of a picture is real, which is all that may be looked at before its memory is taken.
    let header = |side: u32, colour: u8| {
        let chunk = [&b"IHDR"[..], &side.to_be_bytes(), &side.to_be_bytes(), &[8, colour, 0, 0, 0]].concat();
        let mut sum = flate2::Crc::new();
        sum.update(&chunk);
        let end = b"\0\0\0\0IDAT\x35\xaf\x06\x1e\0\0\0\0IEND\xae\x42\x60\x82";
        [&b"\x89PNG\r\n\x1a\n\0\0\0\x0d"[..], &chunk, &sum.sum().to_be_bytes(), end].concat()
    };
    (0..9).for_each(|i| fs::write(photo(i), header(4000, 2)).unwrap());
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
    (0..9).for_each(|i| photograph(i, 500, 500).save(photo(i)).unwrap());
    limited(&format!("data check {data} --pixels --set data.downscale=50"), 0, &["10 x 10 pixels"]);
    // Not even one can be decoded: it takes more than the limit.
    fs::write(photo(0), header(18_000, 0)).unwrap();
    let words = ["images/0.png takes up to", "MiB are free"];
    limited(&format!("data check {data} --pixels --set data.width=80"), 3, &words);
}
