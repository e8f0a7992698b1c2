//! Exports a run's weights to a file for other programs.

use std::path::Path;

use candle_core::Tensor;
use serde_json::{Value as Json, json};

use super::nerf_pytorch::{NETWORKS, OPTIMIZER, STEP, check, name, order};
use super::pickle::{Key, Value, dict, torch_file};
use super::{Format, METADATA};
use crate::base::files::write_named;
use crate::base::{Error, Listener, Result};
use crate::revision::version;
use crate::run::{OpenOptions, RunDir, Trained};
use crate::runtime::Runtime;
use crate::settings::{Config, word};
use crate::train::Moments;
use crate::train::checkpoint::{self, State};

/// A parameter with its moments.
type Parameter = (String, Tensor, Moments);

/// Writes the weights of a run's newest checkpoint and returns their step. For nerf-pytorch (`.tar`, `.pth`, `.pt`)
/// the file contains step, both networks and Adam's state. A safetensors file describes itself in its metadata.
///
/// # Errors
/// There is no run or no intact checkpoint; the method has no fields; nerf-pytorch does not have the field. For
/// safetensors, the scene cannot be read (its `world_to_scene` is written). The file cannot be written.
pub fn export(run: &Path, file: &Path, data: Option<&Path>, runtime: &Runtime, events: &dyn Listener) -> Result<u64> {
    let format = Format::of(file)?;
    let config = RunDir::open(run)?.read_config()?;
    check_fields(&config)?;
    check_open(&config, checkpoint::load_state(&checkpoint::latest(&RunDir::open(run)?.checkpoints())?)?.step)?;
    if let (Some(data), Format::Torch) = (data, format) {
        return Err(Error::Config(format!(
            "--data {}: a file for nerf-pytorch does not contain the scene; omit --data, or export \
             to .safetensors",
            data.display()
        )));
    }
    if format == Format::Safetensors {
        return safetensors(&Trained::open_at(run, OpenOptions::CAMERAS, data, runtime, events)?, file);
    }
    let run = RunDir::take_to_read(run)?;
    let config = run.read_config()?;
    check(&config)?;
    let newest = checkpoint::latest(&run.checkpoints())?;
    let state = checkpoint::load_state(&newest)?;
    checkpoint::check_config(&newest, &state, &config)?;
    let parameters = checkpoint::load_parameters(&newest, &config)?;
    let bytes = torch_file(&torch_checkpoint(&config, &parameters, &state)?)
        .map_err(|e| Error::Output(format!("cannot write {}: {e}", file.display())))?;
    write_named(file, &bytes)?;
    Ok(state.step)
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

fn tensor(values: &Tensor) -> Result<Value> {
    Ok(Value::Tensor { shape: values.dims().to_vec(), values: values.flatten_all()?.to_vec1()? })
}

/// Returns the object for nerf-pytorch's `torch.save`.
fn torch_checkpoint(config: &Config, parameters: &[Parameter], state: &State) -> Result<Value> {
    let mut entries = vec![(Key::Name(STEP.into()), Value::Int(state.step as i64))];
    let mut all: Vec<&Parameter> = Vec::new();
    for (role, key) in NETWORKS {
        let within = |parameter: &Parameter| parameter.0.strip_prefix(role)?.strip_prefix('.').and_then(name);
        let mut network: Vec<(String, &Parameter)> =
            parameters.iter().filter_map(|parameter| Some((within(parameter)?, parameter))).collect();
        network.sort_by_key(|(theirs, _)| order(theirs));
        let named: Result<Vec<(Key, Value)>> =
            network.iter().map(|(theirs, (_, values, _))| Ok((Key::Name(theirs.clone()), tensor(values)?))).collect();
        let value = if network.is_empty() { Value::None } else { Value::Dict(named?) };
        entries.push((Key::Name(key.into()), value));
        all.extend(network.into_iter().map(|(_, parameter)| parameter));
    }
    entries.push((Key::Name(OPTIMIZER.into()), adam(config, &all, state.step - state.adam_since)?));
    Ok(Value::Dict(entries))
}

/// Returns the state of PyTorch's Adam after `updates` updates.
fn adam(config: &Config, parameters: &[&Parameter], updates: u64) -> Result<Value> {
    let state = parameters.iter().enumerate().map(|(index, (_, _, moments))| {
        let (first, second) = (tensor(&moments.first)?, tensor(&moments.second)?);
        let state = dict([("step", Value::Int(updates as i64)), ("exp_avg", first), ("exp_avg_sq", second)]);
        Ok((Key::Index(index as i64), state))
    });
    let train = &config.train;
    let group = dict([
        ("lr", Value::Float(train.learning_rate)),
        ("betas", Value::Pair(Box::new([Value::Float(0.9), Value::Float(train.adam_beta2)]))),
        ("eps", Value::Float(train.adam_epsilon)),
        ("weight_decay", Value::Int(0)),
        ("amsgrad", Value::Bool(false)),
        ("params", Value::List((0..parameters.len() as i64).map(Value::Int).collect())),
    ]);
    let state = Value::Dict(state.collect::<Result<_>>()?);
    Ok(dict([("state", state), ("param_groups", Value::List(vec![group]))]))
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
