//! The photos that a `transforms*.json` lists, each with its pose, lens and mask.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::lens::{self, Lens};
use crate::base::{Event, Listener, Result};
use crate::data::frame::{Frame, named};
use crate::data::images::{self, Header, Size};
use crate::data::json::{Object, Picture};
use crate::data::mask::{self, MaskFile, Masks};
use crate::data::pose::Pose;
use crate::settings::{Axes, DataConfig};

/// The key of a frame's pose.
const POSE: &str = "transform_matrix";
/// Largest number of photos that an error names. Notes name all.
const NAMES: usize = 20;

/// A frame of a file, with or without its photo. The scene's space, and the names and roles of its views, depend on the
/// complete list.
pub struct Listed {
    /// The path where the photo is, or would be.
    pub(in crate::data::formats) place: PathBuf,
    /// Its name in the file.
    pub(super) written: String,
    /// Camera to world.
    pub(super) pose: Pose,
    /// The photo, if it exists.
    pub frame: Option<Frame>,
}

impl Listed {
    /// Returns the sort key of frames: their file names, which do not depend on whether the files exist.
    pub(super) fn order(&self) -> PathBuf {
        let name = PathBuf::from(&self.written);
        if images::is_image(&name) { name } else { PathBuf::from(format!("{}.png", self.written)) }
    }
}

/// A frame of the document.
struct Entry<'a> {
    object: Object<'a>,
    picture: Picture,
    pose: Pose,
}

/// Reads the frames of a document in its order. A note names missing photos, frames without a pose, and frames that are
/// listed twice.
///
/// # Errors
/// If more than half of the photos are missing, if one has two poses, or if a field is invalid.
pub fn read(document: Object, axes: Axes, events: &dyn Listener) -> Result<Vec<Listed>> {
    let note = |what: &str| events.on(Event::Note(&document.error(what).to_string()));
    let listed = |entry: Entry| {
        let Picture { place, written, .. } = entry.picture.clone();
        Ok(Listed { place, written, pose: entry.pose, frame: find(entry, document)? })
    };
    distinct(entries(document, axes, &note)?, document, &note)?.into_iter().map(listed).collect()
}

/// Returns whether none of a document's photos is there.
pub fn has_no_photos(document: Object) -> Result<bool> {
    let there = images::below(document.folder());
    if document.is_empty("frames") {
        return Ok(true);
    }
    for object in document.frames()? {
        let picture = object.picture("file_path")?;
        if picture.path.is_some() || images::place_of(&picture.written, &there).is_some() {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Reads the frames that have a pose; at least half must have their photos.
fn entries<'a>(document: Object<'a>, axes: Axes, note: &dyn Fn(&str)) -> Result<Vec<Entry<'a>>> {
    let (mut entries, mut without_pose) = (Vec::new(), Vec::new());
    for object in document.frames()? {
        let picture = object.picture("file_path")?;
        if object.is_null(POSE) {
            without_pose.push(picture.written);
            continue;
        }
        let pose = object.pose(axes)?;
        entries.push(Entry { object, picture, pose });
    }
    if !without_pose.is_empty() {
        note(&format!(
            "{} frames have no pose (\"{POSE}\" is null) and are left out: {}",
            without_pose.len(),
            without_pose.join(", ")
        ));
    }
    let lacks = |entry: &&Entry| entry.picture.path.is_none();
    let there = if entries.iter().any(|entry| lacks(&entry)) { images::below(document.folder()) } else { Vec::new() };
    find_elsewhere(document, &there, &mut entries, note);
    let first = entries.iter().find(lacks).map(|entry| entry.object);
    let mut missing: Vec<String> = entries.iter().filter(lacks).map(|entry| entry.picture.written.clone()).collect();
    let (count, all) = (missing.len(), entries.len());
    if all == 0 {
        return Err(document.error("no frame has a pose"));
    }
    match first {
        Some(object) if 2 * count > all => {
            let more = if count > NAMES { format!(" and {} more", count - NAMES) } else { String::new() };
            let near = images::nearest(&missing[0], &there);
            let near = near.map(|near| format!("; the nearest name there is {}", near.display())).unwrap_or_default();
            missing.truncate(NAMES);
            Err(object.error(&format!(
                "\"file_path\" names no image (PNG, JPEG or WebP, also with the ending added), and so it is with {count} of {all} \
                 frames: at least half of the photographs must be there; missing are {}{more}{near}",
                missing.join(", ")
            )))
        }
        Some(_) => {
            note(&format!("{count} of {all} photographs are not there and are left out: {}", missing.join(", ")));
            Ok(entries)
        }
        None => Ok(entries),
    }
}

/// Looks for photos that are not where they are named: under the same name in another letter case or Unicode form, in
/// another place below the document's folder that ends in the name, or without the name's folders. A place counts if it is
/// the only one. If most photos are where they are named, the others are in no other folder.
fn find_elsewhere(document: Object, there: &[PathBuf], entries: &mut [Entry], note: &dyn Fn(&str)) {
    let most_are_there = 2 * entries.iter().filter(|entry| entry.picture.path.is_some()).count() >= entries.len();
    let folder = document.folder();
    let mut moved = Vec::new();
    for Entry { picture, .. } in entries.iter_mut().filter(|entry| entry.picture.path.is_none()) {
        let elsewhere = || images::place_of(&picture.written, there).filter(|_| !most_are_there);
        let Some(found) = images::under_same_name(&picture.written, there).or_else(elsewhere) else { continue };
        let path = folder.join(found);
        moved.push(format!("{} is {}", picture.written, found.display()));
        (picture.place, picture.path) = (path.clone(), Some(path));
    }
    if let Some(first) = moved.first() {
        note(&format!("{} photos are not where \"file_path\" says, and were found elsewhere: {first}", moved.len()));
    }
}

/// Keeps each photo once. A second frame of it could be both trained on and held out.
fn distinct<'a>(entries: Vec<Entry<'a>>, document: Object, note: &dyn Fn(&str)) -> Result<Vec<Entry<'a>>> {
    let mut places: HashMap<PathBuf, usize> = HashMap::new();
    let (mut kept, mut again): (Vec<Entry>, Vec<String>) = (Vec::new(), Vec::new());
    for entry in entries {
        let place = images::real(&entry.picture.place);
        match places.get(&place) {
            Some(&place) if kept[place].pose == entry.pose => again.push(entry.picture.written),
            Some(_) => {
                return Err(document.error(&format!(
                    "\"frames\" has the photo {} twice, with two poses: remove the wrong one",
                    entry.picture.place.display()
                )));
            }
            None => {
                places.insert(place, kept.len());
                kept.push(entry);
            }
        }
    }
    if !again.is_empty() {
        note(&format!("{} frames are listed again and are left out: {}", again.len(), again.join(", ")));
    }
    Ok(kept)
}

/// Returns the photo of an entry, if it exists.
fn find(Entry { object, picture, .. }: Entry, document: Object) -> Result<Option<Frame>> {
    let Some(path) = picture.path else { return Ok(None) };
    let stated = lens::stated(object, document)?;
    let header = Header::read(&path)?.turned_to_fit(|size| stated.is_some_and(|stated| lens::is_scaled(stated, size)));
    let Lens { intrinsics, distortion } = Lens::read(object, document, header.size)?;
    let Some(frame) = Frame::new(path, header, intrinsics, distortion) else {
        return Err(object.error(&format!(
            "the lens distortion (k1, k2, k3 = {:?}, p1, p2 = {:?}) cannot be undone over the whole image: \
             its coefficients are too large",
            distortion.radial, distortion.tangential
        )));
    };
    Ok(Some(Frame { mask: mask::file_of(object, document)?.map(MaskFile::of_black), ..frame }))
}

/// Returns the frames of a list whose photos exist, each with its pose and its name among all.
pub fn found(listed: Vec<Listed>) -> (Vec<Frame>, Vec<String>) {
    let names = images::names(&listed.iter().map(|listed| listed.place.clone()).collect::<Vec<_>>());
    let named = listed.into_iter().zip(names);
    named.filter_map(|(Listed { pose, frame, .. }, name)| Some((Frame { pose, ..frame? }, name))).unzip()
}

/// Gives photos the masks of `data.masks`, before those that their file names.
pub fn find_masks<'a>(
    frames: impl Iterator<Item = &'a mut Frame>,
    config: &DataConfig,
    events: &dyn Listener,
) -> Result<()> {
    let mut frames: Vec<&mut Frame> = frames.collect();
    if frames.iter().any(|frame| frame.mask.is_some()) && config.masks.is_empty() {
        return Ok(());
    }
    let masks = Masks::of(config, frames.iter().map(|frame| &*frame.path), events)?;
    for (frame, mask) in frames.iter_mut().zip(masks.files) {
        frame.mask = if config.masks == mask::NONE { None } else { mask.or(frame.mask.take()) };
    }
    Ok(())
}

/// Returns the working sizes of the frames' photos.
pub fn working_sizes(frames: &[&Frame], config: &DataConfig) -> Result<Vec<(usize, usize)>> {
    let sizes: Vec<(usize, usize)> = frames.iter().map(|frame| frame.size()).collect();
    let first = frames.first().map_or(Path::new(""), |frame| &frame.path);
    images::working_sizes(Size::of(config), &sizes, first)
}

/// Notes photos of a scene that are both trained on and evaluated.
pub fn note_shared(scene: &str, train: &[&Frame], test: &[&Frame], events: &dyn Listener) {
    let is_trained = |frame: &&&Frame| train.iter().any(|other| other.path == frame.path);
    let shared: Vec<&Path> = test.iter().filter(is_trained).map(|frame| &*frame.path).collect();
    if !shared.is_empty() {
        let what = format!(
            "{} of {} photographs that are evaluated are trained on, too, so that metrics are not of unseen views: {}",
            shared.len(),
            test.len(),
            named(Path::new(scene), &shared)
        );
        events.on(Event::Note(&what));
    }
}
