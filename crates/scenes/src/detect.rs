//! The reader of a scene folder.

use std::path::Path;

use super::formats::Format;
use super::lookalikes::{check_folder, unknown};
use crate::settings::{DataConfig, DataKind};
use augnerf_base::{Error, Result};

/// Returns the kind of scene that `config` names: `config.kind` if it is set, and the kind of the folder's files
/// otherwise. It looks for `poses_bounds.npy`, `transforms_train.json`, `transforms.json` and COLMAP's `sparse/0`, in
/// the order of [`FORMATS`](super::FORMATS). Without a folder it is the built-in scene.
pub fn detect(config: &DataConfig) -> Result<DataKind> {
    if let Some(scene) = config.numbered_scene() {
        return match config.kind {
            kind if kind == DataKind::Auto || kind == scene.kind => Ok(scene.kind),
            kind => Err(Error::Config(format!(
                "data.kind = \"{}\" and data.dir = \"{}\" are different scenes; set data.kind=auto",
                kind.name(),
                config.dir
            ))),
        };
    }
    let embedded = Format::of(config.kind).is_some_and(|format| format.marker.is_none());
    if config.dir.is_empty() {
        return match config.kind {
            DataKind::Auto => Ok(DataKind::BuiltinBlender),
            kind if embedded => Ok(kind),
            kind => Err(Error::Config(format!(
                "data.kind = \"{}\" reads a scene folder, but data.dir is empty: set it, or set data.kind=auto \
                 for the embedded scene",
                kind.name()
            ))),
        };
    }
    if embedded {
        return Err(Error::Config(format!(
            "data.kind = \"{}\" is the built-in scene, but data.dir = \"{}\": leave one of them empty",
            config.kind.name(),
            config.dir
        )));
    }
    let dir = Path::new(&config.dir);
    check_folder(dir)?;
    if config.kind != DataKind::Auto {
        return Ok(config.kind);
    }
    Format::of_folder(dir).map(|format| format.kind).ok_or_else(|| unknown(dir))
}
