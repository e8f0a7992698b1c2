//! The flags that describe an experiment.

use std::path::{Path, PathBuf};

use clap::Args;
use toml::Value;

use crate::base::{Error, Result};
use crate::data::{self, Format};
use crate::runtime::Runtime;
use crate::settings::{
    BuiltinScene, Config, Encoding, Method, Placing, Preset, build, check_assignment, data_section, parse_assignment,
    regularizer_hint, word,
};

use super::progress::Console;
use super::{LpipsWeights, whole};

/// Scene and settings of one experiment.
#[derive(Args)]
#[command(next_help_heading = "Experiment")]
pub struct Experiment {
    /// Scene folder (LLFF, Blender, transforms.json, COLMAP), here or in AUGNERF_DATA; builtin:17 is the built-in scene
    /// number 17 [default: the built-in scene]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// fast, smoke, cpu, paper-llff, paper-blender, released-llff, released-blender, few-views, few-views-llff or
    /// few-views-blender [default: fast for the built-in scene (MipNeRF: smoke), the paper's for others]
    #[arg(long, value_name = "NAME")]
    preset: Option<String>,
    /// TOML file with settings, over the preset's; a run's config.toml repeats that run
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// nerf, aug-nerf, mip-nerf, aug-mip-nerf, srn, nv or llff [default: nerf]
    #[arg(long, value_name = "METHOD")]
    method: Option<String>,
    /// Seed of all random numbers [default: 0]
    #[arg(long, value_name = "N", value_parser = whole::<i64>(0..=i64::MAX as u64))]
    seed: Option<i64>,
    /// Any setting, over everything else: --set train.steps=2000
    #[arg(long, value_name = "FIELD=VALUE")]
    set: Vec<String>,
}

/// The environment variable that names a folder of scenes.
const DATA_ROOT: &str = "AUGNERF_DATA";

/// Returns the scene folder that a name means: a folder here, otherwise one in `AUGNERF_DATA` or one level deeper, which is
/// printed. `flag` begins the errors: `--data `, or nothing for an argument without a flag.
///
/// # Errors
/// [`Error::Data`]: no such folder, or several in `AUGNERF_DATA`.
fn scene_folder(flag: &str, named: &Path, console: &Console) -> Result<PathBuf> {
    let here = std::path::absolute(named).map_err(|e| Error::unreadable(named, &e))?;
    if let Some(folder) = data::scene_of_file(&here) {
        console.say(&format!("scene: {}", folder.display()));
        return Ok(folder);
    }
    if here.symlink_metadata().is_ok() {
        return Ok(here);
    }
    let root = std::env::var_os(DATA_ROOT).filter(|root| !root.is_empty() && named.is_relative());
    let root = root.map(PathBuf::from).unwrap_or_default();
    let entries = std::fs::read_dir(&root).into_iter().flatten().flatten();
    let mut deeper: Vec<PathBuf> = entries.map(|entry| entry.path().join(named)).filter(|path| path.is_dir()).collect();
    deeper.sort();
    let below = root.join(named);
    let found = if below.is_dir() { vec![below] } else { deeper };
    let place =
        if root.as_os_str().is_empty() { DATA_ROOT.into() } else { format!("{DATA_ROOT} ({})", root.display()) };
    let named = named.display();
    match &found[..] {
        [] => {
            let without = if flag.is_empty() { "none" } else { "omit --data" };
            Err(Error::Data(format!(
                "{flag}{named}: no such folder, here or in {place}; name a scene folder, or {without} for the built-in scene"
            )))
        }
        [scene] => {
            console.say(&format!("scene: {} ({DATA_ROOT})", scene.display()));
            std::path::absolute(scene).map_err(|e| Error::unreadable(scene, &e))
        }
        several => {
            let several: Vec<String> = several.iter().map(|path| path.display().to_string()).collect();
            Err(Error::Data(format!(
                "{flag}{named}: not here, and several in {place}; name one of {}",
                several.join(", ")
            )))
        }
    }
}

/// Returns the settings that choose the scene of a name: a folder as [`scene_folder`] finds it, or a built-in scene.
///
/// # Errors
/// Those of [`scene_folder`].
pub fn scene_settings(flag: &str, named: &Path, console: &Console) -> Result<Assignments> {
    let of_data = |key: &str, value: &str| (vec!["data".to_string(), key.to_string()], Value::String(value.into()));
    let folder = scene_folder(flag, named, console);
    // A folder of that name comes first.
    if let (Err(_), Some(builtin)) = (&folder, named.to_str().and_then(BuiltinScene::named)) {
        let (dir, kind) = builtin.settings();
        return Ok(vec![of_data("dir", &dir), of_data("kind", kind)]);
    }
    Ok(vec![of_data("dir", &folder?.to_string_lossy())])
}

/// Parses the `--set` of a command that reads a scene and trains nothing: settings of section `data`, and those of `further`.
/// `reader` names the command and these settings in errors, `scene` the argument that names the scene.
///
/// # Errors
/// [`Error::Config`]: no such setting, one that the command does not read, or `data.dir`.
pub fn data_settings(set: &[String], further: &[&str], reader: &str, scene: &str) -> Result<Assignments> {
    let parse = |text: &String| {
        let (path, value) = parse_assignment(text)?;
        // First, because an unknown setting is answered with the nearest one.
        check_assignment("--set", &path, &value)?;
        let name = path.join(".");
        if name == "data.dir" || name == "data" && value.get("dir").is_some() {
            return Err(Error::Config(format!("--set data.dir: {scene} names the scene; use that instead")));
        }
        if path[0] != "data" && !further.contains(&name.as_str()) {
            return Err(Error::Config(format!("--set {name}: not read by {reader}; omit it")));
        }
        Ok((path, value))
    };
    set.iter().map(parse).collect()
}

/// Prints a note for each of the settings that has no effect; `why` returns the reason.
pub fn say_without_effect(
    settings: impl Iterator<Item = String>,
    why: impl Fn(&str) -> Option<String>,
    console: &Console,
) {
    for setting in settings {
        if let Some(why) = why(&setting) {
            console.say(&format!("--set {setting} has no effect: {why}"));
        }
    }
}

/// Settings as `(path, value)`.
type Assignments = Vec<(Vec<String>, Value)>;

/// Settings below and above those of the command line.
pub struct Base<'a> {
    /// The settings file if `--config` names none.
    pub file: Option<&'a Path>,
    /// Settings that the command line overrides.
    pub first: Assignments,
    /// Settings that override the command line.
    pub last: Assignments,
    /// Maps the preset that suits the scene, if `--preset` names none.
    pub preset: fn(Preset) -> Preset,
    /// Of a training that starts: whether its device samples occupied cells, which preset `fast` uses for objects.
    pub occupied: Option<bool>,
}

impl Default for Base<'_> {
    /// Returns a base that adds nothing.
    fn default() -> Self {
        Base { file: None, first: Vec::new(), last: Vec::new(), preset: |preset| preset, occupied: None }
    }
}

impl Base<'_> {
    /// Returns a base for a training on a device. No accelerator trains with occupied cells.
    pub fn of_training(runtime: &Runtime) -> Self {
        Base { occupied: Some(runtime.is_cpu()), ..Base::default() }
    }
}

impl Experiment {
    /// Returns whether the command line says how long to train: by a preset, a file or a number of steps.
    pub fn names_length(&self) -> bool {
        let steps = |text: &String| text.split_once('=').is_some_and(|(path, _)| path.trim() == "train.steps");
        self.preset.is_some() || self.config.is_some() || self.set.iter().any(steps)
    }

    /// Returns the settings that `--set` names.
    pub fn settings(&self) -> impl Iterator<Item = String> {
        let names = self.set.iter().filter_map(|text| parse_assignment(text).ok());
        names.map(|(path, _)| path.join("."))
    }

    /// Builds the settings of preset, file and flags, in that order.
    pub fn config(&self, console: &Console) -> Result<Config> {
        self.config_over(Base::default(), &LpipsWeights::default(), console)
    }

    /// Builds the settings over a base, with the folder of LPIPS weights. `--preset` and `--config` replace the base's file.
    pub fn config_over(&self, base: Base, weights: &LpipsWeights, console: &Console) -> Result<Config> {
        let file = self.config.as_deref().or(base.file.filter(|_| self.preset.is_none()));
        let mut assignments = base.first;
        let mut assign = |path: &[&str], value: Value| {
            assignments.push((path.iter().map(|part| part.to_string()).collect::<Vec<_>>(), value));
        };
        if let Some(data) = &self.data {
            // The file may belong to another scene.
            if self.config.is_none() && file.is_some() {
                assign(&["data", "kind"], Value::String("auto".into()));
                assign(&["data", "name"], Value::String(String::new()));
            }
            for (path, value) in scene_settings("--data ", data, console)? {
                assign(&path.iter().map(String::as_str).collect::<Vec<_>>(), value);
            }
        }
        if let Some(weights) = &weights.lpips_weights {
            let weights = std::path::absolute(weights).map_err(|e| Error::unreadable(weights, &e))?;
            assign(&["eval", "lpips_weights"], Value::String(weights.to_string_lossy().into_owned()));
        }
        if let Some(method) = &self.method {
            check_method(method)?;
            assign(&["method"], Value::String(method.clone()));
        }
        if let Some(seed) = self.seed {
            assign(&["seed"], Value::Integer(seed));
        }
        for text in &self.set {
            assignments.push(parse_assignment(text)?);
        }
        assignments.extend(base.last);
        let mut preset = self.preset.as_deref().map(Preset::parse).transpose()?;
        if file.is_some() {
            return build(preset, file, &assignments);
        }
        let format = Format::of(data::detect(&data_section(&assignments)?)?);
        let method = named_method(&assignments);
        if preset.is_none() {
            // The preset that suits the scene.
            preset = format.map(|format| Preset::parse(format.preset)).transpose()?.map(base.preset);
            if preset == Some(Preset::Fast) && method.representation(Encoding::Hash).is_none() {
                preset = Some(Preset::Smoke);
            }
        }
        let config = build(preset, None, &assignments)?;
        let is_object = format.is_some_and(|format| format.object_half.is_some());
        match base.occupied.filter(|_| is_object && preset == Some(Preset::Fast) && config.on_hash_grid()) {
            Some(true) => Ok(in_occupied_cells(config, assignments, console)),
            Some(false) => {
                console
                    .say("preset fast samples this object as other scenes, because this device has no occupied cells");
                Ok(config)
            }
            None => Ok(config),
        }
    }
}

/// Settings that say which samples a ray has.
const SAMPLES: [&str; 5] =
    ["sampling", "sampling.kind", "sampling.coarse", "sampling.fine", "sampling.resample_padding"];

/// Returns the settings of preset `fast` for an object, which samples occupied cells, unless a setting refuses them. Prints which.
fn in_occupied_cells(config: Config, mut assignments: Assignments, console: &Console) -> Config {
    if let Some(name) = assignments.iter().map(|(path, _)| path.join(".")).find(|name| SAMPLES.contains(&name.as_str()))
    {
        if name != "sampling.kind" && config.sampling.kind == Placing::Resampled {
            console.say(&format!("{name} is set: preset fast does not use occupied cells, and takes longer"));
        }
        return config;
    }
    assignments.push(placing(Placing::Occupancy));
    match build(Some(Preset::Fast), None, &assignments) {
        Ok(occupied) => {
            console.say(
                "preset fast samples only occupied cells of this object, for speed; --set sampling.kind=resampled samples as on other scenes",
            );
            occupied
        }
        Err(refused) => {
            // What follows the first part is advice on a setting that nobody set.
            let why = refused.to_string();
            let why = why.split(';').next().unwrap_or_default();
            let like = "compare with runs that have sampling.kind=resampled";
            console.say(&format!("preset fast does not use occupied cells here, so {like}: {why}"));
            config
        }
    }
}

/// Returns the setting of a kind of samples.
pub fn placing(kind: Placing) -> (Vec<String>, Value) {
    (vec!["sampling".into(), "kind".into()], Value::String(word(kind)))
}

/// Checks the name of a method.
///
/// # Errors
/// [`Error::Config`]: no such method; a regularizer is answered with its setting.
fn check_method(name: &str) -> Result<()> {
    let methods = Method::ALL.map(Method::name);
    if methods.contains(&name) {
        return Ok(());
    }
    let unknown = || format!("no such method; choose one of {}", methods.join(", "));
    let found = regularizer_hint(name, "--set ").unwrap_or_else(unknown);
    Err(Error::Config(format!("--method {name}: {found}")))
}

/// Returns the method that settings name, otherwise the default one. An unknown name is refused later.
fn named_method(assignments: &Assignments) -> Method {
    let named = assignments.iter().rev().find(|(path, _)| path[..] == ["method"]);
    named.and_then(|(_, method)| method.clone().try_into().ok()).unwrap_or_default()
}
