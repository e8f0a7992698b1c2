//! The pictures that training and rendering leave.

use std::cell::RefCell;
use std::path::Path;

use serde::Serialize;

use crate::base::files::write_json;
use crate::base::{Image, Result};
use crate::data::{Scene, View};
use crate::draw::{SOLID, beside, depth_colour, depth_range, write_depth16, write_gif, write_mp4, write_png8};

use super::RenderedView;

/// Pixels between pictures that stand side by side.
const GAP: usize = 4;

/// What the 16-bit depth pictures of a folder mean: `depth.json`.
#[derive(Serialize)]
struct DepthScale {
    /// depth = value / 65535 * max; the value 0 is no depth.
    max: f32,
    /// `NDC` or `scene units along the view axis`.
    unit: &'static str,
    /// The colours' range: nearest and farthest.
    colours: Option<(f32, f32)>,
}

impl DepthScale {
    fn new(scene: &Scene, range: Option<(f32, f32)>) -> DepthScale {
        let unit = if scene.ndc.is_some() { "NDC" } else { "scene units along the view axis" };
        DepthScale { max: scene.far as f32, unit, colours: range }
    }
}

/// Depth where something was accumulated, NaN elsewhere.
fn solid_depth(view: &RenderedView) -> Vec<f32> {
    view.depth.iter().zip(&view.acc).map(|(&depth, &acc)| if acc >= SOLID { depth } else { f32::NAN }).collect()
}

fn depth_picture(view: &RenderedView, (near, far): (f32, f32)) -> Result<Image> {
    let Image { width, height, .. } = view.image;
    depth_colour(&view.depth, width, height, near, far, Some(&view.acc))
}

/// White where a pixel counts, black elsewhere.
fn mask_picture(mask: &[bool], width: usize, height: usize) -> Image {
    let pixels = mask.iter().flat_map(|&counts| [f32::from(u8::from(counts)); 3]).collect();
    Image { width, height, channels: 3, pixels }
}

/// Puts diagonal stripes, half grey and half the picture darkened, over what is masked.
fn stripe(picture: &mut Image, mask: &[bool]) {
    /// Pixels across two stripes.
    const PERIOD: usize = 8;
    let width = picture.width;
    for (at, texel) in picture.pixels.chunks_exact_mut(3).enumerate().filter(|(at, _)| !mask[*at]) {
        let bright = (at % width + at / width) % PERIOD < PERIOD / 2;
        texel.iter_mut().for_each(|value| *value = if bright { 0.6 } else { 0.4 * *value });
    }
}

/// Frames of a path: `rgb_000.png`, `depth_000.png` (colours), `depth16_000.png`, `rgb.gif`,
/// `depth.gif`, `depth.json`, and with the feature `mp4` `rgb.mp4`, `depth.mp4`.
pub fn write_path(folder: &Path, scene: &Scene, frames: &[RenderedView], fps: f64) -> Result<()> {
    // One range for all frames, so that a colour means the same depth throughout.
    let depths: Vec<f32> = frames.iter().flat_map(|frame| frame.depth.iter().copied()).collect();
    let accs: Vec<f32> = frames.iter().flat_map(|frame| frame.acc.iter().copied()).collect();
    let range = depth_range(&depths, Some(&accs));
    let scale = DepthScale::new(scene, range);
    let mut pictures = Vec::with_capacity(frames.len());
    for (index, frame) in frames.iter().enumerate() {
        let Image { width, height, .. } = frame.image;
        write_png8(&folder.join(format!("rgb_{index:03}.png")), &frame.image)?;
        let path = folder.join(format!("depth16_{index:03}.png"));
        write_depth16(&path, &solid_depth(frame), width, height, scale.max)?;
        let picture = depth_picture(frame, range.unwrap_or((scene.near as f32, scene.far as f32)))?;
        write_png8(&folder.join(format!("depth_{index:03}.png")), &picture)?;
        pictures.push(picture);
    }
    let colours: Vec<Image> = frames.iter().map(|frame| frame.image.clone()).collect();
    for (name, frames) in [("rgb", &colours), ("depth", &pictures)] {
        write_gif(&folder.join(format!("{name}.gif")), frames, fps)?;
        write_mp4(&folder.join(format!("{name}.mp4")), frames, fps)?;
    }
    write_json(&folder.join("depth.json"), &scale)
}

/// Pictures of held-out views: `NAME_rgb.png`, `NAME_truth.png`, `NAME_depth.png`,
/// `NAME_depth16.png`, `NAME_beside.png` (render, truth, depth) and `depth.json`; of a masked one `NAME_mask.png` (white
/// counts), too, and beside the others the truth is striped where it is masked.
pub struct Pictures<'a> {
    folder: &'a Path,
    scene: &'a Scene,
    count: usize,
    range: RefCell<Option<(f32, f32)>>,
}

impl<'a> Pictures<'a> {
    /// Of the first `count` views.
    pub fn new(folder: &'a Path, scene: &'a Scene, count: usize) -> Pictures<'a> {
        Pictures { folder, scene, count, range: RefCell::new(None) }
    }

    /// Writes the pictures of a view, if it is among the first; returns the one of all side by side.
    pub fn write(&self, index: usize, view: &View, rendered: &RenderedView) -> Result<Option<Image>> {
        if index >= self.count {
            return Ok(None);
        }
        let Image { width, height, .. } = rendered.image;
        let file = |what: &str| self.folder.join(format!("{}_{what}.png", view.name));
        // The first view's range colours all.
        let range = *self.range.borrow_mut().get_or_insert_with(|| {
            let range = depth_range(&rendered.depth, Some(&rendered.acc));
            range.unwrap_or((self.scene.near as f32, self.scene.far as f32))
        });
        let colours = depth_picture(rendered, range)?;
        write_png8(&file("rgb"), &rendered.image)?;
        write_png8(&file("truth"), &view.image)?;
        write_png8(&file("depth"), &colours)?;
        write_depth16(&file("depth16"), &solid_depth(rendered), width, height, self.scene.far as f32)?;
        let mut truth = view.image.as_ref().clone();
        if let Some(mask) = &view.mask {
            write_png8(&file("mask"), &mask_picture(mask, width, height))?;
            stripe(&mut truth, mask);
        }
        let all = beside(&[&rendered.image, &truth, &colours], GAP)?;
        write_png8(&file("beside"), &all)?;
        Ok(Some(all))
    }

    /// Writes `depth.json`.
    pub fn finish(&self) -> Result<()> {
        if self.count == 0 {
            return Ok(());
        }
        write_json(&self.folder.join("depth.json"), &DepthScale::new(self.scene, *self.range.borrow()))
    }
}
