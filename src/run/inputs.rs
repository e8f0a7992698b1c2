//! What an experiment needs besides its settings: the scene, and LPIPS networks.

use std::path::Path;

use candle_core::Device;

use crate::base::{Error, Listener, Result};
use crate::data::{self, Scene};
use crate::metrics::{Backbone, Lpips};
use crate::settings::{Config, Located, NO_REFERENCE, Resolved, scene_name};

use super::BUILTIN;

/// Finds the kind of scene and where it lies, and fills what depends on that.
///
/// # Errors
/// A folder or reference mesh that is not there; a folder that no format knows; settings that contradict the scene.
pub fn locate_scene(mut config: Config) -> Result<Located> {
    let kind = data::detect(&config.data)?;
    if !config.data.dir.is_empty() {
        // Found again from any working directory; `.` gets its real name.
        let dir = Path::new(&config.data.dir);
        let dir = std::fs::canonicalize(dir).map_err(|e| Error::unreadable(dir, &e))?;
        config.data.dir = dir.to_string_lossy().into_owned();
    }
    let mesh = &mut config.eval.mesh;
    if mesh.resolution > 0 && !["", BUILTIN, NO_REFERENCE].contains(&mesh.reference.as_str()) {
        let file = Path::new(&mesh.reference);
        let file = std::fs::canonicalize(file).map_err(|e| Error::unreadable(file, &e))?;
        mesh.reference = file.to_string_lossy().into_owned();
    }
    if config.data.name.is_empty() {
        config.data.name = scene_name(&config.data.dir);
    }
    config.locate(kind)
}

/// Locates and loads the scene of a configuration, which it resolves.
///
/// # Errors
/// Those of [`locate_scene`]; pictures or poses that cannot be read.
///
/// ```
/// use augnerf::run::load_scene;
/// use augnerf::settings::{Preset, build, parse_assignment};
///
/// // Without a folder in data.dir, the scene is the embedded one.
/// let draft = build(Some(Preset::Smoke), None, &[parse_assignment("data.width=24")?])?;
/// let (config, scene) = load_scene(draft, &())?;
/// assert_eq!((scene.name.as_str(), scene.train[0].camera.width), ("builtin", 24));
/// assert_eq!((scene.near, scene.far), (2.0, 6.0));
/// assert_eq!(config.data.kind.name(), scene.kind);
/// # Ok::<(), augnerf::base::Error>(())
/// ```
pub fn load_scene(config: Config, events: &dyn Listener) -> Result<(Resolved, Scene)> {
    let located = locate_scene(config)?;
    let mut scene = data::load(&located.data, located.seed, events)?;
    scene.name.clone_from(&located.data.name);
    Ok((located.resolve(scene.extent()), scene))
}

/// Every LPIPS backbone whose weights the folder holds; none for an empty name.
///
/// # Errors
/// A folder in which no backbone is complete; weights that cannot be read.
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
