//! Reading of a COLMAP model from its folder, binary or text.

use std::collections::HashSet;
use std::path::Path;

use super::model::{MOST_NAME, Model, Photograph};
use super::{binary, text};
use crate::base::{Error, Result};

/// Folders of a model within a scene's folder; the first that exists is read.
const FOLDERS: [&str; 3] = ["sparse/0", "sparse", "colmap/sparse/0"];

/// Returns the folder of a scene's model, if there is one, and whether it is binary.
pub(super) fn find(dir: &Path) -> Option<(&'static str, bool)> {
    let is_there = |folder: &str, ending: &str| {
        let file = |name: &str| dir.join(folder).join(format!("{name}.{ending}"));
        file("cameras").is_file() && file("images").is_file()
    };
    let found = |folder: &&str| is_there(folder, "bin") || is_there(folder, "txt");
    FOLDERS.into_iter().find(found).map(|folder| (folder, is_there(folder, "bin")))
}

/// Reads the model of a scene's folder.
pub(super) fn model(dir: &Path) -> Result<Model> {
    let Some((folder, is_binary)) = find(dir) else {
        return Err(Error::Data(format!(
            "{} holds no COLMAP model: cameras and images, .bin or .txt, are looked for in {}",
            dir.display(),
            FOLDERS.join(", ")
        )));
    };
    let ending = if is_binary { "bin" } else { "txt" };
    let file = |name: &str| dir.join(folder).join(format!("{name}.{ending}"));
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
    model.photographs.sort_by(|a, b| a.name.cmp(&b.name));
    check(&model, &images)?;
    Ok(model)
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
