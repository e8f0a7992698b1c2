//! The arguments that describe an experiment.

use std::path::{Path, PathBuf};

use clap::Args;
use toml::Value;

use crate::base::{Error, Result};
use crate::data::{self, Format};
use crate::settings::{Config, Encoding, Method, Preset, build, data_section, parse_assignment};

use super::LpipsWeights;

/// Scene and settings of one experiment.
#[derive(Args)]
pub struct Experiment {
    /// Scene folder: LLFF, NeRF-Synthetic (Blender) or transforms.json [default: the embedded scene]
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
    /// nerf, aug-nerf, mip-nerf or aug-mip-nerf [default: nerf]
    #[arg(long, value_name = "METHOD")]
    method: Option<String>,
    /// Seed of every random stream [default: 0]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Any setting, over everything else: --set train.steps=2000 --set perturb.rgb.passes=off
    #[arg(long, value_name = "FIELD=VALUE")]
    set: Vec<String>,
    #[command(flatten)]
    weights: LpipsWeights,
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

impl Experiment {
    /// Preset, file and assignments, in that order.
    pub fn config(&self) -> Result<Config> {
        self.config_over(Base { file: None, first: Vec::new(), last: Vec::new(), preset: |preset| preset })
    }

    /// The same over a base. A preset or a file that is named takes the place of the base's file.
    pub fn config_over(&self, base: Base) -> Result<Config> {
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
            let data = std::path::absolute(data).map_err(|e| Error::unreadable(data, &e))?;
            assign(&["data", "dir"], Value::String(data.to_string_lossy().into_owned()));
        }
        if let Some(weights) = &self.weights.lpips_weights {
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
