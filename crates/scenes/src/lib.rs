//! Scenes: posed images split into training, validation and held-out views.

#![warn(missing_docs)]

pub mod camera;
pub mod cameras;
pub mod corruption;
pub mod depth;
mod describe;
mod detect;
mod foreign;
pub mod formats;
mod found;
mod frame;
pub mod images;
mod json;
mod load_notes;
mod lookalikes;
mod mask;
pub mod npy;
pub mod path;
mod photo_files;
pub mod ply;
mod points;
pub mod pose;
pub mod rays;
mod remarks;
pub mod resample;
mod rescale;
mod rig;
mod scene_space;
pub mod settings;
mod unseen;
pub mod vector;
mod views;
mod world;

pub use camera::{Camera, Ndc};
pub use corruption::Corrupted;
pub use detect::detect;
pub use formats::{Capture, FORMATS, Format, ReferenceDepth};
pub use frame::{Photos, Unread};
pub use lookalikes::scene_of_file;
pub use points::PointRays;
pub use rays::{Footprint, RayBuffer, RayParts, Rays, tangents};
pub use remarks::MANY_COLOURS;
pub use rig::{Rig, Subject};
pub use scene_space::SceneSpace;
pub use unseen::{PATCH_SIDE, RayGroup, UnseenCameras, UnseenPoses, UnseenRay};
pub use views::seen_views;
pub use world::WorldToScene;

use std::sync::Arc;

use sha2::{Digest, Sha256};

use augnerf_base::{Error, Event, Image, Listener, Result, short_hash};
use load_notes::LoadNotes;

use settings::{Background, DataConfig};

/// One photo with its pose.
#[derive(Clone, Debug)]
pub struct View {
    /// The file's stem, or the built-in scene's view name. It is unique within its split.
    pub name: String,
    /// Intrinsics and pose.
    pub camera: Camera,
    /// RGB over the scene's background, `camera.width x camera.height`.
    pub image: Arc<Image>,
    /// Ground-truth depth along the view's z axis in scene units, row-major, if the scene has it. It is exact (the
    /// built-in scene) or in steps of 8 bits. `f32::INFINITY` where the ray hits nothing, NaN where it is not known.
    pub depth: Option<Vec<f32>>,
    /// Which pixels count, row-major. Others are neither trained on nor measured. `None` if all count.
    pub mask: Option<Arc<[bool]>>,
    /// Where image, depth and mask come from ([`View::read`]) if they are not read: the image then has no pixels.
    pub unread: Option<Arc<Unread>>,
}

/// A loaded scene, ready for training: every pose final, every image at the working resolution.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The folder's name, or `builtin`.
    pub name: String,
    /// `llff`, `blender`, `transforms`, `colmap`, `builtin-blender`, `builtin-forward`.
    pub kind: &'static str,
    /// Training views.
    pub train: Vec<View>,
    /// Views for metrics, which are not trained on.
    pub test: Vec<View>,
    /// Start of a ray's interval, in the units of `t_vals` (0 under NDC).
    pub near: f64,
    /// End of a ray's interval (1 under NDC).
    pub far: f64,
    /// Set if rays are mapped to normalized device coordinates.
    pub ndc: Option<Ndc>,
    /// Colour of pixels without accumulation; `None` for opaque photos.
    pub background: Option<[f32; 3]>,
    /// Cameras of the scene's usual video path (spiral or orbit), at the working resolution.
    pub path: Vec<Camera>,
    /// The corruption of the training views.
    pub corrupted: Option<Corrupted>,
    /// The split to evaluate has no photos: every `data.holdout`-th training view is held out instead.
    pub lacks_split: bool,
    /// The scene's space: units, box, points.
    pub space: SceneSpace,
}

/// The extent of a loaded scene, which fills open numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// Start of a ray's interval, in the units of `t_vals`.
    pub near: f64,
    /// End of a ray's interval.
    pub far: f64,
    /// The box that most cameras look at, in scene units, if the scene's own geometry tells it.
    pub domain: Option<[[f64; 3]; 2]>,
    /// Pixels along the longer side of an image.
    pub pixels: usize,
}

impl Scene {
    /// Returns start and end of a ray's interval, in the units of `t_vals`.
    pub fn bounds(&self) -> (f64, f64) {
        (self.near, self.far)
    }

    /// Returns the number of pixels that are trained on: those of the training views outside their masks, corrupted or not.
    /// `None` if a mask is not read.
    pub fn training_pixels(&self) -> Option<usize> {
        let counted = |view: &View| match &view.mask {
            Some(mask) => Some(mask.iter().filter(|counts| **counts).count()),
            None if view.unread.as_ref().is_some_and(|unread| unread.has_mask()) => None,
            None => Some(view.camera.width * view.camera.height),
        };
        self.train.iter().map(counted).sum()
    }

    /// Returns what settings that depend on the scene follow from.
    pub fn extent(&self) -> Extent {
        let sides = self.train.iter().chain(&self.test).map(|view| view.camera.width.max(view.camera.height));
        Extent { near: self.near, far: self.far, domain: self.space.domain, pixels: sides.max().unwrap_or(0) }
    }

    /// Returns the format in which the scene was read, or `None` for a scene of your own.
    pub fn format(&self) -> Option<&'static Format> {
        FORMATS.iter().find(|format| format.kind.name() == self.kind)
    }

    /// Returns whether the views' depth is exact.
    pub fn has_exact_depth(&self) -> bool {
        self.format().is_some_and(|format| format.depth == ReferenceDepth::Exact)
    }

    /// Returns whether all photos are read.
    pub fn is_read(&self) -> bool {
        self.train.iter().chain(&self.test).all(|view| view.unread.is_none())
    }

    /// Returns a 12-digit hash of all views: the data of training and metrics. The scene must be [read](Scene::is_read).
    pub fn hash(&self) -> String {
        let mut digest = Sha256::new();
        digest.update(self.near.to_le_bytes());
        digest.update(self.far.to_le_bytes());
        for (split, views) in [("train", &self.train), ("test", &self.test)] {
            digest.update(split);
            for View { name, camera, image, mask, .. } in views {
                digest.update(name);
                let Camera { focal, centre, pose, .. } = camera;
                let geometry = focal.iter().chain(centre).chain(pose.iter().flatten());
                geometry.for_each(|value| digest.update(value.to_le_bytes()));
                // In pieces: one call per number would take longer than the hash.
                for pixels in image.pixels.chunks(1024) {
                    digest.update(pixels.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>());
                }
                if let Some(mask) = mask {
                    digest.update("mask");
                    digest.update(mask.iter().map(|&counts| counts.into()).collect::<Vec<u8>>());
                }
            }
        }
        short_hash(digest)
    }
}

/// Returns how often a training pixel was seen on average: the rays of all steps, over the training pixels. Rays without
/// photographs are none of these. `None` if there are no pixels.
pub fn epochs(rays: f64, training_pixels: usize) -> Option<f64> {
    (training_pixels > 0).then(|| rays / training_pixels as f64)
}

/// The largest number in a scene, in magnitude. Training computes in f32, where products of three such numbers are
/// still finite.
const LARGEST: f64 = 1e12;
/// The smallest length or angle in a scene.
const SMALLEST: f64 = 1e-6;

/// Returns whether [`load`] may find a box that most cameras look at, which a hash grid then fills.
pub fn may_have_box(config: &DataConfig) -> bool {
    let is_in_ndc = config.kind.forward_facing() && config.ndc;
    !is_in_ndc && config.kind.format().is_some_and(|format| format.reads.contains(&"rescale"))
}

/// Loads the scene that `config` names. Its kind must be settled ([`detect`]) and `downscale` filled. `seed` is for the
/// corruption of training views.
pub fn load(config: &DataConfig, seed: u64, events: &dyn Listener) -> Result<Scene> {
    load_with(config, seed, Photos::Read, events)
}

/// Does the same, and reads as much of the photos as is asked for. Corruptions read all.
pub fn load_with(config: &DataConfig, seed: u64, photos: Photos, events: &dyn Listener) -> Result<Scene> {
    let Some(format) = Format::of(config.kind) else {
        return Err(Error::Config("data.kind = \"auto\" has to be settled before the scene is loaded".into()));
    };
    let load_notes = LoadNotes::new(events);
    let photos = if config.corruption.is_on() { Photos::Read } else { photos };
    let mut scene = (format.read)(config, photos, &load_notes)?;
    load_notes.words(&config.dir).into_iter().for_each(|words| scene.space.note("noted", words));
    if config.rescale && may_have_box(config) {
        rescale::rescale(&mut scene)?;
    }
    scene.near = config.near.unwrap_or(scene.near);
    scene.far = config.far.unwrap_or(scene.far);
    check(&scene, config)?;
    views::keep_training_views(&mut scene, config)?;
    let folder = if config.dir.is_empty() { &scene.name } else { &config.dir };
    let remarks = remarks::of(&scene);
    remarks.iter().for_each(|remark| events.on(Event::Note(&format!("{folder}: {remark}"))));
    if !remarks.is_empty() {
        scene.space.note("remarks", remarks.join("; "));
    }
    corruption::corrupt(&mut scene, &config.corruption, seed)?;
    Ok(scene)
}

fn check(scene: &Scene, config: &DataConfig) -> Result<()> {
    if scene.train.is_empty() || scene.test.is_empty() {
        return Err(Error::Data(format!(
            "{} leaves {} views to train on and {} held out (data.holdout = {}, data.validation = {}, data.test_skip = {}): \
             both need at least one",
            config.dir,
            scene.train.len(),
            scene.test.len(),
            config.holdout,
            config.validation,
            config.test_skip
        )));
    }
    if scene.near < scene.far {
        return check_numbers(scene, config);
    }
    Err(Error::Config(format!(
        "data.near = {} is not below data.far = {}, the scene's own bounds where one is not set: change one of them",
        scene.near, scene.far
    )))
}

fn is_sound(value: f64) -> bool {
    value.abs() <= LARGEST
}

/// Returns whether a camera's numbers are safe to compute with.
fn camera_is_sound(camera: &Camera) -> bool {
    let Camera { focal, centre, pose, .. } = camera;
    let focal_is = focal.iter().all(|&focal| focal >= SMALLEST);
    focal_is && focal.iter().chain(centre).chain(pose.iter().flatten()).all(|&value| is_sound(value))
}

/// Checks that numbers are still safe to compute with after poses are scaled and centred.
fn check_numbers(scene: &Scene, config: &DataConfig) -> Result<()> {
    let from = if config.dir.is_empty() { &scene.name } else { &config.dir };
    if let Some(view) = scene.train.iter().chain(&scene.test).find(|view| !camera_is_sound(&view.camera)) {
        return Err(Error::Data(format!(
            "{from}: view {} has a focal length of {:?} pixels, its camera is at {:?}, once poses are scaled and centred: \
             training computes with numbers from -{LARGEST:e} to {LARGEST:e}; check the poses' units and depth bounds",
            view.name,
            view.camera.focal,
            pose::column(&view.camera.pose, 3)
        )));
    }
    let outside = |camera: &Camera| {
        let sides = [camera.width as f64, camera.height as f64];
        camera.centre.iter().zip(sides).any(|(&centre, side)| !(-0.5 * side..=1.5 * side).contains(&centre))
    };
    if let Some(view) = scene.train.iter().chain(&scene.test).find(|view| outside(&view.camera)) {
        let Camera { width, height, centre, .. } = view.camera;
        return Err(Error::Data(format!(
            "{from}: the principal point of view {} is at {:.1}, {:.1} of a picture of {width}x{height}, more than half a picture \
             outside: its intrinsics are probably those of another size; give their width and height (\"w\" and \"h\" in \
             transforms.json), or correct them",
            view.name, centre[0], centre[1]
        )));
    }
    if !(is_sound(scene.near) && is_sound(scene.far) && scene.path.iter().all(camera_is_sound)) {
        return Err(Error::Data(format!(
            "{from}: depth bounds {} and {} and poses of this size make no video path and no rays that can be computed \
             with (numbers from -{LARGEST:e} to {LARGEST:e}); check the poses' units and depth bounds",
            scene.near, scene.far
        )));
    }
    Ok(())
}

/// Returns the background colour behind transparent pixels.
fn background(config: &DataConfig) -> [f32; 3] {
    match config.background {
        Background::White => [1.0; 3],
        Background::Black => [0.0; 3],
    }
}
