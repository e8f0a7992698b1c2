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

use crate::base::{Error, Event, Image, Listener, Result};
use crate::data::formats::Capture;
use crate::data::formats::transforms::BOUNDS;
use crate::data::formats::transforms::distortion::{self, Distortion, Intrinsics};
use crate::data::images::{self, Size};
use crate::data::mask::{MaskFile, Masked, Masks};
use crate::data::pose::Pose;
use crate::data::{Camera, Scene, SceneSpace, WorldToScene, background, name_of, path, resample};
use crate::settings::{DataConfig, DataKind};
use folder::Source;
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

/// Largest difference, beyond a pixel, between an image's sides and those of its camera, as a fraction.
const SIZE_TOLERANCE: f64 = 0.01;

/// Largest number of missing images that are named.
const NAMES: usize = 20;

/// Returns a name as a list shows it.
fn shown(name: &str) -> String {
    name.chars().take(100).collect()
}

/// A photo that exists, before it is read.
struct Frame {
    path: PathBuf,
    pose: Pose,
    /// Intrinsics of the stored image.
    lens: Intrinsics,
    distortion: Distortion,
    /// The camera without distortion, at the stored size.
    pinhole: Intrinsics,
    stored: (usize, usize),
    mask: Option<MaskFile>,
}

/// Reads a COLMAP scene. Views are sorted by name, and every `config.holdout`-th is held out. The scene's space and the
/// views' roles depend on all images of the model, including missing ones.
pub fn load(config: &DataConfig, events: &dyn Listener) -> Result<Scene> {
    let dir = Path::new(&config.dir);
    let model = read::model(dir, &config.colmap_model, events)?;
    let source = folder::find(dir, &model.photographs, Size::of(config))?;
    let missing = check_missing(dir, &model, &source, events)?;
    source.moved.iter().for_each(|moved| events.on(Event::Note(&format!("{}: {moved}", dir.display()))));
    if source.renamed > 0 {
        events.on(Event::Note(&format!(
            "{}: the names of {} photos differ from those of the COLMAP model in letter case or Unicode form",
            dir.display(),
            source.renamed
        )));
    }
    images::note_unused(dir, source.files.iter().flatten(), "are not in the COLMAP model", events);
    let mut poses: Vec<Pose> = model.photographs.iter().map(|photograph| photograph.pose).collect();
    let world = match config.recentre {
        true => WorldToScene::centre(&mut poses.iter_mut().collect::<Vec<&mut Pose>>()),
        false => WorldToScene::default(),
    };
    let path = path::around(&poses);
    let there: Vec<bool> = source.files.iter().map(Option::is_some).collect();
    let (mut frames, names) = frames(dir, &model, &source, &poses)?;
    let masks = Masks::of(config, frames.iter().map(|frame| &*frame.path), events)?;
    frames.iter_mut().zip(masks.files).for_each(|(frame, mask)| frame.mask = mask);
    let targets = targets(config, &source, &frames)?;
    let cameras: Vec<Camera> = frames.iter().zip(&targets).map(|(frame, &target)| frame.camera(target)).collect();
    let (mut space, (near, far)) = bounds::of(&model, &cameras, world, BOUNDS);
    let sightings = model.sightings().into_iter().zip(&there).filter(|(_, there)| **there).map(|(points, _)| points);
    space.sightings = names.iter().cloned().zip(sightings).collect();
    space.note("images", folder_words(&frames, targets[0]));
    notes(&mut space, &model, &frames, &missing, &source);
    let first = cameras[0];
    let (images, clear) = read_images(dir, &frames, &targets, background(config), events)?;
    let mut views = Capture::views(names, cameras, images);
    for (view, frame) in views.iter_mut().zip(&frames) {
        view.mask = frame.read_mask((view.camera.width, view.camera.height))?.map(Into::into);
    }
    let capture = Capture {
        views,
        near,
        far,
        ndc: None,
        background: clear.then(|| background(config)),
        path: path.into_iter().map(|pose| Camera { pose, ..first }).collect(),
        space,
    };
    Ok(capture.hold_out_listed(name_of(config), DataKind::Colmap.name(), config, &there))
}

/// Notes missing photos. It is an error if more than half are missing.
fn check_missing(dir: &Path, model: &Model, source: &Source, events: &dyn Listener) -> Result<Vec<String>> {
    let is_missing =
        |(photograph, file): (&Photograph, &Option<PathBuf>)| file.is_none().then(|| photograph.name.clone());
    let missing: Vec<String> = model.photographs.iter().zip(&source.files).filter_map(is_missing).collect();
    if missing.is_empty() {
        return Ok(missing);
    }
    let named: Vec<String> = missing.iter().take(NAMES).map(|name| format!("{:?}", shown(name))).collect();
    let more = if missing.len() > NAMES { ", ..." } else { "" };
    let words = format!(
        "{}: {} of the {} images of the COLMAP model are not there: {}{more}",
        dir.display(),
        missing.len(),
        model.photographs.len(),
        named.join(", ")
    );
    if 2 * missing.len() > model.photographs.len() {
        return Err(Error::Data(format!("{words}; with more than half of them gone it is another capture's model")));
    }
    events.on(Event::Note(&format!("{words}; they are left out")));
    Ok(missing)
}

/// Returns all existing photos, with their cameras and their names among all. `poses` are those of all photos in the
/// scene.
fn frames(dir: &Path, model: &Model, source: &Source, poses: &[Pose]) -> Result<(Vec<Frame>, Vec<String>)> {
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

fn frame(lens: &Lens, photograph: &Photograph, path: PathBuf, dir: &Path) -> Result<Frame> {
    let stored = images::size(&path)?;
    let size = [stored.0 as f64, stored.1 as f64];
    let scale = [size[0] / lens.size[0], size[1] / lens.size[1]];
    if (lens.size[1] * scale[0] - size[1]).abs() > 1.0 + SIZE_TOLERANCE * size[1] {
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
    let Some(pinhole) = distortion::pinhole(intrinsics, &lens.distortion, stored) else {
        return Err(Error::Data(format!(
            "{}: the lens distortion of camera {} ({}, {:?}) cannot be undone over the whole image: its coefficients are too \
             large; undistort the images first with COLMAP's image_undistorter",
            dir.display(),
            photograph.camera,
            lens.model,
            lens.distortion
        )));
    };
    let Photograph { pose, .. } = *photograph;
    Ok(Frame { path, pose, lens: intrinsics, distortion: lens.distortion, pinhole, stored, mask: None })
}

impl Frame {
    /// Returns which pixels count at the working resolution, if the photo has a mask.
    fn read_mask(&self, size: (usize, usize)) -> Result<Option<Vec<bool>>> {
        let Some(mask) = &self.mask else { return Ok(None) };
        let rectified = |mask: Image| match self.distortion.is_none() {
            true => mask,
            false => distortion::rectify(&mask, self.lens, &self.distortion, self.pinhole),
        };
        mask.read(&Masked { path: &self.path, size: self.stored }, rectified, size).map(Some)
    }

    /// Returns the pinhole camera at the working resolution.
    fn camera(&self, target: (usize, usize)) -> Camera {
        let scale = [target.0 as f64 / self.stored.0 as f64, target.1 as f64 / self.stored.1 as f64];
        let scaled = |values: [f64; 2]| [values[0] * scale[0], values[1] * scale[1]];
        let Intrinsics { focal, centre } = self.pinhole;
        Camera { width: target.0, height: target.1, focal: scaled(focal), centre: scaled(centre), pose: self.pose }
    }
}

/// Returns the working resolutions. For a factor, the rest after the folder's factor is applied, to the nearest pixel,
/// as the smaller folders are made. For a width, one scale applies to all.
fn targets(config: &DataConfig, source: &Source, frames: &[Frame]) -> Result<Vec<(usize, usize)>> {
    let stored: Vec<(usize, usize)> = frames.iter().map(|frame| frame.stored).collect();
    match Size::of(config) {
        Size::Factor(factor) => {
            let rest = (factor / source.factor).max(1) as f64;
            let divide = |side: usize| ((side as f64 / rest).round() as usize).max(1);
            Ok(stored.into_iter().map(|(width, height)| (divide(width), divide(height))).collect())
        }
        width => images::working_sizes(width, &stored, &frames[0].path),
    }
}

/// Describes the folder and the size of its first image.
fn folder_words(frames: &[Frame], target: (usize, usize)) -> String {
    let (paths, first) = ([frames[0].path.clone()], frames[0].stored);
    let differ = frames.iter().any(|frame| frame.stored != first);
    images::folder_words(&paths, first, target) + if differ { " (the first; sizes differ)" } else { "" }
}

/// Decodes all photos, removes their distortion at the stored size, then averages them down.
fn read_images(
    scene: &Path,
    frames: &[Frame],
    targets: &[(usize, usize)],
    background: [f32; 3],
    events: &dyn Listener,
) -> Result<(Vec<Image>, bool)> {
    images::check_memory_of(targets)?;
    let paths: Vec<PathBuf> = frames.iter().map(|frame| frame.path.clone()).collect();
    images::note_turned(scene, &paths, events)?;
    let read = |i: usize, path: &Path| {
        let (Frame { lens, distortion, pinhole, stored, .. }, target) = (&frames[i], targets[i]);
        let image = if distortion.is_none() {
            images::read(path, target)?
        } else {
            let flat = distortion::rectify(&images::read(path, *stored)?, *lens, distortion, *pinhole);
            resample::shrink(&flat, target.0, target.1)
        };
        Ok(resample::composite(image, background))
    };
    let (images, clear): (Vec<Image>, Vec<bool>) =
        images::each(&paths, "reading images", events, read)?.into_iter().unzip();
    Ok((images, clear.contains(&true)))
}

/// Notes what was found and chosen, for people.
fn notes(space: &mut SceneSpace, model: &Model, frames: &[Frame], missing: &[String], source: &Source) {
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
    let zoom = frames.iter().map(|frame| frame.pinhole.focal[0] / frame.lens.focal[0]).fold(1.0, f64::max);
    let undone = frames.iter().filter(|frame| !frame.distortion.is_none()).count();
    let words =
        if undone == 0 { "none".into() } else { format!("undone in {undone} images, zoomed in by up to {zoom:.3}") };
    space.note("distortion", words);
    if !missing.is_empty() {
        space.note("missing images", missing.len().to_string());
    }
    if !source.passed.is_empty() {
        space.note("passed over", source.passed.join("; "));
    }
}
