//! `augnerf data`.

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use clap::{Args, Subcommand};
use serde::Serialize;
use serde_json::json;

use crate::base::files::{AtomicDir, write_named};
use crate::base::{Error, Event, Listener, Result};
use crate::data::corruption::corrupt;
use crate::data::formats::builtin::export;
use crate::data::{Photos, Scene, View, images};
use crate::run::{load_scene, load_scene_with, scene_picture, split_name, write_corrupted};
use crate::settings::{Resolved, build};

use super::answer::Answer;
use super::experiment::{Experiment, data_settings, say_without_effect, scene_settings};
use super::progress::{Console, print, print_shown};

#[derive(Subcommand)]
pub enum DataCommand {
    /// Show what a scene folder holds and how it is used
    #[command(after_help = CHECK_EXAMPLES)]
    Check(CheckArguments),
    /// Write the training views with the corruption of section data.corruption
    #[command(after_help = CORRUPT_EXAMPLES)]
    Corrupt(CorruptArguments),
    /// Write the built-in scene in Blender format, with depth and mesh
    #[command(after_help = EXPORT_EXAMPLES)]
    ExportBuiltin(ExportArguments),
}

#[derive(Args)]
pub struct CheckArguments {
    /// Scene folder, here or in AUGNERF_DATA [default: the built-in scene]
    dir: Option<PathBuf>,
    /// A setting of section data, as in training, or seed: --set data.downscale=4; with --picture also regularizer.kind,
    /// regularizer.rays and regularizer.unseen_poses
    #[arg(long, value_name = "FIELD=VALUE")]
    set: Vec<String>,
    /// Draw cameras, points, ray ends and the box into an SVG
    #[arg(long, value_name = "FILE.svg")]
    picture: Option<PathBuf>,
    /// Decode all photos, not only their headers, and print the hash of their pixels
    #[arg(long)]
    pixels: bool,
    /// Print errors and the paths of results only
    #[arg(long, short)]
    quiet: bool,
    #[command(flatten)]
    answer: Answer,
}

const CHECK_EXAMPLES: &str = "Examples:
  augnerf data check                                     # the built-in scene
  augnerf data check fern --picture fern.svg             # with a drawing of the cameras
  augnerf data check ~/data/fern --set data.downscale=4  # as training with this setting reads it";

/// The settings outside section data that a check reads: the seed of corruptions and of unseen cameras, and for an image what
/// says whether and where there are such cameras.
const CHECKED: [&str; 1] = ["seed"];
const DRAWN: [&str; 4] = ["seed", "regularizer.kind", "regularizer.rays", "regularizer.unseen_poses"];
const CHECK_READS: &str = "data check, which reads section data and seed, and with --picture also regularizer.kind, \
                           regularizer.rays and regularizer.unseen_poses";

const EXPORT_EXAMPLES: &str = "Examples:
  augnerf data export-builtin scene              # then: augnerf train --data scene
  augnerf data export-builtin scene --width 400  # wider views
  augnerf data export-builtin other --scene 17   # the objects of --data builtin:17";

const CORRUPT_EXAMPLES: &str = "Examples:
  augnerf data corrupt noisy --data fern --set data.corruption.kind=gaussian-noise
  augnerf data corrupt moved --data fern --set data.corruption.kind=poses --seed 1
  augnerf data corrupt seen --config RUN/config.toml  # the training views of a run

Writes views/NAME.png, beside.png (the first view, clean and corrupted), views.csv (for each view the PSNR to the clean \
one in dB, and its camera's rotation in degrees and shift in scene units) and corruption.json. Training with the same \
settings and seed uses the same pixels. Held-out views stay clean.";

#[derive(Args)]
pub struct CorruptArguments {
    /// New or empty folder
    dir: PathBuf,
    #[command(flatten)]
    experiment: Experiment,
    /// Print errors and the paths of results only
    #[arg(long, short, help_heading = "Output")]
    quiet: bool,
    #[command(flatten)]
    answer: Answer,
}

#[derive(Args)]
pub struct ExportArguments {
    /// New or empty folder
    dir: PathBuf,
    /// Width and height of the views in pixels
    #[arg(long, default_value_t = export::DEFAULT_WIDTH, value_name = "PIXELS")]
    width: usize,
    /// The built-in scene of this number: --scene 17 for --data builtin:17 [default: the still life]
    #[arg(long, value_name = "N")]
    scene: Option<u64>,
    #[command(flatten)]
    answer: Answer,
}

impl DataCommand {
    pub fn run(self) -> Result<()> {
        match self {
            DataCommand::Check(arguments) => arguments.run(),
            DataCommand::Corrupt(arguments) => arguments.run(),
            DataCommand::ExportBuiltin(arguments) => arguments.run(),
        }
    }
}

impl ExportArguments {
    fn run(self) -> Result<()> {
        let folder = self.dir.display().to_string();
        let export::Exported { pictures, depths, triangles, .. } = export::export(&self.dir, self.width, self.scene)?;
        let answer = json!({ "folder": folder, "pictures": pictures, "depths": depths, "triangles": triangles });
        self.answer.give(&answer, || {
            print(&format!("{folder}: {pictures} images, {depths} depth maps, a mesh of {triangles} triangles"))
        })
    }
}

impl CorruptArguments {
    fn run(self) -> Result<()> {
        AtomicDir::check_vacant(&self.dir)?;
        let console = Console::new(self.quiet);
        let mut config = self.experiment.config(&console)?;
        if !config.data.corruption.is_on() {
            let message = "data.corruption.kind = \"none\": nothing to corrupt; choose gaussian-noise, shot-noise, pepper or \
                           poses with --set";
            return Err(Error::Config(message.into()));
        }
        let corruption = std::mem::take(&mut config.data.corruption);
        let (config, clean) = load_scene(config, &console)?;
        let mut corrupted = clean.clone();
        corrupt(&mut corrupted, &corruption, config.seed)?;
        write_corrupted(&self.dir, &clean, &corrupted, config.seed)?;
        let (folder, views) = (self.dir.display().to_string(), corrupted.train.len());
        self.answer.give(&json!({ "folder": folder, "training_views": views }), || {
            print(&format!("{folder}: {views} training views"))
        })
    }
}

/// Returns an error unless the file's name ends in `.svg`.
fn check_ending(file: &Path) -> Result<()> {
    if file.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("svg")) {
        return Ok(());
    }
    Err(Error::Config(format!("--picture {}: it is drawn as SVG; choose a name that ends in .svg", file.display())))
}

impl CheckArguments {
    fn run(self) -> Result<()> {
        // An error before images are read.
        self.picture.as_ref().map_or(Ok(()), |file| check_ending(file))?;
        let console = Console::new(self.quiet);
        let further = if self.picture.is_some() { &DRAWN[..] } else { &CHECKED };
        let set = data_settings(&self.set, further, CHECK_READS, "the argument DIR")?;
        let named: Vec<String> = set.iter().map(|(path, _)| path.join(".")).collect();
        let mut assignments = self.dir.as_ref().map_or(Ok(Vec::new()), |dir| scene_settings("", dir, &console))?;
        // Last, as in training.
        assignments.extend(set);
        let config = build(None, None, &assignments)?;
        let photos = if self.pixels { Photos::Read } else { Photos::Later };
        // The table of a scene has the notes.
        let notes = Mutex::new(Vec::<String>::new());
        let hold = |event: Event| match event {
            Event::Note(words) => notes.lock().expect("no thread panics while it holds them").push(words.into()),
            other => console.on(other),
        };
        let loaded = load_scene_with(config, photos, &hold);
        if loaded.is_err() {
            notes.into_inner().expect("no thread panicked").iter().for_each(|note| console.say(note));
        }
        let (config, scene) = loaded?;
        let sizes = scene.train.iter().chain(&scene.test).map(|view| (view.camera.width, view.camera.height));
        images::check_memory_of(&sizes.collect::<Vec<_>>())?;
        say_without_effect(named.into_iter(), |setting| config.without_effect(setting), &console);
        let split = split_name(&config, scene.lacks_split);
        let further = [("split", &*split), ("pixels", pixels_words(&scene))];
        let further = further.map(|(label, value)| (label.to_string(), value.to_string()));
        let said: Vec<(String, String)> = scene.describe().into_iter().chain(further).collect();
        if let Some(file) = &self.picture {
            write_named(file, scene_picture(&config, &scene)?.svg.as_bytes())?;
        }
        self.answer.give(&CheckedScene::new(&config, &scene, split, &said), || {
            said.iter().try_for_each(|(label, value)| print_shown(&format!("{label:>16}  {value}")))
        })
    }
}

/// Returns how much of the photos was read.
fn pixels_words(scene: &Scene) -> &'static str {
    match scene.is_read() {
        true => "all read",
        false => {
            "headers are read, and pixels only until alpha tells the background: --pixels reads all, and finds damaged and wholly \
             transparent photos"
        }
    }
}

/// A scene as JSON for other programs.
#[derive(Serialize)]
struct CheckedScene<'a> {
    scene: &'a str,
    dir: &'a str,
    kind: &'a str,
    training_views: Vec<&'a str>,
    held_out_views: Vec<&'a str>,
    width: usize,
    height: usize,
    near: f64,
    far: f64,
    ndc: bool,
    split: String,
    /// Of all pixels, if they are read.
    data_hash: Option<String>,
    /// The printed lines, label and value.
    said: serde_json::Map<String, serde_json::Value>,
}

impl<'a> CheckedScene<'a> {
    fn new(config: &'a Resolved, scene: &'a Scene, split: String, said: &[(String, String)]) -> CheckedScene<'a> {
        let names = |views: &'a [View]| views.iter().map(|view| view.name.as_str()).collect();
        let camera = scene.train.first().map(|view| view.camera);
        CheckedScene {
            scene: &scene.name,
            dir: &config.data.dir,
            kind: scene.kind,
            training_views: names(&scene.train),
            held_out_views: names(&scene.test),
            width: camera.map_or(0, |camera| camera.width),
            height: camera.map_or(0, |camera| camera.height),
            near: scene.near,
            far: scene.far,
            ndc: scene.ndc.is_some(),
            split,
            data_hash: scene.is_read().then(|| scene.hash()),
            said: said.iter().map(|(label, value)| (label.clone(), value.clone().into())).collect(),
        }
    }
}
