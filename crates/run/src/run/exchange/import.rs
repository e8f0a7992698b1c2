//! Imports a file of weights as the start of a run.

use std::io::Read;
use std::path::{Path, PathBuf};

use candle_core::{Device, Tensor};
use serde_json::Value as Json;
use sha2::{Digest, Sha256};
use toml::Value;

use super::nerf_pytorch::{NETWORKS, STEP, name};
use super::{Format, METADATA};
use crate::base::input::open_regular;
use crate::base::{Error, Result};
use crate::metrics::Weights;
use crate::model::Model;
use crate::settings::{Config, short_hash};

/// Largest step, that of `train.steps`.
const MOST_STEPS: u64 = 1_000_000_000;

/// Limit on octaves of an encoding, and on layers.
const MOST: usize = 64;

/// A file of weights.
pub struct Foreign {
    path: PathBuf,
    weights: Weights,
    networks: Networks,
    step: u64,
    hash: String,
}

/// The program whose tensor names the file has.
#[derive(Clone, Debug, PartialEq)]
pub enum Networks {
    /// Our own, with the configuration of the training.
    Own {
        /// The text of its `config.toml`.
        config: String,
    },
    /// nerf-pytorch, with the prefix of the names of each role.
    NerfPytorch {
        /// Role and prefix, `coarse` first.
        prefixes: Vec<(&'static str, String)>,
    },
}

impl Networks {
    /// Returns whether a tensor is one of the networks.
    fn have(&self, name: &str) -> bool {
        match self {
            Networks::Own { .. } => true,
            Networks::NerfPytorch { prefixes } => prefixes
                .iter()
                .any(|(_, prefix)| name.strip_prefix(&**prefix).is_some_and(|rest| rest.contains("_linear"))),
        }
    }
}

impl Foreign {
    /// Opens a file of [`export`](super::export) or nerf-pytorch.
    ///
    /// # Errors
    /// The file cannot be read, or has the networks of neither.
    pub fn open(path: &Path) -> Result<Foreign> {
        let format = Format::of(path)?;
        let weights = Weights::open(path)?;
        let wrong = |what: String| Error::Data(format!("{}: {what}", path.display()));
        let (networks, step) = match format {
            Format::Safetensors => {
                let said = weights.metadata(METADATA).and_then(|said| serde_json::from_str::<Json>(said).ok());
                let said = said.ok_or_else(|| {
                    wrong(format!("its metadata has no \"{METADATA}\", so it is not an export of augnerf"))
                })?;
                let config = said.get("config").and_then(Json::as_str).map(String::from);
                let config = config.ok_or_else(|| wrong("its metadata lacks the configuration (\"config\")".into()))?;
                Config::from_toml(&config, "its configuration").map_err(|error| wrong(error.to_string()))?;
                (Networks::Own { config }, said.get("step").and_then(Json::as_u64))
            }
            Format::Torch => {
                let networks = nerf_pytorch(&weights).ok_or_else(|| {
                    let mut names: Vec<&str> = weights.names().collect();
                    names.sort_unstable();
                    let some = names.iter().take(3).copied().collect::<Vec<&str>>().join(", ");
                    wrong(format!(
                        "it has no network of nerf-pytorch (network_fn_state_dict with pts_linears.0.weight); the first of its {} tensors \
                         are: {some}",
                        names.len()
                    ))
                })?;
                let step = weights.integer(STEP).map(|step| u64::try_from(step).ok());
                (networks, step.unwrap_or(Some(0)))
            }
        };
        // A tensor that cannot be read would otherwise count as one that is not there.
        let own = |name: &str| networks.have(name);
        if let Some((name, reason)) = weights.unreadable().into_iter().find(|(name, _)| own(name)) {
            return Err(wrong(format!("{name} cannot be read ({reason}); get the complete file")));
        }
        let step = step.filter(|step| *step <= MOST_STEPS);
        let step = step.ok_or_else(|| wrong(format!("its step is not an integer from 0 to {MOST_STEPS}")))?;
        Ok(Foreign { hash: hash(path)?, path: path.to_path_buf(), weights, networks, step })
    }

    /// Returns the program of the networks.
    pub fn networks(&self) -> &Networks {
        &self.networks
    }

    /// Returns the step of the weights.
    pub fn step(&self) -> u64 {
        self.step
    }

    /// Returns the run's setting `train.parent`.
    pub fn parent(&self) -> String {
        format!("weights {}", self.hash)
    }

    /// Returns the settings that follow from the shapes of nerf-pytorch's tensors, as `(path, value)`. Our own files
    /// contain the configuration, so there are none.
    ///
    /// # Errors
    /// This program does not have the networks.
    pub fn settings(&self) -> Result<Vec<(Vec<String>, Value)>> {
        let Networks::NerfPytorch { prefixes } = &self.networks else { return Ok(Vec::new()) };
        let mut settings = self.shapes(&prefixes[0].1)?;
        for (role, prefix) in &prefixes[1..] {
            let other = self.shapes(prefix)?;
            if let Some(((path, a), (_, b))) = settings.iter().zip(&other).find(|(a, b)| a != b) {
                return Err(Error::Data(format!(
                    "{}: its {} network has {path} = {a}, and its {role} network {b}; here both have the same layers",
                    self.path.display(),
                    prefixes[0].0
                )));
            }
        }
        if prefixes.len() == 1 {
            settings.push(("sampling.fine", Value::Integer(0)));
        }
        settings.extend([
            ("field.encoding", "positional".into()),
            ("field.density_activation", "relu".into()),
            ("field.view_depth", Value::Integer(1)),
            ("field.rgb_padding", Value::Float(0.0)),
            ("data.pixel_origin", "corner".into()),
        ]);
        let path = |path: &str| path.split('.').map(String::from).collect();
        Ok(settings.into_iter().map(|(at, value)| (path(at), value)).collect())
    }

    /// Returns the settings that follow from a network's shapes.
    fn shapes(&self, prefix: &str) -> Result<Vec<(&'static str, Value)>> {
        let wrong = |what: String| Error::Data(format!("{}: {what}", self.path.display()));
        let matrix = |name: String| match self.weights.shape(&format!("{prefix}{name}")) {
            Some(&[outputs, inputs]) => Ok([outputs, inputs]),
            Some(shape) => Err(wrong(format!("{prefix}{name} has shape {shape:?}, but a layer has two dimensions"))),
            None => Err(wrong(format!(
                "{prefix}{name} is missing; only networks trained with view directions (--use_viewdirs) can be read"
            ))),
        };
        let trunk = |i: usize| format!("pts_linears.{i}.weight");
        let depth = (0..MOST).take_while(|i| self.weights.shape(&format!("{prefix}{}", trunk(*i))).is_some()).count();
        let [width, position] = matrix(trunk(0))?;
        let [neurons, view] = matrix("views_linears.0.weight".into())?;
        let octaves = |channels: usize, of: &str| match channels.checked_sub(3) {
            Some(rest) if rest % 6 == 0 && rest / 6 <= MOST => Ok(Value::Integer((rest / 6) as i64)),
            _ => Err(wrong(format!("{of} has {channels} channels, but an encoding of n octaves has 3 + 6 n"))),
        };
        let view_channels = view
            .checked_sub(width)
            .ok_or_else(|| wrong("views_linears.0 has fewer inputs than the trunk has outputs".into()))?;
        let mut skips = Vec::new();
        for i in 1..depth {
            if matrix(trunk(i))?[1] == width + position {
                skips.push(Value::Integer(i as i64));
            }
        }
        Ok(vec![
            ("field.width", Value::Integer(width as i64)),
            ("field.depth", Value::Integer(depth as i64)),
            ("field.skips", Value::Array(skips)),
            ("field.position_octaves", octaves(position, "a position")?),
            ("field.view_octaves", octaves(view_channels, "a view direction")?),
            ("field.view_width", Value::Integer(neurons as i64)),
        ])
    }

    /// Returns the parameters of a configuration, in their order.
    ///
    /// # Errors
    /// A parameter is missing, of another shape, or not finite.
    pub fn values(&self, config: &Config, device: &Device) -> Result<Vec<Tensor>> {
        let value = |(ours, shape): (String, Vec<usize>)| {
            let theirs = self.name(&ours).ok_or_else(|| {
                Error::Config(format!(
                    "{}: the settings need {ours}, which networks of nerf-pytorch do not have",
                    self.path.display()
                ))
            })?;
            let tensor = self.weights.get(&[theirs], &shape, device)?;
            let finite = tensor.flatten_all()?.to_vec1::<f32>()?.iter().all(|value| value.is_finite());
            finite.then_some(tensor).ok_or_else(|| {
                Error::Data(format!(
                    "{}: {ours} has values that are not finite, so the training diverged",
                    self.path.display()
                ))
            })
        };
        let names = Model::parameter_names(config);
        let taken: Vec<String> = names.iter().filter_map(|(ours, _)| self.name(ours)).collect();
        let mut left: Vec<&str> = self.weights.names().filter(|name| self.networks.have(name)).collect();
        left.retain(|name| !taken.iter().any(|taken| taken == name));
        left.sort_unstable();
        if let Some(first) = left.first() {
            return Err(Error::Data(format!(
                "{}: no layer takes {} of its tensors, such as {first}; a network would be another one without them",
                self.path.display(),
                left.len()
            )));
        }
        names.into_iter().map(value).collect()
    }

    /// Returns a parameter's name in the file.
    fn name(&self, ours: &str) -> Option<String> {
        let Networks::NerfPytorch { prefixes } = &self.networks else { return Some(ours.to_string()) };
        let (role, layer) = ours.split_once('.')?;
        let (_, prefix) = prefixes.iter().find(|(known, _)| *known == role)?;
        Some(format!("{prefix}{}", name(layer)?))
    }
}

/// Returns the hash of a file's bytes.
fn hash(path: &Path) -> Result<String> {
    let unreadable = |e: std::io::Error| Error::unreadable(path, &e);
    let (mut file, mut digest) = (open_regular(path).map_err(unreadable)?, Sha256::new());
    let mut bytes = vec![0; 1 << 16];
    loop {
        match file.read(&mut bytes).map_err(unreadable)? {
            0 => return Ok(short_hash(digest)),
            read => digest.update(&bytes[..read]),
        }
    }
}

/// Returns the networks of a checkpoint, or of a bare state dictionary with one network.
fn nerf_pytorch(weights: &Weights) -> Option<Networks> {
    // Networks that were trained on several devices have the prefix `module.`.
    let prefix = |outer: &str| {
        let prefixes = ["", "module."].map(|inner| format!("{outer}{inner}"));
        prefixes.into_iter().find(|prefix| weights.shape(&format!("{prefix}pts_linears.0.weight")).is_some())
    };
    let mut prefixes: Vec<(&str, String)> =
        NETWORKS.into_iter().filter_map(|(role, key)| Some((role, prefix(&format!("{key}."))?))).collect();
    if prefixes.is_empty() {
        prefixes.push(("coarse", prefix("")?));
    }
    (prefixes[0].0 == "coarse").then_some(Networks::NerfPytorch { prefixes })
}
