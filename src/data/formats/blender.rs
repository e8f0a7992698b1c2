//! Blender scenes (NeRF's synthetic ones): `transforms_{train,val,test}.json` with RGBA images, and the depth maps of
//! evaluation views where there are any.

use std::f64::consts::PI;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use crate::base::{Error, Listener, Result};
use crate::data::images::{self, Size};
use crate::data::json::{self, Object};
use crate::data::pose::{self, Pose};
use crate::data::{Camera, Place, Scene, View, background, depth, name_of, path};
use crate::settings::{DataConfig, DataKind, EvalSplit};

/// Start and end of a ray, as for all of NeRF's synthetic scenes.
const BOUNDS: [f64; 2] = [2.0, 6.0];
/// Poses of the video path.
const ORBIT_POSES: usize = 40;
/// Its elevation in degrees and its radius, as nerf-pytorch's.
const ORBIT: (f64, f64) = (-30.0, 4.0);
/// Cameras and what they look at lie on its sphere and in its centre but for this share of the radius.
const OFF_SPHERE: f64 = 0.15;

/// The file that a split's poses are in.
pub fn transforms_file(split: &str) -> String {
    format!("transforms_{split}.json")
}

/// Reads a Blender scene. The evaluation views are those of `config.eval_split`.
pub fn load(config: &DataConfig, events: &dyn Listener) -> Result<Scene> {
    let eval = match config.eval_split {
        EvalSplit::Test => "test",
        EvalSplit::Val => "val",
    };
    let mut train = Split::read(config, "train")?;
    let mut test = Split::read(config, eval)?;
    test.keep_every(config.test_skip);
    let size = images::common_size(&train.paths)?;
    let both = [train.paths[0].clone(), test.paths[0].clone()];
    images::common_size(&both)?;
    images::common_size(&test.paths)?;
    let target = Size::of(config).apply(size, &train.paths[0])?;
    let camera = train.camera(size, target);
    let eval_label = format!("reading {eval} images");
    Ok(Scene {
        name: name_of(config),
        kind: DataKind::Blender.name(),
        path: path_for(&train.poses).into_iter().map(|pose| Camera { pose, ..camera }).collect(),
        corrupted: None,
        place: Place::default(),
        train: train.views(config, camera, "reading train images", events)?,
        test: {
            let camera = test.camera(size, target);
            let mut views = test.views(config, camera, &eval_label, events)?;
            read_depths(&mut views, &test.paths)?;
            views
        },
        near: BOUNDS[0],
        far: BOUNDS[1],
        ndc: None,
        background: Some(background(config)),
    })
}

/// nerf-pytorch's video path: a full turn of 40 poses, 30 degrees up at distance 4, z is up.
pub fn orbit() -> Vec<Pose> {
    let (elevation, radius) = ORBIT;
    let at = |i: usize| sphere_pose(-180.0 + 360.0 * i as f64 / ORBIT_POSES as f64, elevation, radius);
    (0..ORBIT_POSES).map(at).collect()
}

/// nerf-pytorch's path where the cameras stand on its sphere, as those of NeRF's synthetic scenes do; elsewhere one for them.
fn path_for(poses: &[Pose]) -> Vec<Pose> {
    let radius = ORBIT.1;
    let on_sphere = |p: &Pose| (pose::length(pose::column(p, 3)) / radius - 1.0).abs() < OFF_SPHERE;
    let at_origin = path::centre(poses).is_some_and(|centre| pose::length(centre) < OFF_SPHERE * radius);
    if at_origin && poses.iter().all(on_sphere) { orbit() } else { path::around(poses) }
}

/// The pose at `azimuth` and `elevation` (degrees; negative is above) that looks at the origin from `radius`.
pub fn sphere_pose(azimuth: f64, elevation: f64, radius: f64) -> Pose {
    let (sin_a, cos_a) = (azimuth / 180.0 * PI).sin_cos();
    let (sin_e, cos_e) = (elevation / 180.0 * PI).sin_cos();
    // A camera at (0, 0, radius), turned about x by the elevation and about y by the azimuth, then
    // brought from y-up to z-up with x mirrored: (x, y, z) -> (-x, z, y).
    let back = [-sin_a * cos_e, -sin_e, cos_a * cos_e];
    let up = [-sin_a * sin_e, cos_e, cos_a * sin_e];
    let right = [cos_a, 0.0, sin_a];
    let origin = back.map(|v| v * radius);
    let turned = |axis: usize| [right[axis], up[axis], back[axis], origin[axis]];
    [turned(0).map(|v| -v), turned(2), turned(1)]
}

/// One `transforms_*.json`.
struct Split {
    angle: f64,
    paths: Vec<PathBuf>,
    poses: Vec<Pose>,
}

impl Split {
    fn read(config: &DataConfig, name: &str) -> Result<Split> {
        let dir = Path::new(&config.dir);
        let file = dir.join(transforms_file(name));
        if !file.exists() {
            return Err(missing(dir, &file, name));
        }
        let value = json::read(&file)?;
        let document = Object::document(&file, &value)?;
        document.required("camera_angle_x")?;
        for key in ["k1", "k2", "k3", "p1", "p2"] {
            if let Some(value) = document.number(key)?.filter(|value| *value != 0.0) {
                return Err(document.error(&format!(
                    "\"{key}\" is {value}, but Blender scenes are read without distortion; merge the splits into one \
                     transforms.json, for which it is undone"
                )));
            }
        }
        let angle = document.angle("camera_angle_x")?.unwrap_or_default();
        let mut split = Split { angle, paths: Vec::new(), poses: Vec::new() };
        for frame in document.frames()? {
            split.paths.push(frame.image()?);
            split.poses.push(frame.pose()?);
        }
        Ok(split)
    }

    fn keep_every(&mut self, step: usize) {
        self.paths = self.paths.iter().step_by(step.max(1)).cloned().collect();
        self.poses = self.poses.iter().step_by(step.max(1)).copied().collect();
    }

    /// Intrinsics at `target` of images stored at `size`: one focal length for square pixels, unless
    /// rounding the size down bent them.
    fn camera(&self, size: (usize, usize), target: (usize, usize)) -> Camera {
        let focal = 0.5 * size.0 as f64 / (0.5 * self.angle).tan();
        let (width, height) = target;
        let scale = |to: usize, from: usize| focal * to as f64 / from as f64;
        Camera {
            width,
            height,
            focal: [scale(width, size.0), scale(height, size.1)],
            centre: [width as f64 / 2.0, height as f64 / 2.0],
            pose: [[0.0; 4]; 3],
        }
    }

    fn views(&mut self, config: &DataConfig, camera: Camera, label: &str, events: &dyn Listener) -> Result<Vec<View>> {
        let target = (camera.width, camera.height);
        let (images, _) = images::read_all(&self.paths, target, background(config), label, events)?;
        let cameras = self.poses.iter().map(|&pose| Camera { pose, ..camera });
        let named = images::names(&self.paths).into_iter().zip(cameras).zip(images);
        Ok(named.map(|((name, camera), image)| View { name, camera, image: image.into(), depth: None }).collect())
    }
}

/// Fills in the depth of the views whose images have a depth map beside them.
fn read_depths(views: &mut [View], paths: &[PathBuf]) -> Result<()> {
    views.par_iter_mut().zip(paths).try_for_each(|(view, path)| {
        if let Some(map) = depth::file_of(path) {
            view.depth = depth::read(&map, &view.camera, BOUNDS)?;
        }
        Ok(())
    })
}

fn missing(dir: &Path, file: &Path, split: &str) -> Error {
    let other = match split {
        "test" => "val",
        "val" => "test",
        _ => return Error::Data(format!("{} is missing: a Blender scene's training poses are in it", file.display())),
    };
    let advice = if dir.join(transforms_file(other)).exists() {
        format!("{} is there: set data.eval_split={other}", transforms_file(other))
    } else {
        "the scene has no views to evaluate on".into()
    };
    Error::Data(format!("{} is missing; {advice}", file.display()))
}
