//! Blender scenes (NeRF's synthetic ones): `transforms_{train,val,test}.json` with RGBA images, and depth maps of
//! evaluation views if there are any.

use std::f64::consts::PI;
use std::path::{Path, PathBuf};

use crate::formats::transforms::frames::{self, Listed};
use crate::formats::transforms::{Role, notes, transforms_file};
use crate::found;
use crate::frame::{self, Frame, Reading};
use crate::json::{self, Object};
use crate::mask;
use crate::pose::{self, Pose};
use crate::settings::{DataConfig, DataKind, EvalSplit, scene_name};
use crate::{Camera, Photos, Rig, Scene, SceneSpace, Subject, View, background, depth, path};
use augnerf_base::{Error, Event, Listener, Result};

/// Start and end of a ray, as for all of NeRF's synthetic scenes, and range of the values of depth maps.
pub const BOUNDS: [f64; 2] = [2.0, 6.0];
/// Number of poses on the video path.
const ORBIT_POSES: usize = 40;
/// Elevation in degrees and radius of the video path, as in nerf-pytorch.
const ORBIT: (f64, f64) = (-30.0, 4.0);
/// Difference of two colours that count as one: what JPEG loses.
const ONE_COLOUR: f32 = 0.04;
/// Most views that are looked at.
const LOOKED_AT: usize = 5;
/// Fraction of a view's edge that has one colour if the view is of an object alone.
const MOST_OF_EDGE: f64 = 0.9;
/// Photographed objects fill about this fraction of what the cameras look at.
const OF_SUBJECT: f64 = 0.5;
/// Cameras are on the path's sphere, and look at its centre, within this fraction of the radius.
const OFF_SPHERE: f64 = 0.15;

/// Reads a Blender scene. The evaluation views are those of `config.eval_split`.
pub fn load(config: &DataConfig, photos: Photos, events: &dyn Listener) -> Result<Scene> {
    let eval = Role::evaluated(config).name();
    let train = read_split(config, "train", events)?;
    let lacks_split = has_no_photos(config, eval)?;
    let (train, listed) = match lacks_split {
        false => (train, read_split(config, eval, events)?),
        true if config.eval_split == EvalSplit::Val && has_no_photos(config, "test")? => return Err(no_val(config)),
        true => hold_out(train, config, eval, events),
    };
    let used: Vec<PathBuf> = train.iter().chain(&listed).map(|listed| listed.place.clone()).collect();
    found::note_unused(Path::new(&config.dir), used.iter(), "are in no transforms_*.json that is read", events);
    let (mut train, train_names) = frames::found(train);
    let (mut test, test_names) = frames::found(listed.into_iter().step_by(config.test_skip.max(1)).collect());
    mask::find(train.iter_mut().chain(&mut test), config, events)?;
    test.iter_mut().for_each(|frame| frame.depth = depth::file_of(&frame.path).map(|map| (map, BOUNDS)));
    let both: Vec<&Frame> = train.iter().chain(&test).collect();
    let sizes = frames::working_sizes(&both, config)?;
    let cameras: Vec<Camera> = both.iter().zip(sizes).map(|(frame, size)| frame.camera(size, in_turn)).collect();
    frames::note_shared(&config.dir, &both[..train.len()], &both[train.len()..], "", events);
    let mut space = SceneSpace::default();
    notes(&mut space, &both, &cameras, &[]);
    let (of_train, of_test) = cameras.split_at(train.len());
    let background = background(config);
    let read = |frames: &[Frame], names: &[String], cameras: &[Camera], split: &str| -> Result<Vec<View>> {
        let (scene, what) = (Path::new(&config.dir), format!("{split} photos"));
        let how = Reading { scene, background: (background, true), photos, what: &what, events };
        Ok(frame::views(frames, names, cameras, how)?.0)
    };
    let train = read(&train, &train_names, of_train, "train")?;
    let [near, far] = bounds(config, of_train, &train, &mut space, events)?;
    Ok(Scene {
        name: scene_name(config),
        kind: DataKind::Blender.name(),
        path: path_for(&of_train.iter().map(|camera| camera.pose).collect::<Vec<_>>())
            .into_iter()
            .map(|pose| Camera { pose, ..cameras[0] })
            .collect(),
        corrupted: None,
        lacks_split,
        space,
        train,
        test: read(&test, &test_names, of_test, eval)?,
        near,
        far,
        ndc: None,
        background: Some(background),
    })
}

/// Returns the ends of rays: the format's, or those of a folder whose training cameras look at something else. A Blender export may have
/// any size, and photos with a file for each split are read as such a scene. Their box is then what the cameras look at.
fn bounds(
    config: &DataConfig,
    cameras: &[Camera],
    views: &[View],
    space: &mut SceneSpace,
    events: &dyn Listener,
) -> Result<[f64; 2]> {
    let usual = format!("the format: {} to {}, as for all of NeRF's synthetic scenes", BOUNDS[0], BOUNDS[1]);
    let subject = Rig::of(cameras).subject;
    let (start, end) = (config.near.unwrap_or(BOUNDS[0]), config.far.unwrap_or(BOUNDS[1]));
    let fits = |subject: &Subject| {
        let (distance, reach) = (subject.depths[1], OF_SUBJECT * subject.radius);
        start <= distance - reach && distance + reach <= end
    };
    let Some(subject) = subject.filter(|subject| !fits(subject)) else {
        space.note("bounds from", usual);
        return Ok(BOUNDS);
    };
    let one_colour = on_one_colour(views)?;
    // Renders on one colour show nothing but the object. Photos have a background.
    let ((near, far), why) = match one_colour {
        true => (subject.extent(), subject.extent_words()),
        false => (subject.bounds(), subject.bounds_words()),
    };
    let file = Path::new(&config.dir).join(transforms_file("train"));
    let [_, distance, _] = subject.depths;
    let begin = format!(
        "{}: what the cameras look at is {distance:.3} away from them (radius {:.3}), outside of",
        file.display(),
        subject.radius
    );
    let instead = match one_colour {
        true => "",
        false => "; --set data.kind=transforms reads the folder as a capture of photos",
    };
    if config.near.is_some() && config.far.is_some() {
        events.on(Event::Note(&format!(
            "{begin} {start} to {end} (the bounds of this run); {near:.4} to {far:.4} would hold it{instead}"
        )));
        space.note("bounds from", usual);
        return Ok(BOUNDS);
    }
    events.on(Event::Note(&format!(
        "{begin} {start} to {end}, the bounds of NeRF's synthetic scenes: rays run from {near:.4} to {far:.4} instead where \
         data.near and data.far are not set{instead}"
    )));
    space.domain = Some(subject.domain());
    space.note("bounds from", why);
    Ok([near, far])
}

/// Returns whether most of some views have one colour all along their edge, as renders of an object have.
fn on_one_colour(views: &[View]) -> Result<bool> {
    let is_plain = |view: &View| {
        let (width, height) = (view.camera.width, view.camera.height);
        let texels = || view.image.pixels.chunks_exact(3).enumerate();
        let at_edge =
            |i: usize| i < width || i >= width * (height - 1) || matches!(i % width, 0) || i % width == width - 1;
        let Some((_, first)) = texels().next() else { return false };
        let edge = || texels().filter(|(i, _)| at_edge(*i));
        let near =
            edge().filter(|(_, texel)| texel.iter().zip(first).all(|(a, b)| (a - b).abs() <= ONE_COLOUR)).count();
        near as f64 >= MOST_OF_EDGE * edge().count() as f64
    };
    let some = views.iter().step_by(views.len().div_ceil(LOOKED_AT).max(1));
    let plain = some.map(|view| Ok(is_plain(&view.read()?))).collect::<Result<Vec<bool>>>()?;
    Ok(2 * plain.iter().filter(|plain| **plain).count() > plain.len())
}

/// Rounded as in nerf-pytorch.
fn in_turn(value: f64, to: f64, from: f64) -> f64 {
    value * to / from
}

/// Returns nerf-pytorch's video path: a full turn of 40 poses, 30 degrees up at distance 4, z is up.
pub fn orbit() -> Vec<Pose> {
    let (elevation, radius) = ORBIT;
    let at = |i: usize| sphere_pose(-180.0 + 360.0 * i as f64 / ORBIT_POSES as f64, elevation, radius);
    (0..ORBIT_POSES).map(at).collect()
}

/// Returns nerf-pytorch's path if the cameras are on its sphere, as in NeRF's synthetic scenes, and a path of their own
/// otherwise.
fn path_for(poses: &[Pose]) -> Vec<Pose> {
    let radius = ORBIT.1;
    let on_sphere = |p: &Pose| (pose::length(pose::column(p, 3)) / radius - 1.0).abs() < OFF_SPHERE;
    let at_origin = path::centre(poses).is_some_and(|centre| pose::length(centre) < OFF_SPHERE * radius);
    if at_origin && poses.iter().all(on_sphere) { orbit() } else { path::around(poses) }
}

/// Returns the pose at `azimuth` and `elevation` (degrees; negative is above) that looks at the origin from `radius`.
pub fn sphere_pose(azimuth: f64, elevation: f64, radius: f64) -> Pose {
    let (sin_a, cos_a) = (azimuth / 180.0 * PI).sin_cos();
    let (sin_e, cos_e) = (elevation / 180.0 * PI).sin_cos();
    // A camera at (0, 0, radius), rotated about x by the elevation and about y by the azimuth. It is then converted
    // from y-up to z-up with x mirrored: (x, y, z) -> (-x, z, y).
    let back = [-sin_a * cos_e, -sin_e, cos_a * cos_e];
    let up = [-sin_a * sin_e, cos_e, cos_a * sin_e];
    let right = [cos_a, 0.0, sin_a];
    let origin = back.map(|v| v * radius);
    let turned = |axis: usize| [right[axis], up[axis], back[axis], origin[axis]];
    [turned(0).map(|v| -v), turned(2), turned(1)]
}

/// Reads the frames of one `transforms_*.json`, at least one.
fn read_split(config: &DataConfig, name: &str, events: &dyn Listener) -> Result<Vec<Listed>> {
    let dir = Path::new(&config.dir);
    let file = dir.join(transforms_file(name));
    if !file.exists() {
        return Err(missing(&file, name));
    }
    let value = json::read(&file)?;
    frames::read(Object::document(&file, &value)?, "frames", config, events)
}

/// Returns whether none of a split's photos is there, as exporters leave it that render no test views. Without the split's
/// file, another one may have views to evaluate on.
fn has_no_photos(config: &DataConfig, split: &str) -> Result<bool> {
    let file_of = |split: &str| Path::new(&config.dir).join(transforms_file(split));
    let file = file_of(split);
    if !file.exists() {
        return Ok(!["test", "val"].into_iter().any(|other| file_of(other).exists()));
    }
    frames::has_no_photos(Object::document(&file, &json::read(&file)?)?)
}

/// Splits the training views: every `data.holdout`-th is held out, from the first on.
fn hold_out(train: Vec<Listed>, config: &DataConfig, split: &str, events: &dyn Listener) -> (Vec<Listed>, Vec<Listed>) {
    let every = config.holdout.max(1);
    events.on(Event::Note(&format!(
        "{}: no photo of {} is there; every {every}th of the {} training views is held out instead (data.holdout)",
        config.dir,
        transforms_file(split),
        train.len()
    )));
    let (mut kept, mut held_out) = (Vec::new(), Vec::new());
    for (place, listed) in train.into_iter().enumerate() {
        if place.is_multiple_of(every) { held_out.push(listed) } else { kept.push(listed) }
    }
    (kept, held_out)
}

/// Test views are then every `data.holdout`-th training view, and validation views would be the same ones.
fn no_val(config: &DataConfig) -> Error {
    Error::Data(format!(
        "{}: neither {} nor {} has photos here, so data.eval_split = val would hold out the views that test holds out; to \
         have validation views, rename transforms_train.json to transforms.json, and set data.validation",
        config.dir,
        transforms_file("val"),
        transforms_file("test")
    ))
}

fn missing(file: &Path, split: &str) -> Error {
    let other = match split {
        "test" => "val",
        "val" => "test",
        _ => {
            return Error::Data(format!(
                "{} is missing: it must hold the training poses of a Blender scene",
                file.display()
            ));
        }
    };
    let other_file = transforms_file(other);
    Error::Data(format!("{} is missing; {other_file} is there: set data.eval_split={other}", file.display()))
}
