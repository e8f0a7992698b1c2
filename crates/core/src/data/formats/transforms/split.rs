//! The split of a capture's author: nerfstudio's `train_filenames`, `val_filenames` and `test_filenames`, or a
//! `transforms_{train,val,test}.json` per split.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::path::Path;

use super::frames::Listed;
use super::{TRANSFORMS_FILE, frames, lens, transforms_file};
use crate::base::{Error, Listener, Result};
use crate::data::json::{self, Object};
use crate::data::mask;
use crate::settings::Axes;

/// The role of a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// A training view.
    Train,
    /// A validation view.
    Val,
    /// A test view.
    Test,
}

impl Role {
    /// All roles.
    pub const ALL: [Role; 3] = [Role::Train, Role::Val, Role::Test];

    /// Returns the name in files.
    pub fn name(self) -> &'static str {
        match self {
            Role::Train => "train",
            Role::Val => "val",
            Role::Test => "test",
        }
    }

    fn key(self) -> String {
        format!("{}_filenames", self.name())
    }
}

/// Returns whether the folder's files name a split of their own.
///
/// # Errors
/// If a `transforms.json` is not readable.
pub fn is_named(dir: &Path) -> Result<bool> {
    let file = dir.join(TRANSFORMS_FILE);
    if !file.is_file() {
        return Ok(Role::ALL.iter().any(|role| dir.join(transforms_file(role.name())).is_file()));
    }
    let value = json::read(&file)?;
    let document = Object::document(&file, &value)?;
    Ok(Role::ALL.iter().any(|role| document.get(&role.key()).is_some()))
}

/// A capture's frames, each with its author's role. `None` if the author names no role for it, or no split.
pub(super) type Roles = Vec<(Listed, Option<Role>)>;

/// The content of a folder's files.
pub(super) struct Listing {
    /// All frames.
    pub(super) frames: Roles,
    /// Whether the files name a split.
    pub(super) named: bool,
    /// Ignored keys, each once.
    pub(super) ignored: Vec<String>,
}

/// Returns the ignored keys of a document and of its frames.
fn ignored(document: Object) -> Result<BTreeSet<String>> {
    const OF_DOCUMENT: [&str; 4] = ["frames", "train_filenames", "val_filenames", "test_filenames"];
    const OF_FRAME: [&str; 2] = ["file_path", "transform_matrix"];
    let unread = |key: &&str| !lens::KEYS.contains(key) && *key != mask::KEY;
    let mut keys: BTreeSet<String> =
        document.keys().filter(unread).filter(|key| !OF_DOCUMENT.contains(key)).map(str::to_string).collect();
    for frame in document.frames()? {
        keys.extend(frame.keys().filter(unread).filter(|key| !OF_FRAME.contains(key)).map(str::to_string));
    }
    Ok(keys)
}

/// Reads all frames of a folder.
pub(super) fn read(dir: &Path, axes: Axes, events: &dyn Listener) -> Result<Listing> {
    let file = dir.join(TRANSFORMS_FILE);
    let splits: Vec<Role> =
        Role::ALL.into_iter().filter(|role| dir.join(transforms_file(role.name())).is_file()).collect();
    if file.exists() || splits.is_empty() {
        return of_one_file(&file, axes, events);
    }
    let (mut all, mut keys) = (Vec::new(), BTreeSet::new());
    for role in splits {
        let file = dir.join(transforms_file(role.name()));
        let value = json::read(&file)?;
        let document = Object::document(&file, &value)?;
        let frames = frames::read(document, axes, events)?;
        keys.append(&mut ignored(document)?);
        all.extend(frames.into_iter().map(|frame| (frame, Some(role))));
    }
    Ok(Listing { frames: all, named: true, ignored: keys.into_iter().collect() })
}

fn of_one_file(file: &Path, axes: Axes, events: &dyn Listener) -> Result<Listing> {
    let value = json::read(file)?;
    let document = Object::document(file, &value)?;
    let listed = listed(document)?;
    let frames = frames::read(document, axes, events)?;
    let ignored = ignored(document)?.into_iter().collect();
    if listed.iter().all(Option::is_none) {
        let frames = frames.into_iter().map(|frame| (frame, None)).collect();
        return Ok(Listing { frames, named: false, ignored });
    }
    let mut roles: HashMap<&str, Role> = HashMap::new();
    for (role, names) in Role::ALL.into_iter().zip(&listed) {
        for name in names.iter().flatten() {
            if let Some(other) = roles.insert(name, role).filter(|other| *other != role) {
                let what =
                    format!("\"{}\" and \"{}\" both name \"{name}\": a view has one use", other.key(), role.key());
                return Err(document.error(&what));
            }
        }
    }
    // A frame that no list names belongs to the missing list. If several are missing, it belongs to the first that a
    // capture needs.
    let rest = match &listed[..] {
        [None, ..] => Some(Role::Train),
        [_, _, None] => Some(Role::Test),
        [_, None, _] => Some(Role::Val),
        _ => None,
    };
    let role = |frame: &Listed| roles.get(frame.written.as_str()).copied().or(rest);
    let with_role = |frame: Listed| {
        let role = role(&frame);
        (frame, role)
    };
    Ok(Listing { frames: frames.into_iter().map(with_role).collect(), named: true, ignored })
}

/// Returns the names in the lists of [`Role::ALL`], each of which a frame must have.
fn listed(document: Object) -> Result<Vec<Option<Vec<String>>>> {
    let mut known = HashSet::new();
    for frame in document.frames()? {
        known.insert(frame.picture("file_path")?.written);
    }
    let of_role = |role: Role| {
        let Some(names) = document.texts(&role.key())? else { return Ok(None) };
        let names: Vec<String> =
            names.iter().map(|name| name.replace('\\', "/").trim_start_matches("./").to_string()).collect();
        match names.iter().find(|name| !known.contains(*name)) {
            Some(name) => Err(document.error(&format!(
                "\"{}\" names \"{name}\", which is the \"file_path\" of no frame: write it as it stands there",
                role.key()
            ))),
            None => Ok(Some(names)),
        }
    };
    Role::ALL.into_iter().map(of_role).collect()
}

/// Returns the error that there is nothing to evaluate, with advice.
pub(super) fn without(wanted: Role, dir: &str, roles: &[Option<Role>]) -> Error {
    let other = if wanted == Role::Test { Role::Val } else { Role::Test };
    let count = roles.iter().filter(|role| **role == Some(other)).count();
    let advice = match count {
        0 => "set data.split=every to hold out every data.holdout-th view instead".to_string(),
        count => format!("{count} are for data.eval_split={}", other.name()),
    };
    Error::Data(format!(
        "{dir}: the split that the capture's files name has no views for data.eval_split={}; {advice}",
        wanted.name()
    ))
}
