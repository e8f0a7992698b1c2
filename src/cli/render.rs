//! `augnerf render`.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde_json::json;

use crate::base::files::AtomicDir;
use crate::base::{Error, Event, Listener, Result};
use crate::data::cameras::{self, MOST_PIXELS};
use crate::data::{Camera, View};
use crate::draw::write_mp4;
use crate::run::{OpenOptions, PathPictures, Pictures, RunDir, Trained, Viewer};
use crate::runtime::{Runtime, free_memory_mib};

use super::answer::Answer;
use super::compare::pictures_folder;
use super::progress::{Console, open_next};
use super::{Compute, Moved, whole};

mod serve;

pub const EXAMPLES: &str = "Examples:
  augnerf render RUN --frames 30 --resolution 320x240  # the scene's camera path as GIF
  augnerf render RUN --cameras path.json               # your own path; --write-cameras writes one
  augnerf render RUN --serve --out DIR                 # cameras that another program asks for

Poses are camera to world, with the axes right, up, back, in the units of the scene's files.
The axes in a transforms.json are those of the run's data.axes.";

/// What is wrong with a camera in a scene in NDC, after its name.
const LOOKS_AWAY: &str = "looks away from the -z axis, so its rays have no normalized device coordinates; turn it, or train \
                          with data.ndc=false";

/// Frames per second if neither the command line nor a camera file says it.
const FPS: f64 = 15.0;

#[derive(Args)]
#[command(next_help_heading = "Experiment")]
pub struct RenderArguments {
    /// Run folder (newest checkpoint)
    run: PathBuf,
    /// Views to render
    #[arg(long, value_enum, default_value_t = What::Path)]
    what: What,
    /// Render the cameras of a file: camera_path.json (nerfstudio) or transforms.json
    #[arg(long, value_name = "FILE")]
    cameras: Option<PathBuf>,
    #[command(flatten)]
    sources: Moved,
    /// Frames of the path, evenly spaced [default: all]
    #[arg(long, value_name = "N", value_parser = whole::<u16>(1..=u16::MAX.into()), help_heading = "Output")]
    frames: Option<u16>,
    /// Columns and rows of an image; the vertical field of view stays [default: those of the run or camera file]
    #[arg(long, value_name = "WxH", help_heading = "Output")]
    resolution: Option<String>,
    /// Frames per second of GIF and MP4 [default: those of the camera file, or 15]
    #[arg(long, value_name = "N", help_heading = "Output")]
    fps: Option<f64>,
    /// Output folder [default: RUN/renders/path or RUN/renders/views]
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out: Option<PathBuf>,
    /// Write the cameras to a file (camera_path.json) and render nothing
    #[arg(long, value_name = "FILE", conflicts_with = "out", help_heading = "Output")]
    write_cameras: Option<PathBuf>,
    /// Render each camera that a line of JSON on standard input asks for, and answer with a line of JSON
    #[arg(long, requires = "out", conflicts_with_all = NOT_SERVED, help_heading = "Output")]
    serve: bool,
    #[command(flatten)]
    answer: Answer,
    #[command(flatten)]
    compute: Compute,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum What {
    /// The scene's camera path: a spiral, a circle or a swing
    Path,
    /// All held-out views next to their ground truth
    Views,
}

/// Flags of cameras that are known before the start.
const NOT_SERVED: [&str; 7] = ["what", "cameras", "frames", "resolution", "fps", "write_cameras", "json"];

/// The cameras to render, in order.
struct Shots {
    cameras: Vec<Camera>,
    fps: f64,
}

impl RenderArguments {
    pub fn run(self) -> Result<()> {
        if let Some(fps) = self.fps.filter(|fps| !(fps.is_finite() && (0.1..=50.0).contains(fps))) {
            return Err(Error::Config(format!("--fps {fps}: out of range; choose 0.1 to 50")));
        }
        let size = self.resolution.as_deref().map(parse_size).transpose()?;
        let of_path = [size.is_some(), self.frames.is_some(), self.fps.is_some()];
        if self.what == What::Views
            && (self.cameras.is_some() || self.write_cameras.is_none() && of_path.contains(&true))
        {
            return Err(Error::Config(
                "--what views: renders all held-out views at their size; omit it to use --cameras, --resolution, --frames or --fps"
                    .into(),
            ));
        }
        self.compute.run(|runtime, console| self.render(size, runtime, console))
    }

    fn render(&self, size: Option<(usize, usize)>, runtime: &Runtime, console: &Console) -> Result<()> {
        let served = self.out.as_deref().filter(|_| self.serve);
        served.map_or(Ok(()), AtomicDir::check_vacant)?;
        let data = self.sources.data.as_deref();
        let trained = Trained::open_at(&self.run, OpenOptions::CAMERAS, data, runtime, console)?;
        if let Some(folder) = served {
            return serve::serve(trained, folder);
        }
        let shots = self.shots(&trained, size, console)?;
        if let Some(file) = &self.write_cameras {
            cameras::write(file, &shots.cameras, &trained.scene.space.world, shots.fps)?;
            console.say(&format!("{} cameras", shots.cameras.len()));
            return self.tell(&trained, (None, file), shots.cameras.len(), console);
        }
        if self.what == What::Path {
            video_size(&shots)?;
        }
        let renders = RunDir::renders_in(trained.run.path());
        let default = match self.what {
            What::Path => renders.join("path"),
            What::Views => renders.join("views"),
        };
        let (folder, pictures) = pictures_folder(self.out.as_deref(), default)?;
        let viewer = trained.viewer();
        let videos = match self.what {
            What::Views => views(viewer, pictures.path(), console).map(|()| None)?,
            What::Path => path(viewer, &shots, pictures.path(), console).map(Some)?,
        };
        pictures.commit()?;
        console.on(Event::Finished);
        videos.iter().for_each(|videos| console.say(videos));
        self.tell(&trained, (Some(&folder), &folder), shots.cameras.len(), console)
    }

    /// Prints the result: a folder of images, or a file of cameras.
    fn tell(
        &self,
        trained: &Trained,
        (folder, made): (Option<&Path>, &Path),
        frames: usize,
        console: &Console,
    ) -> Result<()> {
        let name = |path: &Path| path.display().to_string();
        let (run, cameras) = (name(&self.run), self.write_cameras.as_deref().map(name));
        let (step, folder) = (trained.state.step, folder.map(name));
        let answer = json!({ "run": run, "step": step, "folder": folder, "cameras": cameras, "frames": frames });
        self.answer.give_place(&answer, made)?;
        if let Some(folder) = folder {
            let folder = Path::new(&folder);
            let film = ["rgb.mp4", "rgb.gif"].map(|name| folder.join(name)).into_iter().find(|film| film.is_file());
            let beside = trained.scene.test.first().map(|view| folder.join(format!("{}_beside.png", view.name)));
            let first: Vec<_> = film.into_iter().chain(beside).collect();
            open_next(console, &first, &format!("augnerf report {run}"));
        }
        Ok(())
    }

    /// Returns the requested cameras.
    fn shots(&self, trained: &Trained, size: Option<(usize, usize)>, console: &Console) -> Result<Shots> {
        let scene = &trained.scene;
        let like = scene.test.first().or(scene.train.first()).map(|view: &View| view.camera);
        let (all, fps) = match (&self.cameras, self.what, like) {
            (Some(file), _, Some(like)) => {
                let (world, axes) = (&scene.space.world, trained.config.data.axes);
                let read = cameras::read(file, &like, world, axes)?;
                (read.cameras, read.fps)
            }
            (_, What::Views, _) => (scene.test.iter().map(|view| view.camera).collect(), None),
            _ => (scene.path.clone(), None),
        };
        if all.is_empty() {
            return Err(Error::Data(format!("scene {}: no camera path; use --what views or --cameras", scene.name)));
        }
        let count = self.frames.map_or(all.len(), usize::from);
        if count > all.len() {
            console.say(&format!("--frames {count}: the path has {} cameras; each is rendered once", all.len()));
        }
        let cameras: Vec<Camera> = chosen(&all, count.min(all.len()))
            .map(|camera| size.map_or(*camera, |(width, height)| camera.with_size(width, height)))
            .collect();
        if let (Some(index), Some(_)) = (cameras.iter().position(|camera| !camera.faces_forward()), scene.ndc) {
            return Err(Error::Data(format!("camera {index} (from 0): {LOOKS_AWAY}")));
        }
        // A GIF shows at most 50 frames per second.
        let fps = self.fps.or(fps.map(|fps| fps.clamp(0.1, 240.0))).unwrap_or(FPS);
        Ok(Shots { cameras, fps })
    }
}

/// Renders the held-out views next to their ground truth.
fn views(viewer: Viewer, folder: &Path, console: &Console) -> Result<()> {
    let views = &viewer.scene.test;
    let pictures = Pictures::new(folder, viewer.scene, views.len());
    console.on(Event::Started { what: "rendering", parts: views.len() as u64 });
    let renderer = viewer.renderer()?;
    for (index, view) in views.iter().enumerate() {
        let rendered = viewer.render_with(&*renderer, &view.camera)?;
        console.on(Event::Advanced);
        pictures.write(index, &view.read()?, &rendered)?;
    }
    pictures.finish()
}

/// Returns the size of all frames of a video.
///
/// # Errors
/// The cameras have several sizes, or the frames' depth does not fit into free memory.
fn video_size(shots: &Shots) -> Result<(usize, usize)> {
    let size = |camera: &Camera| (camera.width, camera.height);
    let (first, cameras) = (size(&shots.cameras[0]), &shots.cameras);
    if let Some(other) = cameras.iter().position(|camera| size(camera) != first) {
        let (a, b) = (first, size(&cameras[other]));
        return Err(Error::Data(format!(
            "camera {other} (from 0): {}x{} pixels, but the first has {}x{}; choose one size with --resolution {}x{}",
            b.0, b.1, a.0, a.1, a.0, a.1
        )));
    }
    let needed = (cameras.len() * PathPictures::PIXEL_BYTES) as f64 * (first.0 * first.1) as f64 / f64::from(1 << 20);
    if let Some(free) = free_memory_mib().filter(|free| needed > *free) {
        return Err(Error::Config(format!(
            "{} frames of {} x {} pixels: their depth takes {:.1} GiB of memory, and {:.1} GiB are free; choose fewer with \
             --frames or smaller ones with --resolution",
            cameras.len(),
            first.0,
            first.1,
            needed / 1024.0,
            free / 1024.0
        )));
    }
    Ok(first)
}

/// Renders the frames of a video, and returns which videos it wrote.
fn path(viewer: Viewer, shots: &Shots, folder: &Path, console: &Console) -> Result<String> {
    let Shots { cameras, fps } = shots;
    let mut pictures = PathPictures::begin(folder, viewer.scene, video_size(shots)?, cameras.len(), *fps)?;
    console.on(Event::Started { what: "rendering", parts: cameras.len() as u64 });
    let renderer = viewer.renderer()?;
    for camera in cameras {
        pictures.add(viewer.render_with(&*renderer, camera)?)?;
        console.on(Event::Advanced);
    }
    pictures.finish()?;
    let mut written = "rgb.gif and depth.gif".to_string();
    for name in ["rgb", "depth"] {
        match write_mp4(folder, name, *fps) {
            Ok(()) => written = format!("{name}.mp4, {written}"),
            Err(reason) => return Ok(format!("videos: {written}; {reason}")),
        }
    }
    Ok(format!("videos: {written}"))
}

/// Parses columns and rows of an image, such as `320x240`.
fn parse_size(text: &str) -> Result<(usize, usize)> {
    let sides =
        text.split_once(['x', 'X']).and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    let valid = |side: usize| (1..=MOST_PIXELS).contains(&side);
    sides.filter(|&(width, height)| valid(width) && valid(height)).ok_or_else(|| {
        Error::Config(format!(
            "--resolution {text}: not a size; give columns and rows, 1 to {MOST_PIXELS} each, such as 320x240"
        ))
    })
}

/// Returns `count` of the cameras, evenly spaced.
fn chosen(cameras: &[Camera], count: usize) -> impl Iterator<Item = &Camera> {
    (0..count).map(move |i| &cameras[i * cameras.len() / count])
}
