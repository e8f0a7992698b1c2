//! The photos that a `transforms*.json` lists, each with its pose, lens and mask.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::lens::{self, Lens};
use crate::found::{self, Below};
use crate::frame::{Frame, named};
use crate::images::{self, Header, Size};
use crate::json::{Object, Picture, Scaled};
use crate::mask;
use crate::pose::Pose;
use crate::settings::DataConfig;
use augnerf_base::{Event, Listener, Result, first_names, number_text};

/// The key of a frame's pose.
const POSE: &str = "transform_matrix";
/// Largest number of photos that a sentence names.
const NAMES: usize = 20;

/// A frame of a file, with or without its photo. The scene's space, and the names and roles of its views, depend on the
/// complete list.
pub struct Listed {
    /// The path where the photo is, or would be.
    pub(in crate::formats) place: PathBuf,
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
    pose: Pose,
    picture: Picture,
    reduced: usize,
}

/// Reads a document's frames under a key, in their order. Notes name missing photos, frames without a pose, frames that are
/// listed twice, and what was repaired.
///
/// # Errors
/// If none of the photos is there, if one has two poses, or if a field is invalid.
pub fn read<'a>(document: Object<'a>, key: &'a str, config: &DataConfig, events: &dyn Listener) -> Result<Vec<Listed>> {
    let note = |what: &str| events.on(Event::Note(&document.error(what).to_string()));
    let mut listed: Vec<Listed> = Vec::new();
    let mut doubts: Vec<String> = Vec::new();
    for entry in distinct(entries(document, key, config, &note)?, document, &note)? {
        let Picture { place, written, .. } = entry.picture.clone();
        let (object, pose, frame) = (entry.object, entry.pose, find(entry, document)?);
        if let Some(frame) = &frame {
            doubts.extend(lens::doubt(object, document, frame.size())?);
        }
        listed.push(Listed { place, written, pose, frame });
    }
    if let Some(first) = doubts.first() {
        note(&format!("{first} (in {} frames)", doubts.len()));
    }
    Ok(listed)
}

/// Returns whether none of a document's photos is there.
pub fn has_no_photos(document: Object) -> Result<bool> {
    let there = Below::of(found::below(document.folder()));
    if document.is_empty("frames") {
        return Ok(true);
    }
    for object in document.objects("frames")? {
        let picture = object.picture("file_path")?;
        if picture.path.is_some() || there.by_end(&picture.written).is_some() {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Reads the frames that have a pose. At least one photo must be there.
fn entries<'a>(document: Object<'a>, key: &'a str, config: &DataConfig, note: &dyn Fn(&str)) -> Result<Vec<Entry<'a>>> {
    let (mut entries, mut without_pose, mut scaled) = (Vec::new(), Vec::new(), Vec::new());
    for object in document.objects(key)? {
        let picture = object.picture("file_path")?;
        if object.is_null(POSE) {
            without_pose.push(picture.written);
            continue;
        }
        let (pose, scale) = object.pose(config.axes)?;
        scaled.extend(scale);
        entries.push(Entry { object, picture, pose, reduced: 1 });
    }
    if !without_pose.is_empty() {
        let (count, names) = (without_pose.len(), first_names(&without_pose, NAMES));
        note(&format!("{count} frames have no pose (\"{POSE}\" is null) and are left out: {names}"));
    }
    note_scaled(&scaled, note);
    let lacks = |entry: &&Entry| entry.picture.path.is_none();
    let there = if entries.iter().any(|entry| lacks(&entry)) { found::below(document.folder()) } else { Vec::new() };
    let there = Below::of(there);
    find_elsewhere(document, &there, &mut entries, config, note);
    let missing: Vec<&str> = entries.iter().filter(lacks).map(|entry| &*entry.picture.written).collect();
    let (count, all) = (missing.len(), entries.len());
    if all == 0 {
        return Err(document.error("no frame has a pose"));
    }
    if count == all {
        let near = there.nearest(missing[0]).map(|near| format!("; the nearest name there is {}", near.display()));
        return Err(document.error(&format!(
            "none of the {all} photos that \"{key}\" names is there (PNG, JPEG or WebP, also with the ending added){}; missing are {}",
            near.unwrap_or_default(),
            first_names(&missing, NAMES)
        )));
    }
    if count > 0 {
        let most =
            if 2 * count > all { ". These are most of them: check that the folder is the right one" } else { "" };
        let names = first_names(&missing, NAMES);
        note(&format!("{count} of {all} photographs are not there and are left out: {names}{most}"));
    }
    Ok(entries)
}

/// Notes matrices out of which a scale was taken.
fn note_scaled(scaled: &[Scaled], note: &dyn Fn(&str)) {
    for whole in [true, false] {
        let mut by: Vec<f64> = scaled.iter().filter(|scaled| scaled.whole == whole).map(|scaled| scaled.by).collect();
        by.sort_by(f64::total_cmp);
        let (Some(least), Some(most)) = (by.first(), by.last()) else { continue };
        let short = |number: f64| number_text((number * 1e9).round() / 1e9);
        let by_one = most - least <= 1e-3 * most.abs();
        let range = if by_one { short(*least) } else { format!("{} to {}", short(*least), short(*most)) };
        let count = by.len();
        note(&match whole {
            true => format!(
                "{count} matrices are scaled as a whole (their last number is {range}, not 1) and are divided by that number"
            ),
            false => format!(
                "the axes of {count} matrices have the length {range}, not 1, and are normalized; the positions stay as they are"
            ),
        });
    }
}

/// Looks for photos that are not where they are named: under the same name in another letter case or Unicode form, in
/// another place below the document's folder that ends in the name, or without the name's folders. A place counts if it is
/// the only one. If most photos are where they are named, the others are in no other folder. If all are missing, their
/// folder may have another name.
fn find_elsewhere(document: Object, there: &Below, entries: &mut [Entry], config: &DataConfig, note: &dyn Fn(&str)) {
    let most_are_there = 2 * entries.iter().filter(|entry| entry.picture.path.is_some()).count() >= entries.len();
    let mut moved = Vec::new();
    let mut place = |entry: &mut Entry, found: &Path| {
        moved.push(format!("{} is {}", entry.picture.written, found.display()));
        let path = document.folder().join(found);
        (entry.picture.place, entry.picture.path) = (path.clone(), Some(path));
    };
    for entry in entries.iter_mut().filter(|entry| entry.picture.path.is_none()) {
        let name = entry.picture.written.clone();
        let found = there.under_same_name(&name).or_else(|| there.by_end(&name).filter(|_| !most_are_there));
        found.into_iter().for_each(|found| place(entry, found));
    }
    let mut reduced = None;
    if entries.iter().all(|entry| entry.picture.path.is_none()) {
        let names: Vec<String> = entries.iter().map(|entry| entry.picture.written.clone()).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let downscale = config.downscale.unwrap_or(1) as usize;
        let (folder, files) = there.renamed_folder(&names, downscale).unwrap_or((Path::new(""), Vec::new()));
        let factor = found::factor_in(folder);
        for (entry, file) in entries.iter_mut().zip(files) {
            file.into_iter().for_each(|file| place(entry, file));
            // A file may name reduced photos itself, for which its numbers then are.
            let own = found::factor_in(Path::new(&entry.picture.written));
            entry.reduced = if factor.is_multiple_of(own) { factor / own } else { 1 };
        }
        reduced = (factor > 1).then(|| found::reduced_words(folder, factor, Size::of(config)));
    }
    if let Some(first) = moved.first() {
        note(&format!("{} photos are not where \"file_path\" says, and were found elsewhere: {first}", moved.len()));
    }
    reduced.iter().for_each(|words| note(words));
}

/// Keeps each photo once. A second frame of it could be both trained on and held out.
fn distinct<'a>(entries: Vec<Entry<'a>>, document: Object, note: &dyn Fn(&str)) -> Result<Vec<Entry<'a>>> {
    let mut places: HashMap<PathBuf, usize> = HashMap::new();
    let (mut kept, mut again): (Vec<Entry>, Vec<String>) = (Vec::new(), Vec::new());
    for entry in entries {
        let place = found::real(&entry.picture.place);
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
        note(&format!("{} frames are listed again and are left out: {}", again.len(), first_names(&again, NAMES)));
    }
    Ok(kept)
}

/// Returns the photo of an entry, if it exists.
fn find(Entry { object, picture, reduced, .. }: Entry, document: Object) -> Result<Option<Frame>> {
    let Some(path) = picture.path else { return Ok(None) };
    let stated = lens::stated(object, document)?;
    let header = Header::read(&path)?.turned_to_fit(|size| stated.is_some_and(|stated| lens::is_scaled(stated, size)));
    let Lens { intrinsics, distortion } = Lens::read(object, document, header.size, reduced)?;
    let Some(frame) = Frame::new(path, header, intrinsics, distortion) else {
        return Err(object.error(&format!(
            "the lens distortion (k1, k2, k3 = {:?}, p1, p2 = {:?}) cannot be undone over the whole image: \
             its coefficients are too large",
            distortion.radial, distortion.tangential
        )));
    };
    Ok(Some(Frame { mask: mask::named_in(object, document)?, reduced, ..frame }))
}

/// Returns the frames of a list whose photos exist, each with its pose and its name among all.
pub fn found(listed: Vec<Listed>) -> (Vec<Frame>, Vec<String>) {
    let names = images::names(&listed.iter().map(|listed| listed.place.clone()).collect::<Vec<_>>());
    let named = listed.into_iter().zip(names);
    named.filter_map(|(Listed { pose, frame, .. }, name)| Some((Frame { pose, ..frame? }, name))).unzip()
}

/// Returns the working sizes of the frames' photos.
pub fn working_sizes(frames: &[&Frame], config: &DataConfig) -> Result<Vec<(usize, usize)>> {
    let sizes: Vec<(usize, usize)> = frames.iter().map(|frame| frame.size()).collect();
    let first = frames.first().map_or(Path::new(""), |frame| &frame.path);
    // Photos that are reduced already are reduced by the rest of the factor.
    let reduced = frames.first().map_or(1, |frame| frame.reduced);
    let size = match Size::of(config) {
        Size::Factor(factor) => Size::Factor((factor / reduced).max(1)),
        width => width,
    };
    images::working_sizes(size, &sizes, first)
}

/// Notes photos of a scene that are both trained on and evaluated. `advice` says what to do.
pub fn note_shared(scene: &str, train: &[&Frame], test: &[&Frame], advice: &str, events: &dyn Listener) {
    let is_trained = |frame: &&&Frame| train.iter().any(|other| other.path == frame.path);
    let shared: Vec<&Path> = test.iter().filter(is_trained).map(|frame| &*frame.path).collect();
    if !shared.is_empty() {
        let what = format!(
            "{} of {} photographs that are evaluated are trained on, too, so that metrics are not of unseen views{advice}: {}",
            shared.len(),
            test.len(),
            named(Path::new(scene), &shared)
        );
        events.on(Event::Note(&what));
    }
}
