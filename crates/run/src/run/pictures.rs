//! Images that training and rendering write.

use std::cell::RefCell;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::base::files::{remove, write_json};
use crate::base::{Error, Image, Result};
use crate::data::{Scene, View};
use crate::draw::{Reel, SOLID, beside, depth_colour, depth_range, depth_range_of, stripe, write_depth16, write_png8};

use super::RenderedView;

/// Pixels between images side by side.
const GAP: usize = 4;

/// `depth.json`: the meaning of the 16-bit depth images of a folder.
#[derive(Serialize)]
struct DepthScale {
    /// depth = value / 65535 * max; the value 0 is no depth.
    max: f32,
    /// `NDC` or `scene units along the view axis`.
    unit: &'static str,
    /// Nearest and farthest depth of the colour scale.
    colours: Option<(f32, f32)>,
}

impl DepthScale {
    fn new(scene: &Scene, range: Option<(f32, f32)>) -> DepthScale {
        let unit = if scene.ndc.is_some() { "NDC" } else { "scene units along the view axis" };
        DepthScale { max: scene.far as f32, unit, colours: range }
    }
}

/// Returns the depth where something was accumulated, NaN elsewhere.
fn solid_depth(view: &RenderedView) -> Vec<f32> {
    view.depth.iter().zip(&view.acc).map(|(&depth, &acc)| if acc >= SOLID { depth } else { f32::NAN }).collect()
}

fn depth_picture(view: &RenderedView, (near, far): (f32, f32)) -> Result<Image> {
    let Image { width, height, .. } = view.image;
    depth_colour(&view.depth, width, height, near, far, Some(&view.acc))
}

/// Returns an image that is white where a pixel counts, black elsewhere.
fn mask_picture(mask: &[bool], width: usize, height: usize) -> Image {
    let pixels = mask.iter().flat_map(|&counts| [f32::from(u8::from(counts)); 3]).collect();
    Image { width, height, channels: 3, pixels }
}

/// Frames of a path, written as they come: `rgb_000.png`, `depth_000.png` (colours), `depth16_000.png`, `rgb.gif`,
/// `depth.gif` and `depth.json`. Only depth stays in memory, since its colours depend on the range of all frames.
pub struct PathPictures<'a> {
    folder: &'a Path,
    scene: &'a Scene,
    size: (usize, usize),
    fps: f64,
    rgb: Reel,
    depths: Vec<Depth>,
}

/// Depth and accumulation of a frame.
struct Depth {
    depth: Vec<f32>,
    acc: Vec<f32>,
}

impl<'a> PathPictures<'a> {
    /// Bytes for each pixel until the last frame: depth and accumulation, and depth again while the range is computed.
    pub const PIXEL_BYTES: usize = 3 * size_of::<f32>();

    /// Starts `frames` frames of a size (width, height), at `fps` frames a second.
    pub fn begin(folder: &'a Path, scene: &'a Scene, size: (usize, usize), frames: usize, fps: f64) -> Result<Self> {
        let rgb = Reel::begin(&folder.join("rgb.gif"), size, fps)?;
        Ok(PathPictures { folder, scene, size, fps, rgb, depths: Vec::with_capacity(frames) })
    }

    /// Writes the next frame.
    pub fn add(&mut self, frame: RenderedView) -> Result<()> {
        let (index, (width, height)) = (self.depths.len(), self.size);
        write_png8(&self.folder.join(format!("rgb_{index:03}.png")), &frame.image)?;
        let path = self.folder.join(format!("depth16_{index:03}.png"));
        write_depth16(&path, &solid_depth(&frame), width, height, self.scene.far as f32)?;
        self.rgb.add(&frame.image)?;
        self.depths.push(Depth { depth: frame.depth, acc: frame.acc });
        Ok(())
    }

    /// Writes the colours of depth. All frames share one range, so that a colour means the same depth throughout.
    pub fn finish(self) -> Result<()> {
        let PathPictures { folder, scene, size, fps, rgb, depths } = self;
        rgb.finish()?;
        let views: Vec<(&[f32], Option<&[f32]>)> =
            depths.iter().map(|Depth { depth, acc }| (depth.as_slice(), Some(acc.as_slice()))).collect();
        let range = depth_range_of(&views);
        let (near, far) = range.unwrap_or((scene.near as f32, scene.far as f32));
        let mut video = Reel::begin(&folder.join("depth.gif"), size, fps)?;
        for (index, Depth { depth, acc }) in depths.iter().enumerate() {
            let picture = depth_colour(depth, size.0, size.1, near, far, Some(acc))?;
            write_png8(&folder.join(format!("depth_{index:03}.png")), &picture)?;
            video.add(&picture)?;
        }
        video.finish()?;
        write_json(&folder.join("depth.json"), &DepthScale::new(scene, range))
    }
}

/// Images of held-out views: `NAME_rgb.png`, `NAME_truth.png`, `NAME_depth.png`, `NAME_depth16.png`, `NAME_beside.png`
/// (rendering, ground truth and depth) and `depth.json`. A masked view also has `NAME_mask.png` (white counts), and
/// stripes over the masked ground truth in `NAME_beside.png`.
pub struct Pictures<'a> {
    folder: &'a Path,
    scene: &'a Scene,
    count: usize,
    range: RefCell<Option<(f32, f32)>>,
}

/// Returns rendering, ground truth and depth in `colours` side by side.
fn with_truth(mut truth: Image, mask: Option<&[bool]>, rendered: &RenderedView, colours: &Image) -> Result<Image> {
    if let Some(mask) = mask {
        stripe(&mut truth, mask);
    }
    beside(&[&rendered.image, &truth, colours], GAP)
}

impl<'a> Pictures<'a> {
    /// Writes images of the first `count` views.
    pub fn new(folder: &'a Path, scene: &'a Scene, count: usize) -> Pictures<'a> {
        Pictures { folder, scene, count, range: RefCell::new(None) }
    }

    /// Writes the images of a view if it is among the first.
    pub fn write(&self, index: usize, view: &View, rendered: &RenderedView) -> Result<()> {
        if index >= self.count {
            return Ok(());
        }
        let Image { width, height, .. } = rendered.image;
        let file = |what: &str| self.folder.join(format!("{}_{what}.png", view.name));
        // The first view's range colours all views.
        let range = *self.range.borrow_mut().get_or_insert_with(|| self.depth_range(rendered));
        let colours = depth_picture(rendered, range)?;
        write_png8(&file("rgb"), &rendered.image)?;
        write_png8(&file("truth"), &view.image)?;
        write_png8(&file("depth"), &colours)?;
        write_depth16(&file("depth16"), &solid_depth(rendered), width, height, self.scene.far as f32)?;
        if let Some(mask) = &view.mask {
            write_png8(&file("mask"), &mask_picture(mask, width, height))?;
        }
        let all = with_truth(view.image.as_ref().clone(), view.mask.as_deref(), rendered, &colours)?;
        write_png8(&file("beside"), &all)
    }

    fn depth_range(&self, rendered: &RenderedView) -> (f32, f32) {
        let range = depth_range(&rendered.depth, Some(&rendered.acc));
        range.unwrap_or((self.scene.near as f32, self.scene.far as f32))
    }

    /// Returns the path of the image of an unfinished training.
    pub fn preview_path(&self) -> PathBuf {
        self.folder.join("preview.png")
    }

    /// Writes the image of an unfinished training: a rendering of the first view, beside its ground truth and depth.
    pub fn preview(&self, truth: Image, mask: Option<&[bool]>, rendered: &RenderedView) -> Result<()> {
        let range = self.depth_range(rendered);
        let all = with_truth(truth, mask, rendered, &depth_picture(rendered, range)?)?;
        write_png8(&self.preview_path(), &all)
    }

    /// Writes `depth.json` and deletes the image of the unfinished training.
    pub fn finish(&self) -> Result<()> {
        let preview = self.preview_path();
        remove(&preview).map_err(|error| Error::unwritable(&preview, &error))?;
        if self.count == 0 {
            return Ok(());
        }
        write_json(&self.folder.join("depth.json"), &DepthScale::new(self.scene, *self.range.borrow()))
    }
}
