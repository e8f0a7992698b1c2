//! Inputs of an experiment besides its settings: the scene, and LPIPS networks.

use std::path::Path;

use candle_core::Device;

use crate::base::{Error, Event, Listener, Result};
use crate::data::formats::llff::settle_orbit;
use crate::data::formats::transforms;
use crate::data::{self, Photos, Scene};
use crate::metrics::{Backbone, Lpips};
use crate::settings::{Config, DataKind, NO_REFERENCE, Resolved, Spacing, Split, scene_name};

use super::scene_file::RecordedScene;
use super::{RunDir, builtin_surface};

/// Finds kind and location of the scene, and fills the settings that depend on them.
///
/// # Errors
/// A folder or reference mesh is missing; no format matches the folder; settings contradict the scene.
pub fn locate_scene(config: Config) -> Result<Config> {
    locate(config).map(|(config, _)| config)
}

/// Does the same, and returns a note for a capture that surrounds something.
fn locate(config: Config) -> Result<(Config, Option<String>)> {
    let mut config = find(config)?;
    let orbit = settle_orbit(&mut config.data);
    if config.data.kind == DataKind::Transforms && config.data.split.is_none() {
        let named = transforms::is_named(Path::new(&config.data.dir))?;
        config.data.split = named.then_some(Split::Own);
    }
    let kind = config.data.kind;
    Ok((config.locate(kind)?, orbit))
}

/// Finds the kind of scene, and the paths of scene and mesh.
fn find(mut config: Config) -> Result<Config> {
    let kind = data::detect(&config.data)?;
    if !config.data.is_builtin() {
        // Absolute, so that it is found from any working directory; `.` gets its real name.
        let dir = Path::new(&config.data.dir);
        let dir = std::fs::canonicalize(dir).map_err(|e| Error::unreadable(dir, &e))?;
        config.data.dir = dir.to_string_lossy().into_owned();
    }
    let mesh = &mut config.eval.mesh;
    let is_named = ["", NO_REFERENCE].contains(&mesh.reference.as_str()) || builtin_surface(&mesh.reference).is_some();
    if mesh.resolution > 0 && !is_named {
        let file = Path::new(&mesh.reference);
        let file = std::fs::canonicalize(file).map_err(|e| Error::unreadable(file, &e))?;
        mesh.reference = file.to_string_lossy().into_owned();
    }
    if config.data.name.is_empty() {
        config.data.name = scene_name(&config.data);
    }
    config.data.kind = kind;
    Ok(config)
}

/// Locates and loads the scene of a configuration, which it resolves.
///
/// # Errors
/// Those of [`locate_scene`]; images or poses cannot be read.
///
/// ```
/// # mod augnerf { pub use augnerf_base as base; pub use augnerf_nerf::*; pub use augnerf_run::*; pub use candle_core; }
/// use augnerf::run::load_scene;
/// use augnerf::settings::{Preset, build, parse_assignment};
///
/// // Without a folder in data.dir, the scene is the built-in one.
/// let draft = build(Some(Preset::Smoke), None, &[parse_assignment("data.width=24")?])?;
/// let (config, scene) = load_scene(draft, &())?;
/// assert_eq!((scene.name.as_str(), scene.train[0].camera.width), ("builtin", 24));
/// assert_eq!((scene.near, scene.far), (2.0, 6.0));
/// assert_eq!(config.data.kind.name(), scene.kind);
/// # Ok::<(), augnerf::base::Error>(())
/// ```
pub fn load_scene(config: Config, events: &dyn Listener) -> Result<(Resolved, Scene)> {
    load_scene_with(config, Photos::Read, events)
}

/// Does the same, and reads as much of the photos as is asked for.
///
/// # Errors
/// Those of [`load_scene`].
pub fn load_scene_with(config: Config, photos: Photos, events: &dyn Listener) -> Result<(Resolved, Scene)> {
    let (config, orbit) = locate(config)?;
    orbit.iter().for_each(|words| events.on(Event::Note(words)));
    let mut scene = load(&config, photos, events)?;
    scene.space.notes.extend(orbit.map(|words| ("orbit", words)));
    let kind = config.data.kind;
    Ok((config.resolve(kind, scene.extent())?, scene))
}

/// Loads the scene of a run's own settings as it was at the run's start. What was settled then is not settled again. `config` may name another folder or other views to evaluate.
///
/// # Errors
/// Those of [`load_scene`]; the scene has changed since ([`Error::Data`]).
pub fn load_scene_of(run: &RunDir, config: Config, photos: Photos, events: &dyn Listener) -> Result<(Resolved, Scene)> {
    let (begun, seen) = (run.read_config()?.data, RecordedScene::of(run)?);
    let config = find(config)?;
    let kind = config.data.kind;
    let config = config.locate(kind)?;
    let scene = load(&config, photos, events)?;
    seen.check(&scene, &config.data, begun.eval_split == config.data.eval_split)?;
    Ok((config.resolve(kind, scene.extent())?, scene))
}

/// Loads a located scene.
fn load(config: &Config, photos: Photos, events: &dyn Listener) -> Result<Scene> {
    let mut scene = data::load_with(&config.data, config.seed, photos, events)?;
    scene.name.clone_from(&config.data.name);
    check_spacing(config, &scene)?;
    Ok(scene)
}

/// Returns an error for samples that are even in disparity on rays that start at 0.
///
/// # Errors
/// [`Error::Config`].
pub fn check_spacing(config: &Config, scene: &Scene) -> Result<()> {
    if config.sampling.spacing == Spacing::Depth || scene.near > 0.0 {
        return Ok(());
    }
    Err(Error::Config(format!(
        "sampling.spacing = \"disparity\" needs rays that start beyond 0, but those of {} start at {}; set data.near",
        scene.name, scene.near
    )))
}

/// Loads every LPIPS backbone whose weights are in the folder; none for an empty name.
///
/// # Errors
/// The folder has no complete backbone; weights cannot be read.
pub fn load_lpips(dir: &str, device: &Device) -> Result<Vec<Lpips>> {
    if dir.is_empty() {
        return Ok(Vec::new());
    }
    let dir = Path::new(dir);
    let found = Lpips::available(dir)?;
    if found.is_empty() {
        let names: Vec<&str> = Backbone::ALL.iter().map(|backbone| backbone.name()).collect();
        return Err(Error::Data(format!(
            "--lpips-weights {}: no complete backbone ({}) is there; each needs its linear layers (NAME_lin_v0.1.pth) \
             and its features",
            dir.display(),
            names.join(", ")
        )));
    }
    let loaded = found.into_iter().map(|backbone| Lpips::load(dir, backbone, device)).collect::<Result<Vec<_>>>()?;
    Ok(loaded.into_iter().flatten().collect())
}
