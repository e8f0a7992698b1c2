//! Captures with a `transforms.json`, as instant-ngp and nerfstudio write it, or with one for each split.
//!
//! Read, for all frames or in a frame: `fl_x`, `fl_y`, `cx`, `cy`, `w`, `h`, `camera_angle_x`, `camera_angle_y`, `camera_model`,
//! `k1`, `k2`, `k3`, `p1`, `p2`, `mask_path`; each frame's `file_path` and `transform_matrix`; `train_filenames`,
//! `val_filenames` and `test_filenames`. What else stands there is ignored, and `data check` names it: `aabb_scale`, `scale` and `offset` say
//! how instant-ngp places the scene in its unit cube, `applied_transform` and `ply_file_path` tie the poses to a point cloud.
//!
//! A photograph's pixels are taken as they are stored. Where `w` and `h` are those of a photograph turned as its EXIF orientation
//! says, they are turned.

pub mod distortion;
pub(super) mod frames;
mod lens;
mod mask;
mod split;

use std::path::{Path, PathBuf};

pub use split::{Role, is_named};

use crate::base::{Error, Listener, Result};
use crate::data::formats::Capture;
use crate::data::images;
use crate::data::pose::Pose;
use crate::data::{Camera, Place, Scene, WorldToScene, background, name_of, path};
use crate::settings::{DataConfig, DataKind, EvalSplit, Split};
use frames::Frame;
use split::Listing;

/// The file that makes a folder such a scene.
pub const TRANSFORMS_FILE: &str = "transforms.json";

/// The file that a split's poses are in.
pub fn transforms_file(split: &str) -> String {
    format!("transforms_{split}.json")
}

/// Start and end of a ray where the configuration names none and the cameras look at no common point. After recentring,
/// cameras lie within [-1, 1]: the scene between and around them ends well before 6, and 0.05 clears the lens.
pub const BOUNDS: [f64; 2] = [0.05, 6.0];

/// Reads such a scene. Frames are sorted by file; the author's split is kept where there is one and `data.split` is not `every`,
/// otherwise every `config.holdout`-th is held out.
pub fn load(config: &DataConfig, events: &dyn Listener) -> Result<Scene> {
    let dir = Path::new(&config.dir);
    let Listing { frames: mut all, named, ignored } = split::read(dir, events)?;
    let by_author = match config.split {
        Some(Split::Every) => false,
        None => named,
        Some(Split::Own) if named => true,
        Some(Split::Own) => {
            return Err(Error::Data(format!(
                "{}: data.split = \"own\" is for captures that name a split, and this one has no train_filenames, val_filenames or \
                 test_filenames: leave data.split empty",
                config.dir
            )));
        }
    };
    if !by_author && config.eval_split == EvalSplit::Val && config.validation == 0 {
        return Err(Error::Config(format!(
            "data.eval_split = \"val\" is for scenes with a validation split, and {} names none: keep every N-th view for that with \
             data.validation",
            config.dir
        )));
    }
    all.sort_by(|a, b| a.0.path.cmp(&b.0.path));
    if !by_author {
        // Splits of their own files may share photographs.
        all.dedup_by(|a, b| a.0.path == b.0.path);
    }
    let (mut frames, roles): (Vec<Frame>, Vec<Option<Role>>) = all.into_iter().unzip();
    let world = match config.recentre {
        true => WorldToScene::centre(&mut frames.iter_mut().map(|frame| &mut frame.pose).collect::<Vec<&mut Pose>>()),
        false => WorldToScene::default(),
    };
    let targets = frames::working_sizes(&frames.iter().collect::<Vec<_>>(), config)?;
    let cameras: Vec<Camera> = frames.iter().zip(targets).map(|(frame, size)| frame.camera(size, by_ratio)).collect();
    let (views, clear) = frames::views(&frames, &cameras, background(config), "reading images", events)?;
    let poses: Vec<Pose> = cameras.iter().map(|c| c.pose).collect();
    let path = path::around(&poses);
    let first = cameras[0];
    let (mut place, (near, far)) = Place::of_cameras(&cameras, world, BOUNDS);
    notes(&mut place, &frames.iter().collect::<Vec<_>>(), &cameras, &ignored);
    let capture = Capture {
        views,
        near,
        far,
        ndc: None,
        background: clear.then(|| background(config)),
        path: path.into_iter().map(|pose| Camera { pose, ..first }).collect(),
        place,
    };
    let (name, kind) = (name_of(config), DataKind::Transforms.name());
    if !by_author {
        return Ok(capture.hold_out(name, kind, config));
    }
    let wanted = match config.eval_split {
        EvalSplit::Test => Role::Test,
        EvalSplit::Val => Role::Val,
    };
    if !roles.contains(&Some(wanted)) {
        return Err(split::without(wanted, &config.dir, &roles));
    }
    let of = |wanted: Role| -> Vec<&Frame> {
        frames.iter().zip(&roles).filter(|(_, role)| **role == Some(wanted)).map(|(frame, _)| frame).collect()
    };
    frames::note_shared(&of(Role::Train), &of(wanted), events);
    let placed = |wanted: Role| roles.iter().map(|role| *role == Some(wanted)).collect::<Vec<bool>>();
    Ok(capture.split_as(name, kind, config, &placed(Role::Train), &placed(wanted)))
}

/// Rounded so since the first runs, whose hashes of data hang on it.
fn by_ratio(value: f64, to: f64, from: f64) -> f64 {
    value * (to / from)
}

/// What was found and chosen, for people.
pub(super) fn notes(place: &mut Place, frames: &[&Frame], cameras: &[Camera], ignored: &[String]) {
    let paths: Vec<PathBuf> = frames.iter().map(|frame| frame.path.clone()).collect();
    let sizes = |camera: &Camera| (camera.width, camera.height);
    let mut words = images::folder_words(&paths, frames[0].size, sizes(&cameras[0]));
    if frames.iter().any(|frame| frame.size != frames[0].size) {
        words += " (the first; sizes differ)";
    }
    place.note("images", words);
    let zoom = frames.iter().map(|frame| frame.zoom()).fold(1.0, f64::max);
    let undone = frames.iter().filter(|frame| frame.is_bent()).count();
    let words =
        if undone == 0 { "none".into() } else { format!("undone in {undone} images, zoomed in by up to {zoom:.3}") };
    place.note("distortion", words);
    let masked = frames.iter().filter(|frame| frame.is_masked()).count();
    if masked > 0 {
        place.note("masks", format!("of {masked} images: black pixels are neither trained on nor measured"));
    }
    if !ignored.is_empty() {
        place.note("ignored keys", ignored.join(", "));
    }
}
