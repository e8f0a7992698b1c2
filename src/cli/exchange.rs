//! `augnerf export` and `augnerf import`.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::base::{Error, Result};
use crate::run::{Existing, Foreign, Job, Networks, Setup, export, load_scene};
use crate::runtime::Runtime;
use crate::settings::Preset;
use crate::train::Origin;

use super::answer::Answer;
use super::experiment::{Base, Experiment, settings_file};
use super::progress::Console;
use super::train::default_folder;
use super::{Compute, LpipsWeights};

pub const EXPORT_EXAMPLES: &str = "Examples:
  augnerf export RUN lego.tar          # a checkpoint that nerf-pytorch takes with --ft_path
  augnerf export RUN lego.safetensors  # all weights, with networks, encodings and settings

A nerf-pytorch checkpoint holds both networks, the step and Adam's state. Fields that it does not have (hash grids, MipNeRF, \
other skips than field.skips=[5]) are refused.";

pub const IMPORT_EXAMPLES: &str = "Examples:
  augnerf import 200000.tar --data nerf_synthetic/lego --preset paper-blender --out runs/lego
  augnerf import lego.safetensors --data nerf_synthetic/lego --out runs/lego

Then the run is like any other: augnerf eval runs/lego, augnerf render runs/lego, augnerf train --from runs/lego. The networks' \
shape follows from the weights; how the scene is read and sampled is not in a nerf-pytorch checkpoint, and follows from \
--preset and --set.";

#[derive(Args)]
pub struct ExportArguments {
    /// Run folder; its newest checkpoint is exported
    run: PathBuf,
    /// The file: .tar, .pth or .pt for nerf-pytorch, .safetensors with metadata
    file: PathBuf,
    /// Scene folder, if it has moved since training (.safetensors alone, which tell how its units follow from the capture's)
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    #[command(flatten)]
    answer: Answer,
    #[command(flatten)]
    compute: Compute,
}

#[derive(Args)]
pub struct ImportArguments {
    /// The file: a checkpoint of nerf-pytorch (.tar, .pth, .pt) or an exported .safetensors
    file: PathBuf,
    #[command(flatten)]
    experiment: Experiment,
    /// Run folder [default: runs/SCENE-METHOD-HASH]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Replace the run that the folder holds
    #[arg(long)]
    overwrite: bool,
    #[command(flatten)]
    weights: LpipsWeights,
    #[command(flatten)]
    answer: Answer,
    #[command(flatten)]
    compute: Compute,
}

impl ExportArguments {
    pub fn run(self) -> Result<()> {
        let runtime = self.compute.runtime()?;
        let console = Console::new(self.compute.quiet);
        let step = runtime.install(|| export(&self.run, &self.file, self.data.as_deref(), &runtime, &console))?;
        console.say(&format!("weights of step {step}"));
        self.answer.give_place(
            &json!({ "run": self.run.display().to_string(), "step": step, "file": self.file.display().to_string() }),
            &self.file,
        )
    }
}

impl ImportArguments {
    pub fn run(self) -> Result<()> {
        let runtime = self.compute.runtime()?;
        runtime.install(|| self.import(&runtime))
    }

    fn import(&self, runtime: &Runtime) -> Result<()> {
        let console = Console::new(self.compute.quiet);
        let foreign = Foreign::open(&self.file)?;
        let own = match foreign.networks() {
            Networks::Own { config } => Some(settings_file(config)?),
            Networks::NerfPytorch { .. } => None,
        };
        let mut first = foreign.settings()?;
        first.push((path("train.steps"), toml::Value::Integer(foreign.step().max(1) as i64)));
        let base = Base {
            file: own.as_ref().map(|file| file.path()),
            first,
            last: vec![(path("train.parent"), foreign.parent().into())],
            // Its networks are those of the paper, which a hash grid's preset is not for.
            preset: |preset| if preset == Preset::Fast { Preset::Cpu } else { preset },
        };
        let (config, scene) = load_scene(self.experiment.config_over(base, &self.weights, &console)?, &console)?;
        check_steps(&self.file, foreign.step(), config.train.steps)?;
        let values = foreign.values(&config, runtime.device())?;
        let folder = self.out.clone().unwrap_or_else(|| default_folder(&config));
        let networks = crate::methods::Model::parts(&config).len();
        let (depth, width, name) = (config.field.depth, config.field.width, config.data.name.clone());
        let setup = Setup { config, scene: &scene, lpips: &[], runtime: runtime.clone() };
        let existing = if self.overwrite { Existing::Replace } else { Existing::Refuse };
        Job::create_from(&folder, existing, setup, Origin::Weights { values, step: foreign.step() })?;
        console.say(&format!(
            "{networks} networks of {depth} layers with {width} neurons, step {}, scene {name}",
            foreign.step()
        ));
        console.say(&format!("measure them with `augnerf eval {}`", folder.display()));
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

/// Refuses a run that would end before the step that its weights are of.
fn check_steps(file: &Path, step: u64, steps: u64) -> Result<()> {
    if step <= steps {
        return Ok(());
    }
    Err(Error::Config(format!(
        "{} is of step {step}, and train.steps = {steps}: leave it out to end there, or ask for more with --set train.steps=N",
        file.display()
    )))
}
