//! `augnerf import`.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::base::files::AtomicDir;
use crate::base::{Error, Result};
use crate::run::{Existing, Foreign, Job, Setup, load_lpips, load_scene};
use crate::runtime::Runtime;
use crate::settings::Preset;
use crate::train::Origin;

use super::answer::Answer;
use super::experiment::{Base, Experiment, say_without_effect};
use super::progress::Console;
use super::train::default_folder;
use super::{Compute, LpipsWeights};

pub const IMPORT_EXAMPLES: &str = "Examples:
  augnerf import 200000.tar --data nerf_synthetic/lego --preset paper-blender --out runs/lego
  augnerf import 200000.tar --data nerf_synthetic/lego --overwrite

A nerf-pytorch checkpoint says nothing about reading and sampling the scene; --preset and --set do.";

#[derive(Args)]
pub struct ImportArguments {
    /// Checkpoint of nerf-pytorch (.tar, .pth, .pt)
    file: PathBuf,
    #[command(flatten)]
    experiment: Experiment,
    #[command(flatten)]
    weights: LpipsWeights,
    /// Run folder [default: runs/SCENE-METHOD-HASH]
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out: Option<PathBuf>,
    /// Replace the run in that folder
    #[arg(long, help_heading = "Output")]
    overwrite: bool,
    #[command(flatten)]
    answer: Answer,
    #[command(flatten)]
    compute: Compute,
}

impl ImportArguments {
    pub fn run(self) -> Result<()> {
        self.compute.run(|runtime, console| self.import(runtime, console))
    }

    fn import(&self, runtime: &Runtime, console: &Console) -> Result<()> {
        let foreign = Foreign::open(&self.file)?;
        let mut first = foreign.settings()?;
        first.push((path("train.steps"), toml::Value::Integer(foreign.step().max(1) as i64)));
        let base = Base {
            first,
            last: vec![(path("train.parent"), foreign.parent().into())],
            // The weights are of the paper's networks, not of a hash grid.
            preset: |preset| if preset == Preset::Fast { Preset::Cpu } else { preset },
            ..Base::default()
        };
        let config = self.experiment.config_over(base, &self.weights, console)?;
        // A run that names unreadable weights could not be measured.
        load_lpips(&config.eval.lpips_weights, runtime.device())?;
        let (config, scene) = load_scene(config, console)?;
        check_steps(&self.file, foreign.step(), config.train.steps)?;
        say_without_effect(self.experiment.settings(), |setting| config.without_effect(setting), console);
        let values = foreign.values(&config, runtime.device())?;
        let folder = self.out.clone().unwrap_or_else(|| default_folder(&config));
        let networks = crate::methods::Model::parts(&config).len();
        let (depth, width, name) = (config.field.depth, config.field.width, config.data.name.clone());
        let setup = Setup { config, scene: &scene, lpips: &[], runtime: runtime.clone() };
        let existing = if self.overwrite { Existing::Replace } else { Existing::Refuse };
        let origin = Origin::Weights { values, step: foreign.step() };
        if folder.symlink_metadata().is_ok() {
            Job::create_from(&folder, existing, setup, origin)?;
        } else {
            // A run without its checkpoint is none, so that it appears as a whole.
            let hidden = AtomicDir::vacant(&folder)?;
            drop(Job::create_from(hidden.path(), existing, setup, origin)?);
            hidden.commit_new()?;
        }
        console.say(&format!(
            "{networks} networks of {depth} layers with {width} neurons, step {}, scene {name}",
            foreign.step()
        ));
        console.say(&format!("next: augnerf eval {}", folder.display()));
        let answer = json!({
            "run": folder.display().to_string(),
            "step": foreign.step(),
            "scene": name,
            "networks": networks,
            "depth": depth,
            "width": width,
        });
        self.answer.give_place(&answer, &folder)
    }
}

fn path(dotted: &str) -> Vec<String> {
    dotted.split('.').map(String::from).collect()
}

/// Checks that the run does not end before the step of its weights.
fn check_steps(file: &Path, step: u64, steps: u64) -> Result<()> {
    if step <= steps {
        return Ok(());
    }
    Err(Error::Config(format!(
        "{}: weights of step {step}, but train.steps = {steps}; omit train.steps, or raise it with --set train.steps=N",
        file.display()
    )))
}
