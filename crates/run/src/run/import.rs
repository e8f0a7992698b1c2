//! Imports a checkpoint of nerf-pytorch as the start of a run: `.tar`, `.pth` or `.pt` of `torch.save`.

use std::io::Read;
use std::path::{Path, PathBuf};

use candle_core::{Device, Tensor};
use sha2::{Digest, Sha256};
use toml::Value;

use crate::base::input::open_regular;
use crate::base::{Error, Result};
use crate::metrics::Weights;
use crate::model::Model;
use crate::settings::{Config, short_hash};

/// Keys of a checkpoint: networks by role, step.
const NETWORKS: [(&str, &str); 2] = [("coarse", "network_fn_state_dict"), ("fine", "network_fine_state_dict")];
const STEP: &str = "global_step";

/// Largest step, that of `train.steps`.
const MOST_STEPS: u64 = 1_000_000_000;

/// Limit on octaves of an encoding, and on layers.
const MOST: usize = 64;

/// A checkpoint of nerf-pytorch.
pub struct Foreign {
    path: PathBuf,
    weights: Weights,
    prefixes: Prefixes,
    step: u64,
    hash: String,
}

/// Roles of networks and prefixes of their tensors' names, `coarse` first.
type Prefixes = Vec<(&'static str, String)>;

/// Returns whether a tensor is one of the networks.
fn is_own(prefixes: &[(&str, String)], name: &str) -> bool {
    prefixes.iter().any(|(_, prefix)| name.strip_prefix(&**prefix).is_some_and(|rest| rest.contains("_linear")))
}

impl Foreign {
    /// Opens a checkpoint.
    ///
    /// # Errors
    /// The file cannot be read, or has no networks of nerf-pytorch.
    pub fn open(path: &Path) -> Result<Foreign> {
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase()).unwrap_or_default();
        if !["tar", "pth", "pt"].contains(&ending.as_str()) {
            return Err(Error::Config(format!(
                "{}: unknown file type; checkpoints of nerf-pytorch are .tar, .pth or .pt; to move a run of augnerf, copy its folder",
                path.display()
            )));
        }
        let weights = Weights::open(path)?;
        let wrong = |what: String| Error::Data(format!("{}: {what}", path.display()));
        let prefixes = nerf_pytorch(&weights).ok_or_else(|| {
            let mut names: Vec<&str> = weights.names().collect();
            names.sort_unstable();
            let some = names.iter().take(3).copied().collect::<Vec<&str>>().join(", ");
            wrong(format!(
                "it has no network of nerf-pytorch (network_fn_state_dict with pts_linears.0.weight); the first of its {} tensors \
                 are: {some}",
                names.len()
            ))
        })?;
        // A tensor that cannot be read would otherwise count as one that is not there.
        if let Some((name, reason)) = weights.unreadable().into_iter().find(|(name, _)| is_own(&prefixes, name)) {
            return Err(wrong(format!("{name} cannot be read ({reason}); get the complete file")));
        }
        let step = weights.integer(STEP).unwrap_or(0);
        let step = u64::try_from(step).ok().filter(|step| *step <= MOST_STEPS);
        let step = step.ok_or_else(|| wrong(format!("its step is not an integer from 0 to {MOST_STEPS}")))?;
        Ok(Foreign { hash: hash(path)?, path: path.to_path_buf(), weights, prefixes, step })
    }

    /// Returns the step of the weights.
    pub fn step(&self) -> u64 {
        self.step
    }

    /// Returns the run's setting `train.parent`.
    pub fn parent(&self) -> String {
        format!("weights {}", self.hash)
    }

    /// Returns the settings that follow from the shapes of tensors, as `(path, value)`.
    ///
    /// # Errors
    /// This program does not have the networks.
    pub fn settings(&self) -> Result<Vec<(Vec<String>, Value)>> {
        let prefixes = &self.prefixes;
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
        let mut left: Vec<&str> = self.weights.names().filter(|name| is_own(&self.prefixes, name)).collect();
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
        let (role, layer) = ours.split_once('.')?;
        let (_, prefix) = self.prefixes.iter().find(|(known, _)| *known == role)?;
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
fn nerf_pytorch(weights: &Weights) -> Option<Prefixes> {
    // Networks that were trained on several devices have the prefix `module.`.
    let prefix = |outer: &str| {
        let prefixes = ["", "module."].map(|inner| format!("{outer}{inner}"));
        prefixes.into_iter().find(|prefix| weights.shape(&format!("{prefix}pts_linears.0.weight")).is_some())
    };
    let mut prefixes: Prefixes =
        NETWORKS.into_iter().filter_map(|(role, key)| Some((role, prefix(&format!("{key}."))?))).collect();
    if prefixes.is_empty() {
        prefixes.push(("coarse", prefix("")?));
    }
    (prefixes[0].0 == "coarse").then_some(prefixes)
}

/// Returns a parameter's name in nerf-pytorch, from its name in a field here (`trunk.0.weight`), or `None` for a layer that it
/// does not have.
fn name(ours: &str) -> Option<String> {
    let (layer, kind) = ours.rsplit_once('.')?;
    let theirs = match layer {
        "density" => "alpha_linear".to_string(),
        "feature" => "feature_linear".to_string(),
        "rgb" => "rgb_linear".to_string(),
        "view" => "views_linears.0".to_string(),
        trunk => format!("pts_linears.{}", trunk.strip_prefix("trunk.")?),
    };
    Some(format!("{theirs}.{kind}"))
}
