//! Exports a run's weights to a file for other programs.

use std::path::Path;

use candle_core::Tensor;
use serde_json::{Value as Json, json};

use super::{Format, METADATA};
use crate::base::files::write_named;
use crate::base::{Error, Listener, Result};
use crate::revision::version;
use crate::run::{OpenOptions, RunDir, Trained};
use crate::runtime::Runtime;
use crate::settings::{Config, word};
use crate::train::checkpoint::{self, State};

/// Writes the weights of a run's newest checkpoint, and returns their step. The file describes itself in its metadata.
///
/// # Errors
/// The file is no `.safetensors`; there is no run or no intact checkpoint; the method has no fields; the scene, whose
/// `world_to_scene` is written, cannot be read; the file cannot be written.
pub fn export(run: &Path, file: &Path, data: Option<&Path>, runtime: &Runtime, events: &dyn Listener) -> Result<u64> {
    if Format::of(file)? != Format::Safetensors {
        return Err(Error::Config(format!(
            "{}: weights are written as .safetensors; choose such a name, and make nerf-pytorch's checkpoint of it in Python \
             (docs/weights.md)",
            file.display()
        )));
    }
    let config = RunDir::open(run)?.read_config()?;
    check_fields(&config)?;
    check_open(&config, checkpoint::load_state(&checkpoint::latest(&RunDir::open(run)?.checkpoints())?)?.step)?;
    safetensors(&Trained::open_at(run, OpenOptions::CAMERAS, data, runtime, events)?, file)
}

/// Returns an error for weights whose encodings are not all open: other programs read all of them.
fn check_open(config: &Config, step: u64) -> Result<()> {
    if step >= config.field.frequency_steps {
        return Ok(());
    }
    Err(Error::Config(format!(
        "the run is at step {step}, and its encodings are all open from step {} on (field.frequency_steps), which no file says; train on \
         with `augnerf resume`, and export then",
        config.field.frequency_steps
    )))
}

/// Returns an error for a run without radiance fields.
fn check_fields(config: &Config) -> Result<()> {
    if config.method.has_fields() {
        return Ok(());
    }
    Err(Error::Config(format!(
        "export with method {}: files for other programs contain radiance fields, but this run has none; its weights are \
         the .safetensors of its checkpoints",
        config.method.name()
    )))
}

/// Writes all parameters under their checkpoint names, with the metadata to use them.
fn safetensors(trained: &Trained, file: &Path) -> Result<u64> {
    let Trained { config, scene, state, model, .. } = trained;
    let said = serde_json::to_string(&metadata(config, &scene.space.world.matrix(), state)).expect("plain data");
    let named = model
        .variables()
        .into_iter()
        .map(|(name, var)| Ok((name, var.as_tensor().to_device(&candle_core::Device::Cpu)?)));
    let named: Vec<(String, Tensor)> = named.collect::<Result<_>>()?;
    let bytes = safetensors::serialize(named, Some([(METADATA.to_string(), said)].into()))
        .map_err(|e| Error::Output(format!("cannot write {}: {e}", file.display())))?;
    write_named(file, &bytes)?;
    Ok(state.step)
}

fn metadata(config: &crate::settings::Resolved, world_to_scene: &[[f64; 4]; 3], state: &State) -> Json {
    let field = &config.field;
    json!({
        "format": 1,
        "program": version(),
        "step": state.step,
        "config_hash": state.config_hash,
        "code_revision": state.revisions.join(" + "),
        "networks": crate::model::Model::parts(config),
        "architecture": {
            "width": field.width,
            "depth": field.depth,
            "skips": field.skips,
            "view_depth": field.view_depth,
            "view_width": field.view_neurons(),
            "density_activation": word(field.density_activation),
            "rgb_padding": field.rgb_padding,
        },
        "encodings": {
            "position": word(field.encoding),
            "position_octaves": field.position_octaves,
            "view_octaves": field.view_octaves,
        },
        "scene": config.data.name,
        "world_to_scene": world_to_scene,
        "config": config.without_paths().to_toml(),
    })
}
