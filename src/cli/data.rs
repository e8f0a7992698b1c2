//! `augnerf data`.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use crate::base::files::{AtomicDir, write_atomic};
use crate::base::{Error, Result};
use crate::data::Scene;
use crate::data::corruption::corrupt;
use crate::data::formats::builtin::export;
use crate::run::{load_scene, scene_picture, split_name, write_corrupted};
use crate::settings::{build, parse_assignment};

use super::experiment::Experiment;
use super::progress::{Console, print, print_shown};

#[derive(Subcommand)]
pub enum DataCommand {
    /// Say what a scene folder holds and how it would be used
    Check(CheckArguments),
    /// Write the training views as section data.corruption of the settings makes them, to look at
    #[command(after_help = CORRUPT_EXAMPLES)]
    Corrupt(CorruptArguments),
    /// Write the embedded scene in Blender format, with exact depth and mesh
    ExportBuiltin(ExportArguments),
}

#[derive(Args)]
pub struct CheckArguments {
    /// Scene folder [default: the embedded scene]
    dir: Option<PathBuf>,
    /// Settings of section data, as in training: --set data.downscale=4
    #[arg(long, value_name = "FIELD=VALUE")]
    set: Vec<String>,
    /// Draw cameras, points, the ends of rays and the box from two sides, too: a PNG or SVG
    #[arg(long, value_name = "FILE.png")]
    picture: Option<PathBuf>,
    /// No progress bar
    #[arg(long, short)]
    quiet: bool,
}

const CORRUPT_EXAMPLES: &str = "Examples:
  augnerf data corrupt noisy --data fern --set data.corruption.kind=gaussian-noise
  augnerf data corrupt moved --data fern --set data.corruption.kind=poses --seed 1
  augnerf data corrupt seen --config RUN/config.toml      what a run was trained on

DIR gets views/NAME.png, beside.png (the first view, clean and corrupted), views.csv (each view's PSNR in dB to the
clean one, degrees that its camera was turned by, scene units that it was moved by) and corruption.json. Pixels are
those that training with the same settings and seed sees; of poses, views.csv is all there is to see. Held-out views
are never touched.";

#[derive(Args)]
pub struct CorruptArguments {
    /// New or empty folder
    dir: PathBuf,
    #[command(flatten)]
    experiment: Experiment,
    /// No progress bar
    #[arg(long, short)]
    quiet: bool,
}

#[derive(Args)]
pub struct ExportArguments {
    /// New or empty folder
    dir: PathBuf,
    /// Width and height of the views in pixels
    #[arg(long, default_value_t = export::DEFAULT_WIDTH, value_name = "PIXELS")]
    width: usize,
}

impl DataCommand {
    pub fn run(self) -> Result<()> {
        match self {
            DataCommand::Check(arguments) => arguments.run(),
            DataCommand::Corrupt(arguments) => arguments.run(),
            DataCommand::ExportBuiltin(arguments) => {
                let exported = export::export(&arguments.dir, arguments.width)?;
                print(&format!(
                    "{}: {} pictures, {} depth maps, a mesh of {} triangles",
                    arguments.dir.display(),
                    exported.pictures,
                    exported.depths,
                    exported.triangles
                ))
            }
        }
    }
}

impl CorruptArguments {
    fn run(self) -> Result<()> {
        AtomicDir::check_vacant(&self.dir)?;
        let mut config = self.experiment.config()?;
        if !config.data.corruption.is_on() {
            let message =
                "nothing would be corrupted: --set data.corruption.kind to gaussian-noise, shot-noise, pepper or poses";
            return Err(Error::Config(message.into()));
        }
        let corruption = std::mem::take(&mut config.data.corruption);
        let (config, clean) = load_scene(config, &Console::new(self.quiet))?;
        let mut corrupted = clean.clone();
        corrupt(&mut corrupted, &corruption, config.seed)?;
        write_corrupted(&self.dir, &clean, &corrupted, config.seed)?;
        print(&format!("{}: {} training views", self.dir.display(), corrupted.train.len()))
    }
}

/// Draws the scene into a file whose ending names the kind.
fn draw(scene: &Scene, file: &Path) -> Result<()> {
    let figure = scene_picture(scene)?;
    match (ending(file)?, figure.png) {
        (Ending::Svg, _) => write_atomic(file, figure.svg.as_bytes()),
        (Ending::Png, Some(png)) => write_atomic(file, &png),
        (Ending::Png, None) => Err(Error::Config(format!(
            "--picture {}: this augnerf was built without PNG figures (feature png-figures); let the name end in .svg",
            file.display()
        ))),
    }
}

enum Ending {
    Png,
    Svg,
}

fn ending(file: &Path) -> Result<Ending> {
    match file.extension().map(|ending| ending.to_ascii_lowercase()) {
        Some(ending) if ending == "png" => Ok(Ending::Png),
        Some(ending) if ending == "svg" => Ok(Ending::Svg),
        _ => Err(Error::Config(format!("--picture {}: let the file's name end in .png or .svg", file.display()))),
    }
}

impl CheckArguments {
    fn run(self) -> Result<()> {
        // Refused before pictures are read.
        self.picture.as_ref().map_or(Ok(()), |file| ending(file).map(|_| ()))?;
        let mut assignments = self.set.iter().map(|text| parse_assignment(text)).collect::<Result<Vec<_>>>()?;
        if let Some(dir) = &self.dir {
            let dir = toml::Value::String(dir.to_string_lossy().into_owned());
            assignments.push((vec!["data".into(), "dir".into()], dir));
        }
        let config = build(None, None, &assignments)?;
        let (config, scene) = load_scene(config, &Console::new(self.quiet))?;
        let split = ("split".to_string(), split_name(&config));
        for (label, value) in scene.describe().into_iter().chain([split]) {
            print_shown(&format!("{label:>16}  {value}"))?;
        }
        self.picture.as_ref().map_or(Ok(()), |file| draw(&scene, file))
    }
}
