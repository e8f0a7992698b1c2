//! The arguments that describe an experiment.

use std::path::{Path, PathBuf};

use clap::Args;
use tempfile::NamedTempFile;
use toml::Value;

use crate::base::{Error, Result};
use crate::data::{self, Format};
use crate::settings::{Config, Encoding, Method, Preset, build, data_section, parse_assignment};

use super::LpipsWeights;
use super::progress::Console;

/// Scene and settings of one experiment.
#[derive(Args)]
pub struct Experiment {
    /// Scene folder: LLFF, NeRF-Synthetic (Blender), transforms.json or COLMAP; where there is none of that name, the one below
    /// the folder that AUGNERF_DATA names [default: the embedded scene]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// fast (a minute: a hash grid), smoke (seconds: small networks), cpu (minutes: small networks), paper-llff, paper-blender,
    /// released-llff or released-blender [default: fast for the embedded scene (methods of MipNeRF: smoke), the paper's settings
    /// for a real one]
    #[arg(long, value_name = "NAME")]
    preset: Option<String>,
    /// TOML file with settings over the preset's; a run's config.toml repeats that run (it has every number filled
    /// in, so it is no base for another scene or attack)
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// nerf, aug-nerf, mip-nerf, aug-mip-nerf, srn, nv or llff [default: nerf]
    #[arg(long, value_name = "METHOD")]
    method: Option<String>,
    /// Seed of every random stream [default: 0]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Any setting, over everything else: --set train.steps=2000 --set perturb.rgb.passes=off
    #[arg(long, value_name = "FIELD=VALUE")]
    set: Vec<String>,
}

/// The folder that scenes are looked for in where they are not at hand.
const DATA_ROOT: &str = "AUGNERF_DATA";

/// The scene folder that a name means: that of the name, otherwise the one below `AUGNERF_DATA` or one folder deeper, which is
/// said.
///
/// # Errors
/// Neither is there; several are below `AUGNERF_DATA`.
pub fn scene_folder(named: &Path, console: &Console) -> Result<PathBuf> {
    let here = std::path::absolute(named).map_err(|e| Error::unreadable(named, &e))?;
    let root = std::env::var_os(DATA_ROOT).filter(|root| !root.is_empty() && named.is_relative());
    let Some(root) = root.filter(|_| here.symlink_metadata().is_err()).map(PathBuf::from) else { return Ok(here) };
    let entries = std::fs::read_dir(&root).into_iter().flatten().flatten();
    let mut deeper: Vec<PathBuf> = entries.map(|entry| entry.path().join(named)).filter(|path| path.is_dir()).collect();
    deeper.sort();
    let below = root.join(named);
    let found = if below.is_dir() { vec![below] } else { deeper };
    let place = || format!("there is no {} here, and below {DATA_ROOT} ({})", named.display(), root.display());
    match &found[..] {
        [] => Err(Error::Data(format!("{} there is none either: name the scene's folder", place()))),
        [scene] => {
            console.say(&format!("scene: {} ({DATA_ROOT})", scene.display()));
            std::path::absolute(scene).map_err(|e| Error::unreadable(scene, &e))
        }
        several => {
            let several: Vec<String> = several.iter().map(|path| path.display().to_string()).collect();
            Err(Error::Data(format!("{} there are several: name one of {}", place(), several.join(", "))))
        }
    }
}

/// Settings as `(path, value)`.
type Assignments = Vec<(Vec<String>, Value)>;

/// What an experiment's arguments are laid over, and what over them.
pub struct Base<'a> {
    /// Read where no file is named.
    pub file: Option<&'a Path>,
    /// Under all that is named.
    pub first: Assignments,
    /// Over all that is named.
    pub last: Assignments,
    /// What becomes of the preset that the scene asks for where none is named.
    pub preset: fn(Preset) -> Preset,
}

impl Default for Base<'_> {
    /// Nothing.
    fn default() -> Self {
        Base { file: None, first: Vec::new(), last: Vec::new(), preset: |preset| preset }
    }
}

/// Settings as a file for [`Base::file`].
///
/// # Errors
/// It cannot be written.
pub fn settings_file(toml: &str) -> Result<NamedTempFile> {
    let unwritable = |e: std::io::Error| Error::unwritable(&std::env::temp_dir(), &e);
    let file = tempfile::Builder::new().suffix(".toml").tempfile().map_err(unwritable)?;
    std::fs::write(file.path(), toml).map_err(unwritable)?;
    Ok(file)
}

impl Experiment {
    /// Whether the scene's folder is named.
    pub fn names_scene(&self) -> bool {
        self.data.is_some()
    }

    /// Preset, file and assignments, in that order.
    pub fn config(&self, console: &Console) -> Result<Config> {
        self.config_over(Base::default(), &LpipsWeights { lpips_weights: None }, console)
    }

    /// The same over a base, of an experiment that is measured, with LPIPS where there are weights. A preset or a file that is
    /// named takes the place of the base's file.
    pub fn config_over(&self, base: Base, weights: &LpipsWeights, console: &Console) -> Result<Config> {
        let file = self.config.as_deref().or(base.file.filter(|_| self.preset.is_none()));
        let mut assignments = base.first;
        let mut assign = |path: &[&str], value: Value| {
            assignments.push((path.iter().map(|part| part.to_string()).collect::<Vec<_>>(), value));
        };
        if let Some(data) = &self.data {
            // A file may be of another scene.
            if self.config.is_none() && file.is_some() {
                assign(&["data", "kind"], Value::String("auto".into()));
                assign(&["data", "name"], Value::String(String::new()));
            }
            let data = scene_folder(data, console)?;
            assign(&["data", "dir"], Value::String(data.to_string_lossy().into_owned()));
        }
        if let Some(weights) = &weights.lpips_weights {
            let weights = std::path::absolute(weights).map_err(|e| Error::unreadable(weights, &e))?;
            assign(&["eval", "lpips_weights"], Value::String(weights.to_string_lossy().into_owned()));
        }
        if let Some(method) = &self.method {
            assign(&["method"], Value::String(method.clone()));
        }
        if let Some(seed) = self.seed {
            let seed = i64::try_from(seed)
                .map_err(|_| Error::Config(format!("--seed {seed} is out of range: it must be at most 2^63 - 1")))?;
            assign(&["seed"], Value::Integer(seed));
        }
        for text in &self.set {
            assignments.push(parse_assignment(text)?);
        }
        assignments.extend(base.last);
        let mut preset = self.preset.as_deref().map(Preset::parse).transpose()?;
        if preset.is_none() && file.is_none() {
            // What the scene asks for.
            preset = Format::of(data::detect(&data_section(&assignments)?)?).map(|format| (base.preset)(format.preset));
            if preset == Some(Preset::Fast) && !may_be_on_a_grid(&assignments) {
                preset = Some(Preset::Smoke);
            }
        }
        build(preset, file, &assignments)
    }
}

/// The method that assignments name, if any, has fields on hash grids.
fn may_be_on_a_grid(assignments: &[(Vec<String>, Value)]) -> bool {
    let named = assignments.iter().rev().find(|(path, _)| path[..] == ["method"]);
    let method = named.and_then(|(_, method)| method.clone().try_into::<Method>().ok());
    method.is_none_or(|method| method.representation(Encoding::Hash).is_some())
}
