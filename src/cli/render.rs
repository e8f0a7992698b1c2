//! `augnerf render`, and the pictures that training and rendering leave.

use std::cell::RefCell;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde::Serialize;

use crate::data::{Camera, Image, Progress, Scene, View};
use crate::error::{Error, Result};
use crate::evaluate::{RenderedView, Viewer};
use crate::output::{
    AtomicDir, SOLID, beside, depth_colour, depth_range, write_depth16, write_gif, write_json, write_png8,
};

use super::eval::Trained;
use super::progress::Screen;
use super::{Machine, Sources};

/// Pixels between pictures that stand side by side.
const GAP: usize = 4;

#[derive(Args)]
pub struct RenderArguments {
    /// Run folder; its newest checkpoint is rendered
    run: PathBuf,
    /// What to render
    #[arg(long, value_enum, default_value_t = What::Path)]
    what: What,
    /// Frames of the path, evenly chosen [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    frames: Option<u16>,
    /// Frames a second of the GIF
    #[arg(long, default_value_t = 15.0, value_name = "N")]
    fps: f64,
    /// Output folder [default: RUN/renders/path or RUN/renders/views]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    sources: Sources,
    #[command(flatten)]
    machine: Machine,
}

#[derive(Clone, Copy, ValueEnum)]
enum What {
    /// The scene's camera path: a spiral in front of forward-facing scenes, an orbit around others
    Path,
    /// All held-out views beside the truth
    Views,
}

impl RenderArguments {
    pub fn run(self) -> Result<()> {
        if !(self.fps.is_finite() && (0.1..=50.0).contains(&self.fps)) {
            return Err(Error::Config(format!("--fps {} is out of range: it must be 0.1 to 50", self.fps)));
        }
        let device = self.machine.device()?;
        let screen = Screen::new(self.machine.quiet);
        let trained = Trained::open(&self.run, self.sources.data.as_deref(), &device, &screen)?;
        let (scene, renders) = (&trained.scene, trained.run.renders());
        let folder = match (&self.out, self.what) {
            (Some(out), _) => out.clone(),
            (None, What::Path) => renders.join("path"),
            (None, What::Views) => renders.join("views"),
        };
        // All or nothing: an earlier rendering's frames are not left among the new ones. What is not
        // ours is not replaced.
        if self.out.is_some() && std::fs::read_dir(&folder).is_ok_and(|mut entries| entries.next().is_some()) {
            return Err(Error::Output(format!("{} is not empty; give --out a new or empty folder", folder.display())));
        }
        let parent = folder.parent().unwrap_or(Path::new("."));
        std::fs::create_dir_all(parent).map_err(|e| Error::unwritable(parent, &e))?;
        let pictures_dir = AtomicDir::new(&folder)?;
        let viewer = Viewer { model: &trained.model, config: &trained.config, scene, device: &device };
        let render = |camera: &Camera| {
            let rendered = viewer.render(camera);
            screen.advance();
            rendered
        };
        match self.what {
            What::Views => {
                let pictures = Pictures::new(pictures_dir.path(), scene, scene.test.len());
                screen.start("rendering", scene.test.len() as u64);
                for (index, view) in scene.test.iter().enumerate() {
                    pictures.write(index, view, &render(&view.camera)?)?;
                }
                pictures.finish()?;
            }
            What::Path => {
                let cameras = chosen(&scene.path, self.frames.map(usize::from));
                if cameras.is_empty() {
                    return Err(Error::Data(format!("scene {} has no camera path; use --what views", scene.name)));
                }
                screen.start("rendering", cameras.len() as u64);
                let frames = cameras.iter().map(render).collect::<Result<Vec<_>>>()?;
                write_path(pictures_dir.path(), scene, &frames, self.fps)?;
            }
        }
        pictures_dir.commit()?;
        screen.finish();
        screen.say(&format!("pictures: {}", folder.display()));
        Ok(())
    }
}

/// `count` of the cameras, evenly spaced.
fn chosen(cameras: &[Camera], count: Option<usize>) -> Vec<Camera> {
    let count = count.unwrap_or(cameras.len()).min(cameras.len());
    (0..count).map(|i| cameras[i * cameras.len() / count]).collect()
}

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

/// Frames of a path: `rgb_000.png`, `depth_000.png` (colours), `depth16_000.png`, `rgb.gif`,
/// `depth.gif`, `depth.json`.
fn write_path(folder: &Path, scene: &Scene, frames: &[RenderedView], fps: f64) -> Result<()> {
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
    write_gif(&folder.join("rgb.gif"), &colours, fps)?;
    write_gif(&folder.join("depth.gif"), &pictures, fps)?;
    write_json(&folder.join("depth.json"), &scale)
}

/// Pictures of held-out views: `NAME_rgb.png`, `NAME_truth.png`, `NAME_depth.png`,
/// `NAME_depth16.png`, `NAME_beside.png` (render, truth, depth) and `depth.json`.
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
        let all = beside(&[&rendered.image, &view.image, &colours], GAP)?;
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
