//! Captures with one `transforms.json`, as instant-ngp and nerfstudio write it.
//!
//! Read: `fl_x`, `fl_y`, `cx`, `cy`, `w`, `h`, `camera_angle_x`, `camera_angle_y`, `camera_model`,
//! `k1`, `k2`, `k3`, `p1`, `p2` (for all frames or in a frame) and each frame's `file_path` and
//! `transform_matrix`.
//!
//! Not read: `aabb_scale`, `scale` and `offset` say how instant-ngp places the scene in its unit
//! cube, which this program does not have; `applied_transform` and `ply_file_path` tie the poses to
//! a point cloud, which is not used; `train_filenames` and its like, because every program's runs
//! here hold out every N-th view alike.

pub mod distortion;
mod lens;

use std::path::{Path, PathBuf};

use crate::base::{Image, Listener, Result};
use crate::data::formats::Capture;
use crate::data::images::{self, Size};
use crate::data::json::{self, Object};
use crate::data::pose::Pose;
use crate::data::{Camera, Place, Scene, WorldToScene, background, name_of, path, resample};
use crate::settings::{DataConfig, DataKind};
use distortion::Intrinsics;
use lens::Lens;

/// The file that makes a folder such a scene.
pub const TRANSFORMS_FILE: &str = "transforms.json";

/// Start and end of a ray where the configuration names none and the cameras look at no common point. After recentring,
/// cameras lie within [-1, 1]: the scene between and around them ends well before 6, and 0.05 clears the lens.
pub const BOUNDS: [f64; 2] = [0.05, 6.0];

/// A photograph before it is read.
struct Frame {
    path: PathBuf,
    pose: Pose,
    lens: Lens,
    /// The camera without distortion, at the stored size.
    pinhole: Intrinsics,
}

/// Reads such a scene. Frames are sorted by file; every `config.holdout`-th is held out.
pub fn load(config: &DataConfig, events: &dyn Listener) -> Result<Scene> {
    let file = Path::new(&config.dir).join(TRANSFORMS_FILE);
    let (mut frames, stored) = read_frames(&file)?;
    let world = match config.recentre {
        true => WorldToScene::centre(&mut frames.iter_mut().map(|frame| &mut frame.pose).collect::<Vec<&mut Pose>>()),
        false => WorldToScene::default(),
    };
    let paths: Vec<PathBuf> = frames.iter().map(|f| f.path.clone()).collect();
    let target = Size::of(config).apply(stored, &paths[0])?;
    let cameras: Vec<Camera> = frames.iter().map(|f| f.camera(stored, target)).collect();
    let (images, clear) = read_images(&frames, stored, target, background(config), events)?;
    let poses: Vec<Pose> = cameras.iter().map(|c| c.pose).collect();
    let path = path::around(&poses);
    let first = cameras[0];
    let (mut place, (near, far)) = Place::of_cameras(&cameras, world, BOUNDS);
    notes(&mut place, &paths, stored, target, &frames);
    let capture = Capture {
        views: Capture::views(images::names(&paths), cameras, images),
        near,
        far,
        ndc: None,
        background: clear.then(|| background(config)),
        path: path.into_iter().map(|pose| Camera { pose, ..first }).collect(),
        place,
    };
    Ok(capture.hold_out(name_of(config), DataKind::Transforms.name(), config))
}

/// All frames, sorted by file, and the size of their images.
fn read_frames(file: &Path) -> Result<(Vec<Frame>, (usize, usize))> {
    let value = json::read(file)?;
    let document = Object::document(file, &value)?;
    let mut listed = Vec::new();
    for object in document.frames()? {
        listed.push((object.image()?, object.pose()?, object));
    }
    listed.sort_by(|a, b| a.0.cmp(&b.0));
    let paths: Vec<PathBuf> = listed.iter().map(|(path, ..)| path.clone()).collect();
    let stored = images::common_size(&paths)?;
    let frame = |(path, pose, object): (PathBuf, Pose, Object)| {
        let lens = Lens::read(object, document, stored)?;
        let Some(pinhole) = distortion::pinhole(lens.intrinsics, &lens.distortion, stored) else {
            return Err(object.error(&format!(
                "the lens distortion (k1, k2, k3 = {:?}, p1, p2 = {:?}) cannot be undone over the whole image: \
                 its coefficients are too large",
                lens.distortion.radial, lens.distortion.tangential
            )));
        };
        Ok(Frame { path, pose, lens, pinhole })
    };
    Ok((listed.into_iter().map(frame).collect::<Result<_>>()?, stored))
}

impl Frame {
    /// The pinhole camera at the working resolution.
    fn camera(&self, stored: (usize, usize), target: (usize, usize)) -> Camera {
        let scale = [target.0 as f64 / stored.0 as f64, target.1 as f64 / stored.1 as f64];
        let scaled = |values: [f64; 2]| [values[0] * scale[0], values[1] * scale[1]];
        Camera {
            width: target.0,
            height: target.1,
            focal: scaled(self.pinhole.focal),
            centre: scaled(self.pinhole.centre),
            pose: self.pose,
        }
    }
}

/// What was found and chosen, for people.
fn notes(place: &mut Place, paths: &[PathBuf], stored: (usize, usize), target: (usize, usize), frames: &[Frame]) {
    place.note("images", images::folder_words(paths, stored, target));
    let zoom = frames.iter().map(|frame| frame.pinhole.focal[0] / frame.lens.intrinsics.focal[0]).fold(1.0, f64::max);
    let undone = frames.iter().filter(|frame| !frame.lens.distortion.is_none()).count();
    let words =
        if undone == 0 { "none".into() } else { format!("undone in {undone} images, zoomed in by up to {zoom:.3}") };
    place.note("distortion", words);
}

/// Decodes all frames, undoes their distortion at the stored size, then averages them down.
fn read_images(
    frames: &[Frame],
    stored: (usize, usize),
    target: (usize, usize),
    background: [f32; 3],
    events: &dyn Listener,
) -> Result<(Vec<Image>, bool)> {
    images::check_memory(frames.len(), target)?;
    let paths: Vec<PathBuf> = frames.iter().map(|f| f.path.clone()).collect();
    let read = |i: usize, path: &Path| {
        let Lens { intrinsics, distortion } = frames[i].lens;
        let image = if distortion.is_none() {
            images::read(path, target)?
        } else {
            let flat = distortion::rectify(&images::read(path, stored)?, intrinsics, &distortion, frames[i].pinhole);
            resample::shrink(&flat, target.0, target.1)
        };
        Ok(resample::composite(image, background))
    };
    let (images, clear): (Vec<Image>, Vec<bool>) =
        images::each(&paths, "reading images", events, read)?.into_iter().unzip();
    Ok((images, clear.contains(&true)))
}
