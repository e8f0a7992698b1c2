//! The reader of a scene folder.

use std::path::Path;

use super::formats::{FORMATS, Format};
use super::images::ENDINGS;
use crate::base::{Error, Result};
use crate::settings::{DataConfig, DataKind};

/// Returns the kind of scene that `config` names: `config.kind` if it is set, and the kind of the folder's files
/// otherwise. It looks for `poses_bounds.npy`, `transforms_train.json`, `transforms.json` and COLMAP's `sparse/0`, in
/// the order of [`FORMATS`]. Without a folder it is the built-in scene.
pub fn detect(config: &DataConfig) -> Result<DataKind> {
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

fn check_folder(dir: &Path) -> Result<()> {
    let found = std::fs::metadata(dir).map_err(|e| Error::unreadable(dir, &e))?;
    if !found.is_dir() {
        return Err(Error::Data(format!("{} is a file, but a scene is a folder; name the folder", dir.display())));
    }
    Ok(())
}

/// Returns the error for a folder that no format detects: what was looked for, and what to do.
fn unknown(dir: &Path) -> Error {
    for (photos, scene) in [(dir.to_path_buf(), Path::new("SCENE")), (dir.join("images"), dir)] {
        if let count @ 1.. = count_images(&photos) {
            return without_cameras(&photos, count, scene);
        }
    }
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

/// Counts the files of a folder that are images by their endings.
fn count_images(dir: &Path) -> usize {
    let entries = std::fs::read_dir(dir).into_iter().flatten().flatten();
    let ending = |path: &Path| path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
    entries.filter(|entry| ending(&entry.path()).is_some_and(|ending| ENDINGS.contains(&&*ending))).count()
}

/// Returns the error for photos whose cameras are unknown, with the commands that find them for the folder `scene`.
fn without_cameras(photos: &Path, count: usize, scene: &Path) -> Error {
    let (shown, scene) = (photos.display(), scene.display());
    Error::Data(format!(
        "{shown}: {count} photos without cameras; put them into {scene}/images and find the cameras with `colmap \
         automatic_reconstructor --workspace_path {scene} --image_path {scene}/images`, or run `ns-process-data images --data \
         {shown} --output-dir {scene}`, then check {scene}"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(dir: &Path) -> String {
        detect(&DataConfig { dir: dir.to_string_lossy().into_owned(), ..DataConfig::default() })
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn photos_without_cameras_are_answered_with_the_commands_that_find_them() {
        let dir = tempfile::tempdir().unwrap();
        assert!(refusal(dir.path()).contains("is no scene"));
        let images = dir.path().join("images");
        std::fs::create_dir(&images).unwrap();
        std::fs::write(images.join("a.JPG"), "").unwrap();
        std::fs::write(images.join("notes.txt"), "").unwrap();
        let colmap = |scene: &str| format!("--workspace_path {scene} --image_path {scene}/images`");
        for (folder, scene) in [(dir.path(), &*dir.path().to_string_lossy()), (&images, "SCENE")] {
            let message = refusal(folder);
            assert!(message.contains("images: 1 photos without cameras"), "{message}");
            assert!(message.contains(&colmap(scene)) && message.contains("`ns-process-data images"), "{message}");
        }
    }
}
