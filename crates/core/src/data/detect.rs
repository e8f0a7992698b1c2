//! Which reader a scene folder is for.

use std::path::Path;

use super::formats::{FORMATS, Format};
use crate::base::{Error, Result};
use crate::settings::{DataConfig, DataKind};

/// The kind of scene that `config` names: `config.kind` where it is set, by the files in the folder
/// otherwise (`poses_bounds.npy`, `transforms_train.json`, `transforms.json`, COLMAP's `sparse/0`: the order of
/// [`FORMATS`]). No folder means the embedded scene.
pub fn detect(config: &DataConfig) -> Result<DataKind> {
    let embedded = Format::of(config.kind).is_some_and(|format| format.marker.is_none());
    if config.dir.is_empty() {
        return match config.kind {
            DataKind::Auto => Ok(DataKind::BuiltinBlender),
            kind if embedded => Ok(kind),
            kind => Err(Error::Config(format!(
                "data.kind = \"{}\" reads a scene folder, but data.dir is empty: set it, or leave data.kind to \"auto\" \
                 for the embedded scene",
                kind.name()
            ))),
        };
    }
    if embedded {
        return Err(Error::Config(format!(
            "data.kind = \"{}\" is the embedded scene, but data.dir = \"{}\": leave one of them empty",
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

fn check_folder(dir: &Path) -> Result<()> {
    let found = std::fs::metadata(dir).map_err(|e| Error::unreadable(dir, &e))?;
    if !found.is_dir() {
        return Err(Error::Data(format!("{} is a file, but a scene is a folder; name the folder", dir.display())));
    }
    Ok(())
}

/// Says what was looked for, and which subfolders would do.
fn unknown(dir: &Path) -> Error {
    let entries = std::fs::read_dir(dir).into_iter().flatten().flatten();
    let mut scenes: Vec<String> = entries
        .filter(|entry| Format::of_folder(&entry.path()).is_some())
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    scenes.sort();
    let hint = match scenes.len() {
        0 => String::new(),
        _ => format!("; scenes lie one level deeper: {}", scenes.join(", ")),
    };
    let markers: Vec<&str> = FORMATS.iter().filter_map(|format| format.marker).collect();
    let (last, first) = markers.split_last().expect("some formats are folders");
    Error::Data(format!("{} is no scene: it has none of {} and {last}{hint}", dir.display(), first.join(", ")))
}
