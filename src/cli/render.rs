//! `augnerf render`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde_json::json;

use crate::base::{Error, Event, Listener, Result};
use crate::data::Camera;
use crate::run::{Pictures, Trained, write_path};
use crate::runtime::Runtime;

use super::answer::Answer;
use super::compare::pictures_folder;
use super::progress::{Console, duration};
use super::{Compute, Moved};

pub const EXAMPLES: &str = "Examples:
  augnerf render runs/fern-nerf-*                          the scene's camera path
  augnerf render RUN --frames 30 --fps 10                  fewer frames of it
  augnerf render RUN --what views                          the held-out views beside the truth";

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
    sources: Moved,
    #[command(flatten)]
    compute: Compute,
    #[command(flatten)]
    answer: Answer,
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
        let runtime = self.compute.runtime()?;
        runtime.install(|| self.render(&runtime))
    }

    fn render(&self, runtime: &Runtime) -> Result<()> {
        let console = Console::new(self.compute.quiet);
        let trained = Trained::open(&self.run, self.sources.data.as_deref(), runtime, &console)?;
        let (scene, renders) = (&trained.scene, trained.run.renders());
        let default = match self.what {
            What::Path => renders.join("path"),
            What::Views => renders.join("views"),
        };
        let (folder, pictures_dir) = pictures_folder(self.out.as_deref(), default)?;
        let viewer = trained.viewer();
        let render = |camera: &Camera| {
            let rendered = viewer.render(camera);
            console.on(Event::Advanced);
            rendered
        };
        let cameras: Vec<&Camera> = match self.what {
            What::Path => chosen(&scene.path, self.frames.map(usize::from)),
            What::Views => scene.test.iter().map(|view| &view.camera).collect(),
        };
        if let Some(seconds) = viewer.estimate_seconds(&cameras)? {
            console.say(&expected(&cameras, seconds));
        }
        match self.what {
            What::Views => {
                let pictures = Pictures::new(pictures_dir.path(), scene, scene.test.len());
                console.on(Event::Started { what: "rendering", parts: scene.test.len() as u64 });
                for (index, view) in scene.test.iter().enumerate() {
                    pictures.write(index, view, &render(&view.camera)?)?;
                }
                pictures.finish()?;
            }
            What::Path => {
                if cameras.is_empty() {
                    return Err(Error::Data(format!("scene {} has no camera path; use --what views", scene.name)));
                }
                console.on(Event::Started { what: "rendering", parts: cameras.len() as u64 });
                let frames = cameras.iter().map(|camera| render(camera)).collect::<Result<Vec<_>>>()?;
                write_path(pictures_dir.path(), scene, &frames, self.fps)?;
            }
        }
        pictures_dir.commit()?;
        console.on(Event::Finished);
        console.say(&format!("pictures: {}", folder.display()));
        let (run, folder) = (self.run.display().to_string(), folder.display().to_string());
        let answer = json!({ "run": run, "step": trained.state.step, "folder": folder, "frames": cameras.len() });
        self.answer.give_silently(&answer)
    }
}

/// `count` of the cameras, evenly spaced.
fn chosen(cameras: &[Camera], count: Option<usize>) -> Vec<&Camera> {
    let count = count.unwrap_or(cameras.len()).min(cameras.len());
    (0..count).map(|i| &cameras[i * cameras.len() / count]).collect()
}

/// What rendering will take, in words.
fn expected(cameras: &[&Camera], seconds: f64) -> String {
    let Camera { width, height, .. } = *cameras[0];
    let each = seconds / cameras.len() as f64;
    let each = if each < 10.0 { format!("{each:.1} s") } else { duration(each) };
    let (views, each) = match cameras.len() {
        1 => ("1 view".to_string(), String::new()),
        count => (format!("{count} views"), format!("{each} each, ")),
    };
    format!("{views} of {width} x {height} pixels: about {each}{} in all", duration(seconds))
}
