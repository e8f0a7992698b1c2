//! Reading of a COLMAP model from its folder, binary or text.

use std::collections::HashSet;
use std::path::Path;

use super::model::{MOST_NAME, Model, Photograph};
use super::{binary, text};
use augnerf_base::{Error, Event, Listener, Result};

/// Folders of models within a scene's folder, each itself or with numbered folders in it.
const FOLDERS: [&str; 2] = ["sparse", "colmap/sparse"];
/// The folder of models of the photos before their distortion was removed, looked at last.
const DISTORTED: &str = "distorted/sparse";
/// Most numbered folders that are looked at.
const MOST_MODELS: usize = 1000;

/// A model in a scene's folder.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Candidate {
    /// Its folder below the scene's: `sparse/0`.
    pub(super) folder: String,
    is_binary: bool,
    /// How many photos it has; 0 if that cannot be read.
    pub(super) photos: usize,
}

impl Candidate {
    fn at(dir: &Path, folder: String) -> Option<Candidate> {
        let file = |name: &str, ending: &str| dir.join(&folder).join(format!("{name}.{ending}"));
        let is_there = |ending: &str| file("cameras", ending).is_file() && file("images", ending).is_file();
        let is_binary = is_there("bin");
        if !is_binary && !is_there("txt") {
            return None;
        }
        let photos = match is_binary {
            true => binary::photograph_count(&file("images", "bin")),
            false => text::photographs(&file("images", "txt")).map(|photographs| photographs.len()),
        };
        Some(Candidate { photos: photos.unwrap_or(0), folder, is_binary })
    }

    fn words(&self) -> String {
        format!("{} ({} photos)", self.folder, self.photos)
    }
}

/// Returns the models of the first of the folders that has any, in the order in which equal ones count: `sparse/0`,
/// `sparse/1` and so on, `sparse`. Models of other folders may be of other images, such as those before undistortion.
pub(super) fn candidates(dir: &Path) -> Vec<Candidate> {
    places(dir).into_iter().next().unwrap_or_default()
}

/// Returns the models of each folder that has any.
fn places(dir: &Path) -> Vec<Vec<Candidate>> {
    let below = |folder: &str| -> Vec<Candidate> {
        let names = std::fs::read_dir(dir.join(folder)).into_iter().flatten().flatten().map(|entry| entry.file_name());
        let number =
            |name: &std::ffi::OsStr| name.to_str()?.parse().ok().filter(|number: &u32| *name == *number.to_string());
        let mut numbers: Vec<u32> = names.filter_map(|name| number(&name)).collect();
        numbers.sort_unstable();
        numbers.truncate(MOST_MODELS);
        let numbered = numbers.into_iter().map(|number| format!("{folder}/{number}"));
        numbered.chain([folder.to_string()]).filter_map(|folder| Candidate::at(dir, folder)).collect()
    };
    let places = FOLDERS.iter().chain([&DISTORTED]).map(|folder| below(folder));
    places.filter(|found| !found.is_empty()).collect()
}

/// Chooses the model with the most photos, or the `wanted` one. The second part names the others, if there are any.
fn choose(dir: &Path, wanted: &str) -> Result<(Candidate, Option<String>)> {
    let mut places = places(dir);
    let first = if places.is_empty() { Vec::new() } else { places.remove(0) };
    let all: Vec<Candidate> = first.iter().cloned().chain(places.into_iter().flatten()).collect();
    let wrong = |what: String| Error::Data(format!("{}: {what}", dir.display()));
    let listed = || all.iter().map(Candidate::words).collect::<Vec<_>>().join(", ");
    let most = first.iter().map(|model| model.photos).max().ok_or_else(|| {
        wrong(format!(
            "no COLMAP model: cameras and images, .bin or .txt, are looked for in {} and {DISTORTED}, and in numbered folders there",
            FOLDERS.join(", ")
        ))
    })?;
    let chosen = match wanted {
        "" => first.iter().find(|model| model.photos == most),
        wanted => all.iter().find(|model| model.folder == wanted.trim_matches('/')),
    };
    let Some(chosen) = chosen else {
        return Err(wrong(format!(
            "data.colmap_model = \"{wanted}\" is no COLMAP model there; there are {}",
            listed()
        )));
    };
    let others = (all.len() > 1).then(|| {
        format!(
            "{} COLMAP models: {}; {} is read (data.colmap_model chooses another)",
            all.len(),
            listed(),
            chosen.folder
        )
    });
    Ok((chosen.clone(), others))
}

/// Reads the model of a scene's folder: `wanted`, or if that is empty the one with the most photos. Models that are not
/// read are noted.
pub(super) fn model(dir: &Path, wanted: &str, events: &dyn Listener) -> Result<Model> {
    let (Candidate { folder, is_binary, .. }, others) = choose(dir, wanted)?;
    if let Some(others) = others {
        events.on(Event::Note(&format!("{}: {others}", dir.display())));
    }
    let ending = if is_binary { "bin" } else { "txt" };
    let file = |name: &str| dir.join(&folder).join(format!("{name}.{ending}"));
    let [cameras, images, points] = ["cameras", "images", "points3D"].map(file);
    let mut model = Model { folder, ..Model::default() };
    let (lenses, photographs) = match is_binary {
        true => (binary::lenses(&cameras)?, binary::photographs(&images)?),
        false => (text::lenses(&cameras)?, text::photographs(&images)?),
    };
    // A capture may come without points, or with empty files of points.
    if points.is_file() {
        model.points = if is_binary { binary::points(&points)? } else { text::points(&points)? };
    }
    for (id, lens) in lenses {
        if model.lenses.insert(id, lens).is_some() {
            let what = format!("camera {id} is there twice: remove the one that no image is of");
            return Err(Error::Data(format!("{}: {what}", cameras.display())));
        }
    }
    model.photographs = photographs;
    plain_names(&mut model.photographs, &images, events);
    model.photographs.sort_by(|a, b| a.name.cmp(&b.name));
    check(&model, &images)?;
    Ok(model)
}

/// Takes names with backslashes, drives or roots, which are of another machine, for paths below the folder of images.
fn plain_names(photographs: &mut [Photograph], images: &Path, events: &dyn Listener) {
    let mut foreign: Vec<String> = Vec::new();
    for Photograph { name, .. } in photographs {
        let below = crate::found::slashes(name);
        let drive = below.split_once(":/").filter(|(drive, _)| drive.len() == 1).map_or(&*below, |(_, rest)| rest);
        let plain = drive.trim_start_matches('/').to_string();
        if plain != *name {
            let written = std::mem::replace(name, plain);
            foreign.extend((written.trim_start_matches("./") != *name).then_some(written));
        }
    }
    if let Some(first) = foreign.first() {
        events.on(Event::Note(&format!(
            "{}: the names of {} images are paths of another machine and are read as paths below the folder of images: {first}",
            images.display(),
            foreign.len()
        )));
    }
}

fn check(model: &Model, images: &Path) -> Result<()> {
    let fail = |what: String| Err(Error::Data(format!("{}: {what}", images.display())));
    if model.photographs.is_empty() {
        return fail("no image has a pose: the reconstruction found none".into());
    }
    let (mut names, mut ids) = (HashSet::new(), HashSet::new());
    for Photograph { id, camera, name, .. } in &model.photographs {
        if name.len() > MOST_NAME {
            return fail(format!(
                "the name of image {id} has {} bytes, more than any file's ({MOST_NAME})",
                name.len()
            ));
        }
        if !model.lenses.contains_key(camera) {
            return fail(format!("image {name:?} is of camera {camera}, which the file of cameras does not have"));
        }
        if !(names.insert(name) && ids.insert(id)) {
            return fail(format!("image {name:?} (number {id}) is there twice: each has one pose"));
        }
        let inside =
            !name.is_empty() && !Path::new(name).is_absolute() && !name.split(['/', '\\']).any(|part| part == "..");
        if !inside {
            return fail(format!("an image is called {name:?}, which is no file below the folder of images"));
        }
    }
    Ok(())
}
