//! Your own data format: a loader that builds a scene, and a training on it.
//!
//!     cargo run --release --example own_format
//!
//! The format is an invention. A folder has `cameras.txt`, with a line for each view: its image (binary PPM), the focal length in
//! pixels, and twelve numbers, the rows of the pose. The columns of a pose are the camera's right, up and backward axes and its
//! position.

use std::fs;
use std::path::Path;

use augnerf::base::{Error, Image, Result};
use augnerf::candle_core::DType;
use augnerf::data::{Camera, Capture, Scene, SceneSpace, View};
use augnerf::metrics::{PSNR, measure};
use augnerf::run::{Viewer, load_scene};
use augnerf::runtime::Runtime;
use augnerf::settings::{DataKind, Preset, build, parse_assignment};
use augnerf::train::Trainer;

/// Loads a scene. Every eighth view is held out, and rays run from `near` to `far` in the units of the poses.
fn load(dir: &Path, near: f64, far: f64) -> Result<Scene> {
    let list = dir.join("cameras.txt");
    let text = fs::read_to_string(&list).map_err(|error| Error::unreadable(&list, &error))?;
    let mut views = Vec::new();
    for line in text.lines() {
        let broken = || Error::Data(format!("{}: not an image and 13 numbers: {line}", list.display()));
        let (file, numbers) = line.split_once(' ').ok_or_else(broken)?;
        let numbers: Option<Vec<f64>> = numbers.split(' ').map(|number| number.parse().ok()).collect();
        let numbers: [f64; 13] = numbers.and_then(|numbers| numbers.try_into().ok()).ok_or_else(broken)?;
        let image = read_ppm(&dir.join(file))?;
        let camera = Camera {
            width: image.width,
            height: image.height,
            focal: [numbers[0]; 2],
            centre: [image.width as f64 / 2.0, image.height as f64 / 2.0],
            pose: std::array::from_fn(|row| std::array::from_fn(|column| numbers[1 + 4 * row + column])),
        };
        views.push(View::new(file.trim_end_matches(".ppm"), camera, image));
    }
    // Scene units are those of the files, and the region of the objects is unknown.
    let space = SceneSpace::default();
    let capture = Capture { views, path: Vec::new(), near, far, ndc: None, background: Some([1.0; 3]), space };
    let split = build(None, None, &[parse_assignment("data.holdout=8")?])?;
    Ok(capture.hold_out("mine".into(), "ppm-list", &split.data))
}

/// Reads a binary PPM without comments: `P6 WIDTH HEIGHT 255`, then three bytes per pixel.
fn read_ppm(path: &Path) -> Result<Image> {
    let bytes = fs::read(path).map_err(|error| Error::unreadable(path, &error))?;
    let broken = || Error::Data(format!("{}: not a binary PPM with 8 bits", path.display()));
    let mut rest = bytes.as_slice();
    let mut word = || {
        let end = rest.iter().position(u8::is_ascii_whitespace)?;
        let (word, after) = rest.split_at(end);
        rest = &after[1..];
        std::str::from_utf8(word).ok()
    };
    let header = [word(), word(), word(), word()];
    let [Some("P6"), Some(width), Some(height), Some("255")] = header else { return Err(broken()) };
    let (Ok(width), Ok(height)) = (width.parse::<usize>(), height.parse::<usize>()) else { return Err(broken()) };
    if rest.len() != 3 * width * height {
        return Err(broken());
    }
    let pixels = rest.iter().map(|&byte| f32::from(byte) / 255.0).collect();
    Ok(Image { width, height, channels: 3, pixels })
}

fn main() -> Result<()> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    write_something(folder.path())?;
    let scene = load(folder.path(), 2.0, 6.0)?;
    println!("{} training views, {} held out", scene.train.len(), scene.test.len());

    let runtime = Runtime::new("cpu", None)?;
    let settings = ["field.width=32", "train.rays=128", "train.decay_steps=150"];
    let settings = settings.iter().map(|text| parse_assignment(text)).collect::<Result<Vec<_>>>()?;
    // The kind only chooses defaults: here those of 360-degree scenes, without normalized device coordinates.
    let config = build(Some(Preset::Smoke), None, &settings)?.resolve(DataKind::Transforms, scene.extent())?;
    let mut trainer = Trainer::new(&config, &scene, DType::F32, &runtime)?;
    for _ in 0..150 {
        trainer.step(false)?;
    }

    let viewer = Viewer { model: trainer.model()?, config: &config, scene: &scene, runtime: &runtime };
    let held_out = &scene.test[0];
    let rendered = viewer.render(&held_out.camera)?;
    let psnr = measure(&held_out.name, &rendered.image, &held_out.image, &[])?.get(&PSNR).unwrap_or(f64::NAN);
    println!("{}: PSNR {psnr:.2} dB", held_out.name);
    assert!(psnr > 10.0, "the training failed");
    Ok(())
}

/// Writes the built-in scene's training views in the invented format.
fn write_something(dir: &Path) -> Result<()> {
    let config = build(Some(Preset::Smoke), None, &[parse_assignment("data.width=32")?])?;
    let (_, scene) = load_scene(config, &())?;
    let mut list = String::new();
    for (index, view) in scene.train.iter().enumerate() {
        let Camera { width, height, focal, pose, .. } = view.camera;
        let file = format!("view{index:03}.ppm");
        let pose: Vec<String> = pose.iter().flatten().map(f64::to_string).collect();
        list += &format!("{file} {} {}\n", focal[0], pose.join(" "));
        let mut bytes = format!("P6\n{width} {height}\n255\n").into_bytes();
        bytes.extend(view.image.pixels.iter().map(|value| (value * 255.0).round() as u8));
        let path = dir.join(file);
        fs::write(&path, bytes).map_err(|error| Error::unwritable(&path, &error))?;
    }
    let path = dir.join("cameras.txt");
    fs::write(&path, list).map_err(|error| Error::unwritable(&path, &error))
}
