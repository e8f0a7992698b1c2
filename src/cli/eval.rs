//! `augnerf eval`.

use std::path::{Path, PathBuf};

use candle_core::{DType, Device};
use clap::Args;

use crate::base::Result;
use crate::data::Scene;
use crate::methods::{AttackSummary, Model};
use crate::run::{Protocol, Report, RunDir, Viewer, load_lpips, load_scene, run_config, surface_reference};
use crate::settings::Resolved;
use crate::train::checkpoint::{self, State};

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
    pub config: Resolved,
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
        run.clean()?;
        let mut config = run_config(&run)?;
        if let Some(dir) = data {
            config.data.dir = dir.to_string_lossy().into_owned();
        }
        let newest = checkpoint::latest(&run.checkpoints())?;
        let mut state = checkpoint::load_state(&newest)?;
        let model = checkpoint::load_model(&newest, &config, DType::F32, device)?;
        checkpoint::check_config(&newest, &state, &config)?;
        state.touch(device);
        let (config, scene) = load_scene(config, screen)?;
        Ok(Trained { run, config, scene, state, model })
    }
}

impl EvalArguments {
    pub fn run(self) -> Result<()> {
        let device = self.machine.device()?;
        let screen = Screen::new(self.machine.quiet);
        let trained = Trained::open(&self.run, self.sources.data.as_deref(), &device, &screen)?;
        let lpips = load_lpips(&self.sources.weights.or(&trained.config), &device)?;
        let Trained { run, config, scene, state, model } = &trained;
        surface_reference(config, scene)?;
        let viewer = Viewer { model, config, scene, device: &device };
        let views = viewer.evaluate(&lpips, &screen, || Ok(()), |_, _, _| Ok(()))?;
        let surface = viewer.surface(&screen, |line| screen.say(line), || Ok(()))?;
        let attack = AttackSummary::read(&run.scalars(), state.step)?;
        let report = Report::new(views, surface, Protocol::new(config, scene, state), attack);
        report.write(&run.metrics_json(), &run.metrics_csv())?;
        let mean = serde_json::to_string_pretty(&report.mean).expect("plain data");
        print(&mean);
        screen.say(&format!("step {} of {}: {}", state.step, config.train.steps, run.metrics_json().display()));
        Ok(())
    }
}
