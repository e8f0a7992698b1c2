//! Checkpoints: parameters, moments and counters of a run.
//!
//! A checkpoint is a folder `checkpoints/step_000001000` with `state.safetensors` (parameters
//! `coarse.trunk.0.weight`, moments `adam.first.coarse...`, `adam.second.coarse...`), `state.json`,
//! `config.toml`, and the checksums of these in `SHA256SUMS`. The folder appears and disappears as a whole. Random
//! numbers are functions of the step, so no generator state is kept.

use std::path::{Path, PathBuf};

use candle_core::{DType, Device, Tensor};
use serde::{Deserialize, Serialize};

use crate::accelerator;
use crate::base::files::{AtomicDir, clean_temporaries, discard, json_bytes};
use crate::base::{Error, Result, tensor_sentence};
use crate::data::Scene;
use crate::model::Model;
use crate::revision::revision;
use crate::runtime::Runtime;
use crate::settings::{Config, Resolved};

use super::{Inputs, Moments, Trainer, sums};

pub(super) const FORMAT: u32 = 1;
const TENSORS: &str = "state.safetensors";
const STATE: &str = "state.json";
const CONFIG: &str = "config.toml";

/// The counters of a checkpoint.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// Layout version of the checkpoint folder.
    pub format: u32,
    /// Completed steps.
    pub step: u64,
    /// The step at which Adam's moments were 0, which for imported weights is their step.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub adam_since: u64,
    /// Successive steps on which every ray was empty.
    pub empty_steps: u64,
    /// How often each field was initialized again before it was alive.
    pub redraws: Vec<u64>,
    /// Hash of the configuration.
    pub config_hash: String,
    /// Revisions of the code that took the steps, in order.
    #[serde(default)]
    pub revisions: Vec<String>,
    /// Kinds of devices that took the steps.
    #[serde(default)]
    pub devices: Vec<String>,
    /// Instruction sets of the CPUs that took the steps.
    #[serde(default)]
    pub instructions: Vec<String>,
    /// Adapters and drivers of the GPUs that took the steps.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub adapters: Vec<String>,
}

/// Serde passes a reference.
#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_zero(step: &u64) -> bool {
    *step == 0
}

impl State {
    /// Records that this program continues or measures the run, on `runtime`'s kind of device.
    pub fn touch(&mut self, runtime: &Runtime) {
        let adapter = runtime.accelerator().map(|accelerator| accelerator.description());
        let now = [
            (&mut self.revisions, Some(revision())),
            (&mut self.devices, Some(runtime.kind())),
            (&mut self.instructions, runtime.instructions()),
            (&mut self.adapters, adapter.as_deref()),
        ];
        for (list, now) in now.into_iter().filter_map(|(list, now)| Some((list, now?))) {
            if !list.iter().any(|known| known == now) {
                list.push(now.to_string());
            }
        }
    }
}

/// Returns the folder of a step below a run's `checkpoints`.
fn folder(checkpoints: &Path, step: u64) -> PathBuf {
    checkpoints.join(format!("step_{step:09}"))
}

/// Lists all checkpoints below `checkpoints` as `(step, folder)`, oldest first.
pub fn list(checkpoints: &Path) -> Result<Vec<(u64, PathBuf)>> {
    let entries = match std::fs::read_dir(checkpoints) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(Error::unreadable(checkpoints, &error)),
    };
    let mut found = Vec::new();
    for entry in entries {
        let entry = entry.map_err(|error| Error::unreadable(checkpoints, &error))?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if let Some(step) = step_of(&name) {
            found.push((step, entry.path()));
        }
    }
    found.sort();
    Ok(found)
}

/// Returns the step in the name of a checkpoint's folder.
fn step_of(name: &str) -> Option<u64> {
    let digits = name.strip_prefix("step_")?;
    digits.bytes().all(|byte| byte.is_ascii_digit()).then(|| digits.parse().ok())?
}

/// Returns what is wrong with a checkpoint's files: one is missing or differs from what was written. `None` if they
/// are intact.
///
/// # Errors
/// A file cannot be read.
fn flaw(checkpoint: &Path) -> Result<Option<String>> {
    let read = |name: &str| {
        let path = checkpoint.join(name);
        let found = sums::read(checkpoint, name).map_err(|error| unreadable(&path, &error))?;
        Ok::<_, Error>(found.map_err(|reason| format!("{name}: {reason}")))
    };
    let flaw = match (read(TENSORS)?, read(STATE)?) {
        (Err(reason), _) | (_, Err(reason)) => Some(reason),
        (Ok(tensors), Ok(state)) => {
            let named = checkpoint.file_name().and_then(|name| step_of(&name.to_string_lossy()));
            let tensors = safetensors::SafeTensors::deserialize(&tensors).err().map(|e| format!("{TENSORS}: {e}"));
            tensors.or_else(|| match serde_json::from_slice::<State>(&state) {
                Err(error) => Some(format!("{STATE}: {error}")),
                Ok(State { step, .. }) if named != Some(step) => Some(format!("{STATE}: it belongs to step {step}")),
                Ok(_) => None,
            })
        }
    };
    Ok(flaw)
}

/// Returns the newest intact checkpoint, or `None` if there are no checkpoints, and a sentence for each newer, damaged
/// one. Damaged ones are deleted: training writes them again.
///
/// # Errors
/// A file cannot be read; no checkpoint is intact.
pub fn newest_whole(checkpoints: &Path) -> Result<(Option<PathBuf>, Vec<String>)> {
    let mut damaged: Vec<(PathBuf, String)> = Vec::new();
    for (_, folder) in list(checkpoints)?.into_iter().rev() {
        let Some(reason) = flaw(&folder)? else {
            for (damaged, _) in &damaged {
                discard(damaged).map_err(|error| Error::unwritable(damaged, &error))?;
            }
            let note = |(damaged, reason): (PathBuf, String)| {
                format!(
                    "{} is damaged ({reason}); it was deleted, and training resumes from {}",
                    damaged.display(),
                    folder.display()
                )
            };
            let notes = damaged.into_iter().map(note).collect();
            return Ok((Some(folder), notes));
        };
        damaged.push((folder, reason));
    }
    match damaged.first() {
        None => Ok((None, Vec::new())),
        Some((folder, reason)) => Err(Error::Checkpoint(format!(
            "no checkpoint in {} is intact; {}, in the newest, is damaged ({reason}); restore a copy, or delete them to train \
             from the first step",
            checkpoints.display(),
            folder.display()
        ))),
    }
}

/// Returns the newest checkpoint.
pub fn latest(checkpoints: &Path) -> Result<PathBuf> {
    let newest = list(checkpoints)?.pop();
    newest.map(|(_, folder)| folder).ok_or_else(|| {
        Error::Checkpoint(format!(
            "{} holds no checkpoint, as the run stopped before its first one; `augnerf resume` starts it again",
            checkpoints.display()
        ))
    })
}

/// Returns the checkpoint of a step.
///
/// # Errors
/// There is none; the error names those that exist.
pub fn of_step(checkpoints: &Path, step: u64) -> Result<PathBuf> {
    let all = list(checkpoints)?;
    let steps: Vec<String> = all.iter().map(|(step, _)| step.to_string()).collect();
    let found = all.into_iter().find(|(of, _)| *of == step);
    found.map(|(_, folder)| folder).ok_or_else(|| {
        let kept = if steps.is_empty() { "none".to_string() } else { steps.join(", ") };
        Error::Checkpoint(format!(
            "{} holds no checkpoint of step {step}; kept steps: {kept}; train.checkpoint_every and train.keep_checkpoints set \
             which are kept",
            checkpoints.display()
        ))
    })
}

/// Reads the values of all parameters, in the order of [`Model::parameter_names`].
pub fn load_model(checkpoint: &Path, config: &Config, dtype: DType, device: &Device) -> Result<Model> {
    let tensors = Tensors::open(checkpoint, dtype, device)?;
    let model = Model::from_parameters(config, tensors.all("", &Model::parameter_names(config))?)?;
    model.at_step(config, load_state(checkpoint)?.step)
}

/// Returns an error if a checkpoint was written under another configuration.
pub fn check_config(checkpoint: &Path, state: &State, config: &Config) -> Result<()> {
    if state.config_hash == config.hash() {
        return Ok(());
    }
    Err(Error::Checkpoint(format!(
        "{} was written under configuration {}, but the run's config.toml is {}: it was changed since, or this is another \
         version of augnerf with other settings; restore the file, use that version, or \
         start a new run",
        checkpoint.display(),
        state.config_hash,
        config.hash()
    )))
}

/// Reads the counters of a checkpoint.
pub fn load_state(checkpoint: &Path) -> Result<State> {
    let path = checkpoint.join(STATE);
    let bytes = read(checkpoint, STATE)?;
    let state: State = serde_json::from_slice(&bytes).map_err(|e| broken(&path, &e.to_string()))?;
    if state.format != FORMAT {
        let found = format!("its format is {}, but this program reads {FORMAT}", state.format);
        return Err(damaged(&path, &found));
    }
    if state.adam_since > state.step {
        let found = format!("Adam started at step {}, after the checkpoint's step, {}", state.adam_since, state.step);
        return Err(damaged(&path, &found));
    }
    Ok(state)
}

fn damaged(path: &Path, found: &str) -> Error {
    Error::Checkpoint(format!("cannot use the checkpoint file {}: {found}", path.display()))
}

/// Returns the error for a damaged file; the checkpoint before it may be intact.
fn broken(path: &Path, found: &str) -> Error {
    let folder = path.parent().unwrap_or(path).display();
    damaged(
        path,
        &format!(
            "{found}; `augnerf resume` continues from the checkpoint before it; to measure that one, delete {folder}"
        ),
    )
}

fn unreadable(path: &Path, error: &std::io::Error) -> Error {
    damaged(path, &error.to_string())
}

/// Reads a file of a checkpoint, as it was written.
fn read(checkpoint: &Path, name: &str) -> Result<Vec<u8>> {
    let path = checkpoint.join(name);
    let found = sums::read(checkpoint, name).map_err(|error| unreadable(&path, &error))?;
    found.map_err(|reason| broken(&path, &reason))
}

/// The tensors of a checkpoint by name.
pub(super) struct Tensors {
    path: PathBuf,
    tensors: std::collections::HashMap<String, Tensor>,
    dtype: DType,
}

impl Tensors {
    pub(super) fn open(checkpoint: &Path, dtype: DType, device: &Device) -> Result<Tensors> {
        let path = checkpoint.join(TENSORS);
        let bytes = read(checkpoint, TENSORS)?;
        let tensors = candle_core::safetensors::load_buffer(&bytes, device)
            .map_err(|e| broken(&path, &format!("it is not a complete safetensors file ({})", tensor_sentence(&e))))?;
        Ok(Tensors { path, tensors, dtype })
    }

    pub(super) fn all(&self, prefix: &str, names: &[(String, Vec<usize>)]) -> Result<Vec<Tensor>> {
        names.iter().map(|(name, shape)| self.get(&format!("{prefix}{name}"), shape)).collect()
    }

    fn get(&self, name: &str, shape: &[usize]) -> Result<Tensor> {
        let other = "the configuration describes another architecture or method (method; its own section; of nerf, aug-nerf and MipNeRF \
                     sections field, sampling, perturb.field)";
        let Some(tensor) = self.tensors.get(name) else {
            return Err(damaged(&self.path, &format!("it has no tensor {name}; {other}")));
        };
        if tensor.dims() != shape {
            let found = format!("{name} has shape {:?}, expected {shape:?}; {other}", tensor.dims());
            return Err(damaged(&self.path, &found));
        }
        Ok(tensor.to_dtype(self.dtype)?)
    }
}

impl Trainer {
    /// Writes a checkpoint below `checkpoints` and returns its folder. Keeps the newest `train.keep_checkpoints` of
    /// the scheduled ones (every `train.checkpoint_every` steps, and the last), and the newest of all. A checkpoint
    /// that the clock, an evaluation or a stop added is deleted when the next one comes. A stopped run therefore ends
    /// with the same folders as one that never stopped.
    pub fn save(&self, checkpoints: &Path) -> Result<PathBuf> {
        std::fs::create_dir_all(checkpoints).map_err(|e| Error::unwritable(checkpoints, &e))?;
        clean_temporaries(checkpoints)?;
        let target = folder(checkpoints, self.step_count());
        if !target.exists() {
            self.write(&target)?;
        }
        self.prune(checkpoints)?;
        Ok(target)
    }

    fn write(&self, target: &Path) -> Result<()> {
        let dir = AtomicDir::new(target)?;
        let (tensors, config) = (self.tensor_bytes()?, self.config.to_toml());
        let state = json_bytes(&self.state()).expect("counters are plain data");
        sums::write(dir.path(), &[(TENSORS, &tensors), (STATE, &state), (CONFIG, config.as_bytes())])?;
        dir.commit()
    }

    fn prune(&self, checkpoints: &Path) -> Result<()> {
        let train = &self.config.train;
        // Only a stop writes a checkpoint at step 0.
        let scheduled = |step: u64| step > 0 && step.is_multiple_of(train.checkpoint_every) || step == train.steps;
        let mut kept = 0;
        for (step, old) in list(checkpoints)?.into_iter().rev() {
            kept += usize::from(scheduled(step));
            let keep = if scheduled(step) { kept <= train.keep_checkpoints } else { step == self.step_count() };
            if !keep {
                discard(&old).map_err(|e| Error::unwritable(&old, &e))?;
            }
        }
        Ok(())
    }

    /// Returns counters and provenance at this step. Dead steps are counted as far as steps are measured.
    pub fn state(&self) -> State {
        let mut state = State { empty_steps: self.stepper.borrow().dead_steps(), ..self.state.clone() };
        state.touch(&self.runtime);
        state
    }

    fn tensor_bytes(&self) -> Result<Vec<u8>> {
        let (variables, stepper) = (self.model()?.variables(), self.stepper.borrow());
        let mut named: Vec<(String, Tensor)> = Vec::new();
        for ((name, var), moments) in variables.iter().zip(stepper.moments()) {
            named.push((name.clone(), var.as_tensor().clone()));
            named.push((format!("adam.first.{name}"), moments.first.clone()));
            named.push((format!("adam.second.{name}"), moments.second.clone()));
        }
        // No metadata: its map has no fixed order.
        safetensors::serialize(named, None)
            .map_err(|e| Error::Checkpoint(format!("cannot serialise the checkpoint: {e}")))
    }

    /// Continues from a checkpoint folder.
    ///
    /// # Errors
    /// [`Error::Checkpoint`]: the checkpoint is damaged, or was written under other settings.
    pub fn resume(
        checkpoint: &Path,
        config: &Resolved,
        scene: &Scene,
        dtype: DType,
        runtime: &Runtime,
    ) -> Result<Trainer> {
        accelerator::check(config, runtime)?;
        let inputs = Inputs { config, scene, dtype, runtime };
        runtime.install(|| {
            let state = load_state(checkpoint)?;
            check_config(checkpoint, &state, config)?;
            let (model, moments) = inputs.restore(checkpoint, state.step, true)?;
            let steps = inputs.steps(&model, moments)?;
            Ok(inputs.trainer(model, steps, state))
        })
    }
}

impl Inputs<'_> {
    /// Returns the parameters of a checkpoint as they are at `step`, and its moments if the run `goes_on`.
    pub(super) fn restore(self, checkpoint: &Path, step: u64, goes_on: bool) -> Result<(Model, Option<Vec<Moments>>)> {
        let names = Model::parameter_names(self.config);
        let tensors = Tensors::open(checkpoint, self.dtype, self.runtime.device())?;
        let model = Model::from_parameters(self.config, tensors.all("", &names)?)?.at_step(self.config, step)?;
        let moments = if goes_on { Some(tensors.moments(&names)?) } else { None };
        Ok((model, moments))
    }
}
