//! Captures with a `transforms.json`, as instant-ngp and nerfstudio write it, or with one per split.
//!
//! These keys are read, for all frames or per frame: `fl_x`, `fl_y`, `cx`, `cy`, `w`, `h`, `camera_angle_x`,
//! `camera_angle_y`, `camera_model`, `k1`, `k2`, `k3`, `p1`, `p2`, `mask_path`. Each frame has `file_path` and
//! `transform_matrix`. The document may have `train_filenames`, `val_filenames` and `test_filenames`, or frames of a split of
//! their own (`test_frames`). Other keys are ignored, and `data check` names them. `aabb_scale`, `scale` and `offset` place the scene in instant-ngp's unit cube;
//! `applied_transform` and `ply_file_path` relate the poses to a point cloud.
//!
//! A photo's pixels are turned by its EXIF orientation only if `w` and `h` are those of the turned photo.

pub mod distortion;
pub(super) mod frames;
mod lens;
mod split;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

pub(super) use lens::is_scaled;
pub(crate) use lens::{Keys, check_model, focal};
pub use split::{Role, is_named};

use crate::formats::Capture;
use crate::found;
use crate::frame::{self, Frame, Reading};
use crate::mask;
use crate::pose::Pose;
use crate::settings::{DataConfig, DataKind, EvalSplit, Split, scene_name};
use crate::{Camera, Photos, Scene, SceneSpace, WorldToScene, background, path};
use augnerf_base::{Error, Event, Listener, Result};
use frames::Listed;
use split::{Listing, Roles, Uses};

/// The file that identifies such a scene folder.
pub const TRANSFORMS_FILE: &str = "transforms.json";

/// Returns the file with a split's poses.
pub fn transforms_file(split: &str) -> String {
    format!("transforms_{split}.json")
}

/// Default start and end of a ray if the cameras look at no common point. After recentring, cameras are within [-1, 1].
/// The scene between and around them ends well before 6, and 0.05 clears the lens.
pub const BOUNDS: [f64; 2] = [0.05, 6.0];

/// Reads such a scene, with frames sorted by file. The author's split is kept if there is one and `data.split` is not
/// `every`. Otherwise every `config.holdout`-th view is held out. The scene's space and the views' roles depend on all
/// listed photos, including missing ones.
pub fn load(config: &DataConfig, photos: Photos, events: &dyn Listener) -> Result<Scene> {
    let Listing { frames: all, named, ignored, aside } = split::read(config, events)?;
    let by_author = by_author(config, named)?;
    let (mut listed, roles): (Vec<Listed>, Vec<Uses>) = ordered(all, by_author, config)?.into_iter().unzip();
    let world = match config.recentre {
        true => WorldToScene::centre(&mut listed.iter_mut().map(|listed| &mut listed.pose).collect::<Vec<&mut Pose>>()),
        false => WorldToScene::default(),
    };
    let path = path::around(&listed.iter().map(|listed| listed.pose).collect::<Vec<Pose>>());
    let there: Vec<bool> = listed.iter().map(|listed| listed.frame.is_some()).collect();
    let (mut frames, names) = frames::found(listed);
    mask::find(frames.iter_mut(), config, events)?;
    let used = frames.iter().map(|frame| &frame.path).chain(&aside);
    found::note_unused(Path::new(&config.dir), used, "have no pose in transforms.json", events);
    let targets = frames::working_sizes(&frames.iter().collect::<Vec<_>>(), config)?;
    let cameras: Vec<Camera> = frames.iter().zip(targets).map(|(frame, size)| frame.camera(size, by_ratio)).collect();
    let (scene, background) = (Path::new(&config.dir), background(config));
    let how = Reading { scene, background: (background, false), photos, what: "photos", events };
    let (views, clear) = frame::views(&frames, &names, &cameras, how)?;
    let first = cameras[0];
    let (mut space, (near, far)) = SceneSpace::of_cameras(&cameras, world, BOUNDS);
    notes(&mut space, &frames.iter().collect::<Vec<_>>(), &cameras, &ignored);
    let capture = Capture {
        views,
        near,
        far,
        ndc: None,
        background: clear.then_some(background),
        path: path.into_iter().map(|pose| Camera { pose, ..first }).collect(),
        space,
    };
    let (name, kind) = (scene_name(config), DataKind::Transforms.name());
    if !by_author {
        return Ok(capture.hold_out_listed(name, kind, config, &there));
    }
    let wanted = Role::evaluated(config);
    let of = |wanted: Role| roles.iter().map(|uses| uses[wanted as usize]).collect::<Vec<bool>>();
    if !of(wanted).contains(&true) {
        return Err(split::without(wanted, &config.dir, &roles));
    }
    let (train, evaluated) = (of(Role::Train), of(wanted));
    let found = |chosen: &[bool]| -> Vec<&Frame> {
        let chosen = chosen.iter().zip(&there).filter(|(_, there)| **there);
        frames.iter().zip(chosen).filter(|(_, (chosen, _))| **chosen).map(|(frame, _)| frame).collect()
    };
    let advice = " (data.split=every holds out others)";
    frames::note_shared(&config.dir, &found(&train), &found(&evaluated), advice, events);
    note_both_held_out(config, &of(Role::Val), &of(Role::Test), events);
    Ok(capture.split_as(name, kind, config, &there, [&train, &evaluated]))
}

/// Notes views that are in the validation split and in the test split.
fn note_both_held_out(config: &DataConfig, val: &[bool], test: &[bool], events: &dyn Listener) {
    let count = |views: &mut dyn Iterator<Item = bool>| views.filter(|is| *is).count();
    let both = count(&mut val.iter().zip(test).map(|(val, test)| *val && *test));
    if both > 0 {
        events.on(Event::Note(&format!(
            "{}: {both} of {} test views are validation views, too: what is chosen with data.eval_split=val is chosen on them",
            config.dir,
            count(&mut test.iter().copied())
        )));
    }
}

/// Returns whether the author's split is kept. `named` says whether there is one.
fn by_author(config: &DataConfig, named: bool) -> Result<bool> {
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
    if by_author && config.validation > 0 {
        return Err(Error::Config(format!(
            "data.validation = {} has no effect on {}, which names its own split: evaluate its validation views with \
             data.eval_split=val, or choose views anew with data.split=every",
            config.validation, config.dir
        )));
    }
    Ok(by_author)
}

/// Returns frames sorted by file, each photo once. Files of splits may share photos; their poses may differ only if the
/// author's split is kept.
fn ordered(mut all: Roles, by_author: bool, config: &DataConfig) -> Result<Roles> {
    all.sort_by_cached_key(|(listed, _)| (listed.order(), listed.place.clone()));
    let mut places: HashMap<PathBuf, usize> = HashMap::new();
    let mut kept: Roles = Vec::with_capacity(all.len());
    for (listed, uses) in all {
        let place = found::real(&listed.place);
        match places.get(&place).map(|&i| &mut kept[i]) {
            Some((other, of_other)) if other.pose == listed.pose => {
                of_other.iter_mut().zip(uses).for_each(|(all, is)| *all |= is);
            }
            Some(_) if !by_author => {
                return Err(Error::Data(format!(
                    "{}: the splits list the photo {} twice, with two poses: remove the wrong one",
                    config.dir,
                    listed.place.display()
                )));
            }
            _ => {
                places.insert(place, kept.len());
                kept.push((listed, uses));
            }
        }
    }
    Ok(kept)
}

/// Rounded as since the first runs, because hashes of data depend on it.
pub(super) fn by_ratio(value: f64, to: f64, from: f64) -> f64 {
    value * (to / from)
}

/// Notes what was found and chosen, for people.
pub(super) fn notes(space: &mut SceneSpace, frames: &[&Frame], cameras: &[Camera], ignored: &[String]) {
    frame::note_images(space, frames, (cameras[0].width, cameras[0].height));
    frame::note_distortion(space, frames);
    let masked = frames.iter().filter(|frame| frame.mask.is_some()).count();
    if masked > 0 {
        space.note("masks", format!("of {masked} images: black pixels are neither trained on nor measured"));
    }
    if !ignored.is_empty() {
        space.note("ignored keys", ignored.join(", "));
    }
}
