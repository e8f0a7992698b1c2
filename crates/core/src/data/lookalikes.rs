//! What a folder or file looks like that is no scene, and how it becomes one. `docs/scenes.md` lists layouts of other programs.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use super::foreign::{ARCHIVES, UNREAD, VIDEOS};
use super::formats::{FORMATS, Format};
use super::images;
use crate::base::{Error, Result, quoted};
use crate::data::found;

/// Files by which a folder is recognized as a scene.
const MARKERS: [&str; 3] = ["poses_bounds.npy", "transforms_train.json", "transforms.json"];
/// Largest number of letters by which a mistaken name differs from a right one.
const TYPING_ERRORS: usize = 2;
/// Folders above one that may be the scene's.
const ABOVE: usize = 3;

/// Returns the folder of a scene's own file, such as `transforms.json`. `None` for other files.
pub fn scene_of_file(file: &Path) -> Option<PathBuf> {
    let is_marker = file.is_file() && file.file_name().is_some_and(|name| MARKERS.iter().any(|marker| name == *marker));
    is_marker.then(|| file.parent().map(Path::to_path_buf)).flatten()
}

/// Checks that a scene's path is a folder.
///
/// # Errors
/// It is missing, or a file; a video or an archive is answered with what makes a scene of it.
pub(super) fn check_folder(path: &Path) -> Result<()> {
    let found = std::fs::metadata(path).map_err(|e| Error::unreadable(path, &e))?;
    if found.is_dir() {
        return Ok(());
    }
    let file = path.display();
    let advice = if has_ending(path, &VIDEOS) {
        format!("it looks like a video; {}", of_video(path))
    } else if has_ending(path, &ARCHIVES) {
        "it looks like an archive; unpack it, and name the folder that it holds".into()
    } else {
        "name the folder".into()
    };
    Err(Error::Data(format!("{file} is a file, but a scene is a folder; {advice}")))
}

/// Returns the error for a folder that no format detects: what it looks like, and what to do.
pub(super) fn unknown(dir: &Path) -> Error {
    let entries = entries(dir);
    let holds = |endings: &[&str], kind: &str, advice: &dyn Fn(&Path) -> String| {
        one_of(dir, &entries, endings).map(|file| format!("{} is {kind}; {}", file.display(), advice(&file)))
    };
    // A part of a run, such as its renders, too.
    let known = dir
        .ancestors()
        .take(ABOVE)
        .find_map(of_augnerf)
        .or_else(|| inside_a_scene(dir))
        .or_else(|| without_training_file(dir))
        .or_else(|| misnamed(dir, &entries))
        .or_else(|| model_below(dir))
        .or_else(|| photos(dir, &entries))
        .or_else(|| holds(&VIDEOS, "a video", &of_video))
        .or_else(|| holds(&ARCHIVES, "an archive", &|_| "unpack it, and check the folder that it holds".into()));
    if let Some(words) = known {
        return Error::Data(words);
    }
    let is_scene = |name: &&String| Format::of_folder(&dir.join(name)).is_some();
    let scenes: Vec<&str> = entries.iter().filter(is_scene).map(String::as_str).collect();
    let hint = match scenes.len() {
        0 => "; docs/scenes.md says how layouts of other programs become one".into(),
        _ => format!("; scenes lie one level deeper: {}", scenes.join(", ")),
    };
    let markers: Vec<&str> = FORMATS.iter().filter_map(|format| format.marker).collect();
    let (last, first) = markers.split_last().expect("some formats are folders");
    Error::Data(format!("{} is no scene: it has none of {} and {last}{hint}", dir.display(), first.join(", ")))
}

/// Returns the names of a folder's entries that can be seen, in order.
fn entries(dir: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(dir).into_iter().flatten().flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let mut names: Vec<String> = names.filter(|name| !name.starts_with('.')).collect();
    names.sort();
    names
}

/// A folder that this program writes.
fn of_augnerf(dir: &Path) -> Option<String> {
    let has = |names: &[&str]| names.iter().all(|name| dir.join(name).exists());
    let here = quoted(&dir.to_string_lossy());
    let (kind, commands) = if has(&["config.toml", "scene.json", "checkpoints"]) {
        ("a run", format!("`augnerf view {here}`, `augnerf eval {here}` or `augnerf render {here}`"))
    } else if has(&["sweep.toml", "provenance.toml"]) {
        ("the results of a sweep", format!("`augnerf verify {here}` or `augnerf report {here}`"))
    } else if has(&["sweep.toml", "points"]) {
        ("a sweep", format!("`augnerf sweep status {here}` or `augnerf compare {here}`"))
    } else {
        return None;
    };
    Some(format!("{} looks like {kind} of augnerf, not a scene; use {commands}", dir.display()))
}

/// A part of a scene, such as its `images` or `sparse`.
fn inside_a_scene(dir: &Path) -> Option<String> {
    let dir = std::path::absolute(dir).ok()?;
    let scene = dir.ancestors().skip(1).take(ABOVE).find(|above| Format::of_folder(above).is_some())?;
    let part = dir.strip_prefix(scene).ok()?.components().next()?;
    let parts = ["images", "sparse", "colmap", "train", "test", "val", "masks"];
    parts
        .iter()
        .any(|known| part.as_os_str().to_string_lossy().starts_with(known))
        .then(|| format!("{} is a part of the scene {}; name that folder", dir.display(), scene.display()))
}

fn without_training_file(dir: &Path) -> Option<String> {
    let there = ["transforms_test.json", "transforms_val.json"].into_iter().find(|name| dir.join(name).is_file())?;
    Some(format!(
        "{}: transforms_train.json is missing beside {there}, which has views to evaluate on alone",
        dir.display()
    ))
}

/// A COLMAP model in another place than those that are read.
fn model_below(dir: &Path) -> Option<String> {
    let is_model = |folder: &PathBuf| {
        let has = |name: &str, ending: &str| folder.join(format!("{name}.{ending}")).is_file();
        ["bin", "txt"].into_iter().any(|ending| has("cameras", ending) && has("images", ending))
    };
    let folders = found::paths_below(dir).into_iter().map(|path| dir.join(path));
    let folder = std::iter::once(dir.to_path_buf()).chain(folders).find(is_model)?;
    let is_scene = |above: &&Path| *above != dir && Format::of_folder(above).is_some();
    let advice = match folder.ancestors().skip(1).take(ABOVE).find(is_scene) {
        Some(scene) => format!("name {}", scene.display()),
        None => format!("move it to {}/sparse/0, and the photos to {}/images", dir.display(), dir.display()),
    };
    Some(format!("{} is a COLMAP model, but not where one is looked for; {advice}", folder.display()))
}

/// A file with nearly the name of a scene's own.
fn misnamed(dir: &Path, entries: &[String]) -> Option<String> {
    let nearly = |name: &str| {
        let distance = |marker: &str| strsim::osa_distance(&name.to_lowercase(), marker);
        MARKERS.into_iter().min_by_key(|marker| distance(marker)).filter(|marker| distance(marker) <= TYPING_ERRORS)
    };
    let mut files = entries.iter().filter(|name| dir.join(name).is_file());
    let (name, marker) = files.find_map(|name| Some((name, nearly(name)?)))?;
    Some(format!("{} is probably a scene's {marker}; rename it to {marker}", dir.join(name).display()))
}

/// Photos without cameras, in the folder or in one below.
fn photos(dir: &Path, entries: &[String]) -> Option<String> {
    let count = |folder: &Path| images::list(folder).map_or(0, |files| files.len());
    if let here @ 1.. = count(dir) {
        return Some(without_cameras(dir, here, Path::new("SCENE")));
    }
    let unread = |folder: &Path| {
        let files = self::entries(folder).into_iter().filter(|name| has_ending(Path::new(name), &UNREAD)).count();
        (files > 0).then(|| {
            format!(
                "{}: {files} photos in a format that is not read (HEIC, TIFF, raw); convert them to PNG or JPEG, and find their \
                 cameras with COLMAP or `ns-process-data`",
                folder.display()
            )
        })
    };
    if let Some(words) = unread(dir).or_else(|| unread(&dir.join("images"))) {
        return Some(words);
    }
    let below = |name: &&str| dir.join(name).is_dir() && count(&dir.join(name)) > 0;
    let folder = ["images"].into_iter().chain(entries.iter().map(String::as_str)).find(below)?;
    let is_scene = |name: &String| Format::of_folder(&dir.join(name)).is_some();
    if entries.iter().any(is_scene) {
        return None;
    }
    let scene = if folder == "images" { dir } else { Path::new("SCENE") };
    Some(without_cameras(&dir.join(folder), count(&dir.join(folder)), scene))
}

/// Returns the words for photos whose cameras are unknown, with the commands that find them for the folder `scene`.
fn without_cameras(photos: &Path, count: usize, scene: &Path) -> String {
    let first = if photos == scene.join("images") {
        String::new()
    } else {
        format!("put them into {}/images and ", scene.display())
    };
    let [images, data, scene] = [&scene.join("images"), photos, scene].map(|path| quoted(&path.to_string_lossy()));
    format!(
        "{}: {count} photos without cameras; {first}find the cameras with `colmap \
         automatic_reconstructor --workspace_path {scene} --image_path {images}`, or run `ns-process-data images --data \
         {data} --output-dir {scene}`, then check {scene}",
        photos.display()
    )
}

fn of_video(video: &Path) -> String {
    format!(
        "make a scene of its frames with `ns-process-data video --data {} --output-dir SCENE`, then check SCENE",
        quoted(&video.to_string_lossy())
    )
}

fn one_of(dir: &Path, entries: &[String], endings: &[&str]) -> Option<PathBuf> {
    entries.iter().map(|name| dir.join(name)).find(|path| path.is_file() && has_ending(path, endings))
}

fn has_ending(path: &Path, endings: &[&str]) -> bool {
    let ending = path.extension().and_then(OsStr::to_str).map(str::to_lowercase);
    ending.is_some_and(|ending| endings.contains(&&*ending))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is said of a folder with these entries; those that end in `/` are folders.
    fn said(entries: &[(&str, &str)]) -> String {
        let dir = tempfile::tempdir().unwrap();
        for (entry, content) in entries {
            let path = dir.path().join(entry);
            if entry.ends_with('/') {
                std::fs::create_dir_all(path).unwrap();
            } else {
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                std::fs::write(path, content).unwrap();
            }
        }
        unknown(dir.path()).to_string().replace(&*dir.path().to_string_lossy(), "DIR")
    }

    #[test]
    fn a_folder_that_is_no_scene_is_answered_with_what_it_looks_like() {
        for (entries, words) in [
            (&[("notes.txt", "")][..], "DIR is no scene"),
            (
                &[("transform_train.json", "{}")],
                "DIR/transform_train.json is probably a scene's transforms_train.json; rename",
            ),
            (&[("Poses_bounds.npy", "")], "rename it to poses_bounds.npy"),
            (
                &[("other.json", "{}"), ("clip.MOV", "")],
                "DIR/clip.MOV is a video; make a scene of its frames with `ns-process-data",
            ),
            (&[("lego.zip", "")], "DIR/lego.zip is an archive; unpack it"),
            (&[("a.JPG", ""), ("notes.txt", "")], "DIR: 1 photos without cameras; put them into SCENE/images"),
            (
                &[("images/a.JPG", "")],
                "DIR/images: 1 photos without cameras; find the cameras with `colmap automatic_reconstructor \
                 --workspace_path DIR --image_path DIR/images`",
            ),
            (&[("input/a.JPG", "")], "DIR/input: 1 photos without cameras"),
            (&[("images/a.HEIC", "")], "DIR/images: 1 photos in a format that is not read"),
            (
                &[("transforms_test.json", "{}"), ("test/a.png", "")],
                "transforms_train.json is missing beside transforms_test.json",
            ),
            (
                &[("dense/0/sparse/cameras.bin", ""), ("dense/0/sparse/images.bin", ""), ("dense/0/images/a.png", "")],
                "DIR/dense/0/sparse is a COLMAP model, but not where one is looked for; name DIR/dense/0",
            ),
            (
                &[("colmap_text/cameras.txt", ""), ("colmap_text/images.txt", ""), ("images/a.png", "")],
                "move it to DIR/sparse/0, and the photos to DIR/images",
            ),
            (&[("my clip.mp4", "")], "--data 'DIR/my clip.mp4' --output-dir SCENE`"),
            (
                &[("config.toml", ""), ("scene.json", ""), ("checkpoints/", ""), ("renders/a.png", "")],
                "DIR looks like a run of augnerf, not a scene; use `augnerf view DIR`, `augnerf eval DIR`",
            ),
            (
                &[("sweep.toml", ""), ("points/", ""), ("a.png", "")],
                "`augnerf sweep status DIR` or `augnerf compare DIR`",
            ),
            (&[("sweep.toml", ""), ("provenance.toml", ""), ("a.png", "")], "`augnerf verify DIR`"),
            (&[("lego/transforms.json", ""), ("thumbs/a.png", "")], "scenes lie one level deeper: lego"),
        ] {
            let said = said(entries);
            assert!(said.contains(words), "{said}");
        }
    }

    #[test]
    fn a_part_of_a_scene_is_answered_with_the_scene() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir(dir.path().join("images")).unwrap();
        std::fs::write(dir.path().join("transforms.json"), "{}").unwrap();
        let said = unknown(&dir.path().join("images")).to_string();
        assert!(said.contains("is a part of the scene") && said.ends_with("name that folder"), "{said}");
    }

    #[test]
    fn a_file_is_answered_with_its_folder_or_what_makes_one() {
        let dir = tempfile::tempdir().unwrap();
        for (name, words) in [("clip.mp4", "looks like a video"), ("a.tar", "unpack it"), ("a.txt", "name the folder")]
        {
            let file = dir.path().join(name);
            std::fs::write(&file, "").unwrap();
            let said = check_folder(&file).unwrap_err().to_string();
            assert!(said.contains(words), "{said}");
            assert_eq!(scene_of_file(&file), None);
        }
        let file = dir.path().join("transforms.json");
        std::fs::write(&file, "").unwrap();
        assert_eq!(scene_of_file(&file).as_deref(), Some(dir.path()));
        assert!(check_folder(dir.path()).is_ok());
    }
}
