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
use super::views::{ANGLE_X, around};
use super::{MAX_WIDTH, blender_stage};
use crate::formats::transforms::{Role, transforms_file};
use crate::settings::PixelOrigin;
use crate::{Camera, npy};
use augnerf_base::files::AtomicDir;
use augnerf_base::{Error, Image, Result};

/// Default width of exported images in pixels.
pub const DEFAULT_WIDTH: usize = 200;

/// What [`export`] wrote.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Exported {
    /// Number of RGBA images in all splits.
    pub pictures: usize,
    /// Number of depth maps.
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
/// `[rows, columns]`, scene units, infinite for nothing). `mesh.ply` has the surfaces.
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
    for split in Role::ALL {
        pictures += export_split(dir, &stage, split, width)?;
    }
    let depths = around(Role::Test, width).len();
    write(&dir.join("depth").join("depth.json"), depth_notes().as_bytes())?;
    let mesh = Mesh::of(&stage);
    let mut ply = Vec::new();
    mesh.write_ply(&mut ply).expect("writing into memory does not fail");
    write(&dir.join("mesh.ply"), &ply)?;
    Ok(Exported { pictures, depths, vertices: mesh.vertices.len(), triangles: mesh.triangles.len() })
}

/// Writes images, depths and the JSON file of one split, and returns the number of images.
fn export_split(dir: &Path, stage: &Stage, split: Role, width: usize) -> Result<usize> {
    let cameras = around(split, width);
    cameras.par_iter().try_for_each(|(name, camera)| {
        let picture = stage.render(camera, PixelOrigin::Corner);
        write_rgba(&dir.join(split.name()).join(format!("{name}.png")), &picture.image)?;
        let depth = dir.join("depth").join(format!("{name}.npy"));
        if split == Role::Test { write_depth(&depth, &picture) } else { Ok(()) }
    })?;
    let path = dir.join(transforms_file(split.name()));
    write(&path, transforms(split, &cameras).as_bytes())?;
    Ok(cameras.len())
}

/// Returns the JSON of a split, as in NeRF-synthetic.
fn transforms(split: Role, cameras: &[(String, Camera)]) -> String {
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
        "pixel_origin": "corner",
    });
    format!("{notes:#}\n")
}

fn write_rgba(path: &Path, Image { width, height, pixels, .. }: &Image) -> Result<()> {
    let bytes: Vec<u8> = pixels.iter().map(|v| (255.0 * v).round() as u8).collect();
    let (width, height) = (*width as u32, *height as u32);
    image::save_buffer_with_format(path, &bytes, width, height, ExtendedColorType::Rgba8, ImageFormat::Png)
        .map_err(|e| Error::Output(format!("cannot write {}: {e}", path.display())))
}

/// Writes 32-bit floats `[height, width]` in NumPy's format.
fn write_depth(path: &Path, Picture { image, depth }: &Picture) -> Result<()> {
    let mut bytes = npy::header("<f4", &[image.height, image.width]);
    bytes.extend(depth.iter().flat_map(|v| v.to_le_bytes()));
    write(path, &bytes)
}

fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    let create = || -> std::io::Result<()> {
        let mut out = BufWriter::new(File::create(path)?);
        out.write_all(bytes)?;
        out.flush()
    };
    create().map_err(|e| Error::unwritable(path, &e))
}
