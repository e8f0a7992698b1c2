//! The built-in scene as files: a Blender-style folder with exact depth and a mesh.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::Path;

use image::{ExtendedColorType, ImageFormat};
use rayon::prelude::*;
use serde_json::json;

use super::mesh::Mesh;
use super::picture::Picture;
use super::stage::Stage;
use super::views::{ANGLE_X, Split, around};
use super::{MAX_WIDTH, blender_stage};
use crate::settings::PixelOrigin;
use crate::{Camera, npy};
use augnerf_base::files::AtomicDir;
use augnerf_base::{Error, Result};

/// Default width of exported images in pixels.
pub const DEFAULT_WIDTH: usize = 200;
/// Grey levels of the 16-bit depth images per scene unit: depth = level / 8192, 0 = nothing hit.
pub const DEPTH_LEVELS: f64 = 8192.0;

/// What [`export`] wrote.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Exported {
    /// Number of RGBA images in all splits.
    pub pictures: usize,
    /// Number of depth maps, each as PNG and as NPY.
    pub depths: usize,
    /// Number of vertices of `mesh.ply`.
    pub vertices: usize,
    /// Number of triangles of `mesh.ply`.
    pub triangles: usize,
}

/// Writes the built-in scene into the new or empty folder `dir`, which appears as a whole, with images of `width` pixels per side.
///
/// `transforms_{train,val,test}.json` and RGBA PNGs are as in NeRF-synthetic. A pixel's ray passes through its integer
/// coordinates (`data.pixel_origin = corner`). `depth/` has the z-depth of each test view: `r_0.npy` (32-bit floats
/// `[rows, columns]`, scene units, infinite for nothing) and `r_0.png` (16 bit, [`DEPTH_LEVELS`] per unit, 0 for
/// nothing). `mesh.ply` has the surfaces.
pub fn export(dir: &Path, width: usize, seed: Option<u64>) -> Result<Exported> {
    if !(4..=MAX_WIDTH).contains(&width) {
        return Err(Error::Config(format!(
            "the export's width = {width} is out of range: it must be 4 to {MAX_WIDTH}"
        )));
    }
    let folder = AtomicDir::vacant(dir)?;
    let exported = fill(folder.path(), width, seed)?;
    folder.commit()?;
    Ok(exported)
}

/// Fills a new folder.
fn fill(dir: &Path, width: usize, seed: Option<u64>) -> Result<Exported> {
    for sub in ["train", "val", "test", "depth"] {
        let sub = dir.join(sub);
        fs::create_dir(&sub).map_err(|e| Error::unwritable(&sub, &e))?;
    }
    let stage = blender_stage(seed);
    let mut pictures = 0;
    for split in [Split::Train, Split::Val, Split::Test] {
        pictures += export_split(dir, &stage, split, width)?;
    }
    let depths = around(Split::Test, width).len();
    write(&dir.join("depth").join("depth.json"), depth_notes().as_bytes())?;
    let mesh = Mesh::of(&stage);
    let mut ply = Vec::new();
    mesh.write_ply(&mut ply).expect("writing into memory does not fail");
    write(&dir.join("mesh.ply"), &ply)?;
    Ok(Exported { pictures, depths, vertices: mesh.vertices.len(), triangles: mesh.triangles.len() })
}

/// Writes images, depths and the JSON file of one split, and returns the number of images.
fn export_split(dir: &Path, stage: &Stage, split: Split, width: usize) -> Result<usize> {
    let cameras = around(split, width);
    cameras.par_iter().try_for_each(|(name, camera)| {
        let picture = stage.render(camera, PixelOrigin::Corner);
        write_rgba(&dir.join(split.name()).join(format!("{name}.png")), &picture)?;
        if split == Split::Test { write_depth(&dir.join("depth"), name, &picture) } else { Ok(()) }
    })?;
    let path = dir.join(format!("transforms_{}.json", split.name()));
    write(&path, transforms(split, &cameras).as_bytes())?;
    Ok(cameras.len())
}

/// Returns the JSON of a split, as in NeRF-synthetic.
fn transforms(split: Split, cameras: &[(String, Camera)]) -> String {
    let frame = |(name, camera): &(String, Camera)| {
        let [x, y, z] = camera.pose;
        json!({
            "file_path": format!("./{}/{name}", split.name()),
            "transform_matrix": [x, y, z, [0.0, 0.0, 0.0, 1.0]],
        })
    };
    let frames: Vec<_> = cameras.iter().map(frame).collect();
    let whole = json!({ "camera_angle_x": ANGLE_X, "frames": frames });
    format!("{whole:#}\n")
}

fn depth_notes() -> String {
    let notes = json!({
        "quantity": "distance along the camera's viewing axis to the first surface, in scene units",
        "npy": "32-bit floats [rows, columns]; inf = nothing hit",
        "png": "16-bit grey; depth = level / png_levels_per_unit; 0 = nothing hit",
        "png_levels_per_unit": DEPTH_LEVELS,
        "pixel_origin": "corner",
    });
    format!("{notes:#}\n")
}

fn write_rgba(path: &Path, picture: &Picture) -> Result<()> {
    let image = &picture.image;
    let bytes: Vec<u8> = image.pixels.iter().map(|v| (255.0 * v).round() as u8).collect();
    write_png(path, &bytes, [image.width, image.height], ExtendedColorType::Rgba8)
}

fn write_depth(dir: &Path, name: &str, picture: &Picture) -> Result<()> {
    let size = [picture.image.width, picture.image.height];
    let level = |depth: f32| if depth.is_finite() { (DEPTH_LEVELS * f64::from(depth)).round() as u16 } else { 0 };
    let levels: Vec<u8> = picture.depth.iter().flat_map(|&depth| level(depth).to_ne_bytes()).collect();
    write_png(&dir.join(format!("{name}.png")), &levels, size, ExtendedColorType::L16)?;
    write(&dir.join(format!("{name}.npy")), &npy_file(&picture.depth, size))
}

/// Returns a 32-bit float array `[height, width]` in NumPy's format.
fn npy_file(values: &[f32], [width, height]: [usize; 2]) -> Vec<u8> {
    let mut bytes = npy::header("<f4", &[height, width]);
    bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    bytes
}

fn write_png(path: &Path, bytes: &[u8], [width, height]: [usize; 2], colour: ExtendedColorType) -> Result<()> {
    image::save_buffer_with_format(path, bytes, width as u32, height as u32, colour, ImageFormat::Png)
        .map_err(|e| Error::Output(format!("cannot write {}: {e}", path.display())))
}

fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    let create = || -> std::io::Result<()> {
        let mut out = BufWriter::new(File::create(path)?);
        out.write_all(bytes)?;
        out.flush()
    };
    create().map_err(|e| Error::unwritable(path, &e))
}
