//! COLMAP scenes: a model in `sparse/0` or the like (`cameras`, `images`, `points3D`, `.bin` or `.txt`) next to `images` or
//! smaller `images_2`, `images_4`, `images_8`, as 3D Gaussian splatting writes them. Of several models the one with the most
//! photos is read.
//!
//! The formats are those of COLMAP's documentation ("Output Format"). Its principal points count from the corner of the
//! first pixel, whose centre is at 0.5. The default of `data.pixel_origin` is therefore `centre`.

mod binary;
mod bounds;
mod folder;
mod model;
mod read;
mod text;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::formats::Capture;
use crate::formats::transforms::distortion::Intrinsics;
use crate::formats::transforms::{BOUNDS, by_ratio, is_scaled};
use crate::found;
use crate::frame::{self, Frame, Reading};
use crate::images::{self, Header, Size};
use crate::mask;
use crate::photo_files::Chosen;
use crate::pose::Pose;
use crate::settings::{DataConfig, DataKind, scene_name};
use crate::{Camera, Photos, Scene, SceneSpace, WorldToScene, background, path};
use augnerf_base::{Error, Event, Listener, Result, first_names};
use model::{Lens, Model, Photograph};

/// Returns whether a folder holds a model.
pub fn is_scene(dir: &Path) -> bool {
    !read::candidates(dir).is_empty()
}

/// Returns the names of the photos of a folder's model, if there is one that can be read.
pub(super) fn names(dir: &Path) -> Option<BTreeSet<String>> {
    let model = read::model(dir, "", &()).ok()?;
    Some(model.photographs.into_iter().map(|photograph| photograph.name).collect())
}

/// Largest number of missing images that are named.
const NAMES: usize = 20;

/// Returns a name as a list shows it.
fn shown(name: &str) -> String {
    name.chars().take(100).collect()
}

/// Reads a COLMAP scene. Views are sorted by name, and every `config.holdout`-th is held out. The scene's space and the
/// views' roles depend on all images of the model, including missing ones.
pub fn load(config: &DataConfig, photos: Photos, events: &dyn Listener) -> Result<Scene> {
    let dir = Path::new(&config.dir);
    let model = read::model(dir, &config.colmap_model, events)?;
    let names: Vec<&str> = model.photographs.iter().map(|photograph| &*photograph.name).collect();
    let source = folder::find(dir, &names, Size::of(config), &|files| widest(&model, files))?;
    let missing = note_missing(dir, &model, &source, events);
    match &source.elsewhere {
        Some(words) => events.on(Event::Note(&format!("{}: {words}", dir.display()))),
        None => note_renamed(dir, &names, &source, events),
    }
    found::note_unused(dir, source.files.iter().flatten(), "are not in the COLMAP model", events);
    let mut poses: Vec<Pose> = model.photographs.iter().map(|photograph| photograph.pose).collect();
    let world = match config.recentre {
        true => WorldToScene::centre(&mut poses.iter_mut().collect::<Vec<&mut Pose>>()),
        false => WorldToScene::default(),
    };
    let path = path::around(&poses);
    let there: Vec<bool> = source.files.iter().map(Option::is_some).collect();
    let (mut frames, names) = frames(dir, &model, &source, &poses)?;
    mask::find(frames.iter_mut(), config, events)?;
    let targets = targets(config, &source, &frames)?;
    let cameras: Vec<Camera> =
        frames.iter().zip(targets).map(|(frame, target)| frame.camera(target, by_ratio)).collect();
    let (mut space, (near, far)) = bounds::of(&model, &cameras, world, BOUNDS);
    let sightings = model.sightings().into_iter().zip(&there).filter(|(_, there)| **there).map(|(points, _)| points);
    space.sightings = names.iter().cloned().zip(sightings).collect();
    let first = cameras[0];
    frame::note_images(&mut space, &frames.iter().collect::<Vec<_>>(), (first.width, first.height));
    notes(&mut space, &model, &frames, &missing, &source);
    let background = background(config);
    let how = Reading { scene: dir, background: (background, false), photos, what: "photos", events };
    let (views, clear) = frame::views(&frames, &names, &cameras, how)?;
    let capture = Capture {
        views,
        near,
        far,
        ndc: None,
        background: clear.then_some(background),
        path: path.into_iter().map(|pose| Camera { pose, ..first }).collect(),
        space,
    };
    Ok(capture.hold_out_listed(scene_name(config), DataKind::Colmap.name(), config, &there))
}

/// Notes photos whose names differ from the model's.
fn note_renamed(dir: &Path, names: &[&str], source: &Chosen, events: &dyn Listener) {
    let is_renamed = |(file, name): &(&Option<PathBuf>, &&str)| {
        let own = PathBuf::from(found::slashes(name)).with_extension("");
        file.as_ref().is_some_and(|file| !file.with_extension("").ends_with(&own))
    };
    let renamed = source.files.iter().zip(names).filter(is_renamed).count();
    if renamed > 0 {
        events.on(Event::Note(&format!(
            "{}: the names of {renamed} photos differ from those of the COLMAP model in letter case or Unicode form",
            dir.display()
        )));
    }
}

/// Notes missing photos.
fn note_missing(dir: &Path, model: &Model, source: &Chosen, events: &dyn Listener) -> Vec<String> {
    let is_missing =
        |(photograph, file): (&Photograph, &Option<PathBuf>)| file.is_none().then(|| photograph.name.clone());
    let missing: Vec<String> = model.photographs.iter().zip(&source.files).filter_map(is_missing).collect();
    if missing.is_empty() {
        return missing;
    }
    let named: Vec<String> = missing.iter().map(|name| format!("{:?}", shown(name))).collect();
    let is_most = 2 * missing.len() > model.photographs.len();
    let most = if is_most { ". These are most of them: check that the model is this capture's" } else { "" };
    events.on(Event::Note(&format!(
        "{}: {} of the {} images of the COLMAP model are not there and are left out: {}{most}",
        dir.display(),
        missing.len(),
        model.photographs.len(),
        first_names(&named, NAMES)
    )));
    missing
}

/// Returns all existing photos, with their cameras and their names among all. `poses` are those of all photos in the
/// scene.
fn frames(dir: &Path, model: &Model, source: &Chosen, poses: &[Pose]) -> Result<(Vec<Frame>, Vec<String>)> {
    let Model { photographs, lenses, .. } = model;
    let names = images::names(&photographs.iter().map(|photograph| photograph.name.clone().into()).collect::<Vec<_>>());
    let (mut frames, mut found) = (Vec::new(), Vec::new());
    for (((photograph, file), pose), name) in photographs.iter().zip(&source.files).zip(poses).zip(names) {
        let Some(file) = file.clone() else { continue };
        frames.push(Frame { pose: *pose, ..frame(&lenses[&photograph.camera], photograph, file, dir)? });
        found.push(name);
    }
    Ok((frames, found))
}

/// Returns the columns of the widest of these photos, by which a width is measured.
fn widest(model: &Model, files: &[Option<PathBuf>]) -> Result<usize> {
    let mut there =
        model.photographs.iter().zip(files).filter_map(|(photograph, file)| Some((photograph, file.as_ref()?)));
    there.try_fold(0, |widest, (photograph, file)| {
        Ok(header(&model.lenses[&photograph.camera], file)?.size.0.max(widest))
    })
}

/// Reads a photo's header, of the turned photo if only that fits its camera.
fn header(lens: &Lens, path: &Path) -> Result<Header> {
    Ok(Header::read(path)?.turned_to_fit(|size| is_scaled(lens.size, size)))
}

fn frame(lens: &Lens, photograph: &Photograph, path: PathBuf, dir: &Path) -> Result<Frame> {
    let header = header(lens, &path)?;
    let stored = header.size;
    let scale = [stored.0 as f64 / lens.size[0], stored.1 as f64 / lens.size[1]];
    if !is_scaled(lens.size, stored) {
        return Err(Error::Data(format!(
            "{} is {}x{} pixels, but camera {} of the COLMAP model is for {}x{}: it was cropped or turned, so the camera is not \
             its own",
            path.display(),
            stored.0,
            stored.1,
            photograph.camera,
            lens.size[0],
            lens.size[1]
        )));
    }
    let scaled = |values: [f64; 2]| [values[0] * scale[0], values[1] * scale[1]];
    let intrinsics = Intrinsics { focal: scaled(lens.intrinsics.focal), centre: scaled(lens.intrinsics.centre) };
    Frame::new(path, header, intrinsics, lens.distortion).ok_or_else(|| {
        Error::Data(format!(
            "{}: the lens distortion of camera {} ({}, {:?}) cannot be undone over the whole image: its coefficients are too \
             large; undistort the images first with COLMAP's image_undistorter",
            dir.display(),
            photograph.camera,
            lens.model,
            lens.distortion
        ))
    })
}

/// Returns the working resolutions. For a factor, the rest after the folder's factor is applied, to the nearest pixel,
/// as the smaller folders are made. For a width, one scale applies to all.
fn targets(config: &DataConfig, source: &Chosen, frames: &[Frame]) -> Result<Vec<(usize, usize)>> {
    let stored: Vec<(usize, usize)> = frames.iter().map(Frame::size).collect();
    match Size::of(config) {
        Size::Factor(factor) => Ok(stored.into_iter().map(|size| source.reduced(size, factor)).collect()),
        width => images::working_sizes(width, &stored, &frames[0].path),
    }
}

/// Notes what was found and chosen, for people.
fn notes(space: &mut SceneSpace, model: &Model, frames: &[Frame], missing: &[String], source: &Chosen) {
    let mut models: Vec<&str> = model.lenses.values().map(|lens| lens.model).collect();
    models.sort_unstable();
    models.dedup();
    let (cameras, points) = (model.lenses.len(), model.points.len());
    space.note(
        "model",
        format!(
            "{}: {cameras} cameras ({}), {} images, {points} points",
            model.folder,
            models.join(", "),
            model.photographs.len()
        ),
    );
    frame::note_distortion(space, &frames.iter().collect::<Vec<_>>());
    if !missing.is_empty() {
        space.note("missing images", missing.len().to_string());
    }
    if !source.passed.is_empty() {
        space.note("passed over", source.passed.join("; "));
    }
}
