//! The photo of a view before it is read: its file, turn, lens and mask. The pixels of all formats are read here, at once or
//! when they are asked for.
//!
//! Pixels are read as stored. An EXIF orientation is applied if only the turned photo fits the camera.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use image::metadata::Orientation;

use super::formats::transforms::distortion::{self, Distortion, Intrinsics};
use super::images::{self, Header};
use super::mask::MaskFile;
use super::pose::Pose;
use super::{Camera, SceneSpace, View, depth, resample};
use augnerf_base::{Event, Image, Listener, Result, first_names};

/// Most names in a note.
const NAMES: usize = 8;

/// How much of a scene's photos is read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Photos {
    /// All of them, at once.
    #[default]
    Read,
    /// Headers, and photos with alpha until it is known whether there is a background. [`View::read`] reads a view's pixels.
    Later,
}

/// A photo before it is read.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Its file.
    pub path: PathBuf,
    /// Camera to world.
    pub pose: Pose,
    /// Which pixels count.
    pub(super) mask: Option<MaskFile>,
    /// A depth map, with the bounds of its distances.
    pub(super) depth: Option<(PathBuf, [f64; 2])>,
    pub(super) header: Header,
    /// How many times the original was larger, if a reduced photo stands for it.
    pub(super) reduced: usize,
    pub(super) lens: Intrinsics,
    pub(super) distortion: Distortion,
    /// The camera without distortion, at the photo's size.
    pub(super) pinhole: Intrinsics,
}

/// Where a view's pixels come from, until they are asked for.
#[derive(Debug)]
pub struct Unread {
    frame: Frame,
    background: [f32; 3],
    read: OnceLock<View>,
}

impl Unread {
    /// Returns whether a mask is read with the photo.
    pub(super) fn has_mask(&self) -> bool {
        self.frame.mask.is_some()
    }
}

impl Frame {
    /// Creates the frame of a file with this header, whose size the lens is for. Returns `None` if its distortion cannot be
    /// undone.
    pub(super) fn new(path: PathBuf, header: Header, lens: Intrinsics, distortion: Distortion) -> Option<Frame> {
        let pinhole = distortion::pinhole(lens, &distortion, header.size)?;
        Some(Frame {
            path,
            pose: [[0.0; 4]; 3],
            mask: None,
            depth: None,
            header,
            reduced: 1,
            lens,
            distortion,
            pinhole,
        })
    }

    /// Returns width and height of the photo for which the lens is given.
    pub fn size(&self) -> (usize, usize) {
        self.header.size
    }

    /// Returns whether distortion is removed.
    pub(super) fn is_bent(&self) -> bool {
        !self.distortion.is_none()
    }

    /// Returns the zoom of removing it.
    pub(super) fn zoom(&self) -> f64 {
        self.pinhole.focal[0] / self.lens.focal[0]
    }

    /// Returns the pinhole camera at the working resolution. `scaled(value, to, from)` converts a number of pixels.
    pub fn camera(&self, (width, height): (usize, usize), scaled: fn(f64, f64, f64) -> f64) -> Camera {
        let to = [width as f64, height as f64];
        let from = [self.size().0 as f64, self.size().1 as f64];
        let both = |values: [f64; 2]| std::array::from_fn(|i| scaled(values[i], to[i], from[i]));
        let Intrinsics { focal, centre } = self.pinhole;
        Camera { width, height, focal: both(focal), centre: both(centre), pose: self.pose }
    }

    /// Returns the photo at the working resolution, RGB or RGBA. Distortion is removed before averaging down.
    fn image(&self, (width, height): (usize, usize)) -> Result<Image> {
        let mut decoded = images::decode(&self.path)?;
        decoded.apply_orientation(self.header.turn());
        if !self.is_bent() {
            return Ok(images::averaged(&decoded, (width, height)));
        }
        let stored = images::averaged(&decoded, self.size());
        drop(decoded);
        Ok(resample::shrink(&self.rectified(stored), width, height))
    }

    /// Returns the pinhole camera's image from one of the photo's size.
    pub(super) fn rectified(&self, image: Image) -> Image {
        match self.is_bent() {
            true => distortion::rectify(&image, self.lens, &self.distortion, self.pinhole),
            false => image,
        }
    }

    /// Returns which pixels count at the working resolution, if there is a mask.
    fn read_mask(&self, size: (usize, usize)) -> Result<Option<Vec<bool>>> {
        self.mask.as_ref().map(|mask| mask.read(self, size)).transpose()
    }

    /// Returns the view, and whether anything of its photo is transparent.
    fn view(&self, name: &str, camera: Camera, background: [f32; 3]) -> Result<(View, bool)> {
        let size = (camera.width, camera.height);
        let (image, clear) = resample::composite(self.image(size)?, background);
        let mask: Option<Arc<[bool]>> = self.read_mask(size)?.map(Into::into);
        let map = self.depth.as_ref().filter(|_| !self.is_bent() && !self.header.turned);
        let mut depth = map.map(|(map, bounds)| depth::read(map, &camera, *bounds)).transpose()?.flatten();
        if let (Some(depth), Some(mask)) = (&mut depth, &mask) {
            depth.iter_mut().zip(mask.iter()).filter(|(_, counts)| !**counts).for_each(|(depth, _)| *depth = f32::NAN);
        }
        Ok((View { depth, mask, ..View::new(name, camera, image) }, clear))
    }

    /// Returns the view without its pixels.
    fn unread(&self, name: &str, camera: Camera, background: [f32; 3]) -> View {
        let none = Image { width: camera.width, height: camera.height, channels: 3, pixels: Vec::new() };
        let unread = Unread { frame: self.clone(), background, read: OnceLock::new() };
        View { unread: Some(unread.into()), ..View::new(name, camera, none) }
    }

    /// Returns the bytes that reading takes at most at a time.
    fn bytes(&self) -> f64 {
        // Samples of up to 16 bits with alpha; two images of floats while distortion is removed.
        let ((width, height), pixel) = (self.size(), if self.is_bent() { 32.0 } else { 8.0 });
        width as f64 * height as f64 * pixel
    }
}

impl View {
    /// Creates a view without reference depth and mask.
    pub fn new(name: impl Into<String>, camera: Camera, image: impl Into<Arc<Image>>) -> View {
        View { name: name.into(), camera, image: image.into(), depth: None, mask: None, unread: None }
    }

    /// Returns the view with its pixels, which are read if they are not yet ([`Photos::Later`]). They are kept for the next time.
    ///
    /// # Errors
    /// The photo, its mask or its depth map cannot be read.
    pub fn read(&self) -> Result<View> {
        let Some(unread) = &self.unread else { return Ok(self.clone()) };
        if unread.read.get().is_none() {
            let read = unread.frame.view(&self.name, self.camera, unread.background)?.0;
            // Another thread may have been first.
            unread.read.set(read).ok();
        }
        Ok(View { name: self.name.clone(), camera: self.camera, ..unread.read.get().expect("just read").clone() })
    }

    /// Returns whether reference depth is known, or a map of it is there.
    pub fn has_depth(&self) -> bool {
        self.depth.is_some() || self.unread.as_ref().is_some_and(|unread| unread.frame.depth.is_some())
    }
}

/// How the pixels of frames become views.
#[derive(Clone, Copy)]
pub(super) struct Reading<'a> {
    /// The scene's folder.
    pub(super) scene: &'a Path,
    /// Colour behind transparent pixels, and whether the scene has it in any case.
    pub(super) background: ([f32; 3], bool),
    pub(super) photos: Photos,
    /// What they are, as in "test photos".
    pub(super) what: &'a str,
    pub(super) events: &'a dyn Listener,
}

/// Returns the views of frames with these names, through their cameras. The flag says whether anything is transparent.
///
/// # Errors
/// A file cannot be read; memory is missing.
pub(super) fn views(frames: &[Frame], names: &[String], cameras: &[Camera], how: Reading) -> Result<(Vec<View>, bool)> {
    let ((background, known), label) = (how.background, format!("reading {}", how.what));
    let view = |i: usize| frames[i].view(&names[i], cameras[i], background);
    let (views, clear) = match how.photos {
        Photos::Read => {
            images::check_memory_of(&cameras.iter().map(|camera| (camera.width, camera.height)).collect::<Vec<_>>())?;
            let bytes = frames.iter().map(|frame| (&*frame.path, frame.bytes()));
            let read = images::each(&bytes.collect::<Vec<_>>(), &label, how.events, view)?;
            let (views, clear): (Vec<View>, Vec<bool>) = read.into_iter().unzip();
            (views, clear.contains(&true))
        }
        Photos::Later => {
            let mut rest = (0..frames.len()).filter(|i| frames[*i].header.has_alpha);
            let mut clear = rest.next().map(&view).transpose()?.is_some_and(|(_, clear)| clear);
            // An opaque one tells nothing of the others.
            if !clear && !known {
                let rest: Vec<usize> = rest.collect();
                let files: Vec<_> = rest.iter().map(|i| (&*frames[*i].path, frames[*i].bytes())).collect();
                clear = images::each(&files, &label, how.events, |at| Ok(view(rest[at])?.1))?.contains(&true);
            }
            // A mask that hides everything is an error; so are often all.
            let masked = frames.iter().zip(cameras).find(|(frame, _)| frame.mask.is_some());
            masked.map(|(frame, camera)| frame.read_mask((camera.width, camera.height))).transpose()?;
            let unread =
                |((frame, name), camera): ((&Frame, &String), &Camera)| frame.unread(name, *camera, background);
            (frames.iter().zip(names).zip(cameras).map(unread).collect(), clear)
        }
    };
    note_turned(frames, how);
    Ok((views, clear))
}

/// Notes which photos are turned by their EXIF orientation, and which are not in spite of it.
fn note_turned(frames: &[Frame], how: Reading) {
    for (turned, words) in [
        (true, "is applied, since only turned they fit their cameras"),
        (
            false,
            "is not applied (pixels are taken as they are stored, as COLMAP takes them, unless only turned they fit their cameras)",
        ),
    ] {
        let is_of = |frame: &&Frame| frame.header.exif != Orientation::NoTransforms && frame.header.turned == turned;
        let of: Vec<&Path> = frames.iter().filter(is_of).map(|frame| &*frame.path).collect();
        if !of.is_empty() {
            let (scene, count, names) = (how.scene.display(), of.len(), named(how.scene, &of));
            how.events.on(Event::Note(&format!(
                "{scene}: {count} photographs have an EXIF orientation, which {words}: {names}"
            )));
        }
    }
}

/// Returns the names of files of a scene, of the first if there are many.
pub(super) fn named(scene: &Path, paths: &[&Path]) -> String {
    let names = paths.iter().map(|path| path.strip_prefix(scene).unwrap_or(path).to_string_lossy());
    first_names(&names.collect::<Vec<_>>(), NAMES)
}

/// Notes what was found of images and lenses, for people.
pub(super) fn note_images(space: &mut SceneSpace, frames: &[&Frame], target: (usize, usize)) {
    let first = frames[0];
    let differ = frames.iter().any(|frame| frame.size() != first.size());
    let differ = if differ { " (the first; sizes differ)" } else { "" };
    space.note("images", images::folder_words(std::slice::from_ref(&first.path), first.size(), target) + differ);
}

/// Notes whether distortion is removed, for people.
pub(super) fn note_distortion(space: &mut SceneSpace, frames: &[&Frame]) {
    let zoom = frames.iter().map(|frame| frame.zoom()).fold(1.0, f64::max);
    let undone = frames.iter().filter(|frame| frame.is_bent()).count();
    let words =
        if undone == 0 { "none".into() } else { format!("undone in {undone} images, zoomed in by up to {zoom:.3}") };
    space.note("distortion", words);
}
