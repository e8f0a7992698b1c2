//! `augnerf eval`.

use std::path::{Path, PathBuf};

use candle_core::{DType, Device};
use clap::Args;

use crate::config::Config;
use crate::data::Scene;
use crate::error::{Error, Result};
use crate::evaluate::{Protocol, Report, Viewer};
use crate::metrics::{Backbone, Lpips, MeanMetrics};
use crate::model::Model;
use crate::output::RunDir;
use crate::train::AttackSummary;
use crate::train::checkpoint::{self, State};

use super::experiment::load_scene;
use super::progress::{Screen, print};
use super::{Machine, Sources};

#[derive(Args)]
pub struct EvalArguments {
    /// Run folder; its newest checkpoint is measured
    run: PathBuf,
    #[command(flatten)]
    sources: Sources,
    #[command(flatten)]
    machine: Machine,
}

/// A trained run, read back.
pub struct Trained {
    pub run: RunDir,
    pub config: Config,
    pub scene: Scene,
    pub state: State,
    pub model: Model,
}

impl Trained {
    /// The newest checkpoint of a run with its scene.
    pub fn open(run: &Path, data: Option<&Path>, device: &Device, screen: &Screen) -> Result<Trained> {
        let mut run = RunDir::open(run)?;
        // No training may prune the checkpoint that is being read.
        run.lock()?;
        let mut config = run_config(&run)?;
        if let Some(dir) = data {
            config.data.dir = dir.to_string_lossy().into_owned();
        }
        let newest = checkpoint::latest(&run.checkpoints())?;
        let state = checkpoint::load_state(&newest)?;
        let model = checkpoint::load_model(&newest, &config, DType::F32, device)?;
        checkpoint::check_config(&newest, &state, &config)?;
        let scene = load_scene(&mut config, screen)?;
        Ok(Trained { run, config, scene, state, model })
    }
}

/// The resolved configuration of a run.
pub fn run_config(run: &RunDir) -> Result<Config> {
    let path = run.config();
    let text = std::fs::read_to_string(&path)
        .map_err(|e| Error::Checkpoint(format!("cannot read {}: {e}", path.display())))?;
    Config::from_toml(&text, &path.display().to_string())
}

/// Every LPIPS backbone whose weights the folder holds; none for an empty name.
pub fn load_lpips(dir: &str, device: &Device) -> Result<Vec<Lpips>> {
    if dir.is_empty() {
        return Ok(Vec::new());
    }
    let dir = Path::new(dir);
    let found = Lpips::available(dir)?;
    if found.is_empty() {
        let names: Vec<&str> = Backbone::ALL.iter().map(|backbone| backbone.name()).collect();
        return Err(Error::Data(format!(
            "--lpips-weights {}: no backbone ({}) is complete there; each needs its linear layers (NAME_lin_v0.1.pth) \
             and its features",
            dir.display(),
            names.join(", ")
        )));
    }
    let loaded = found.into_iter().map(|backbone| Lpips::load(dir, backbone, device)).collect::<Result<Vec<_>>>()?;
    Ok(loaded.into_iter().flatten().collect())
}

impl EvalArguments {
    pub fn run(self) -> Result<()> {
        let device = self.machine.device()?;
        let screen = Screen::new(self.machine.quiet);
        let trained = Trained::open(&self.run, self.sources.data.as_deref(), &device, &screen)?;
        let lpips = load_lpips(&self.sources.weights.or(&trained.config), &device)?;
        let Trained { run, config, scene, state, model } = &trained;
        let viewer = Viewer { model, config, scene, device: &device };
        let views = viewer.evaluate(&lpips, &screen, |_, _, _| Ok(()))?;
        let report = Report {
            mean: MeanMetrics::from_views(&views),
            views,
            protocol: Protocol::new(config, scene, state.step, &state.redraws),
            attack: AttackSummary::read(&run.scalars(), state.step)?,
        };
        report.write(&run.metrics_json(), &run.metrics_csv())?;
        let mean = serde_json::to_string_pretty(&report.mean).expect("plain data");
        print(&mean);
        screen.say(&format!("step {} of {}: {}", state.step, config.train.steps, run.metrics_json().display()));
        Ok(())
    }
}
