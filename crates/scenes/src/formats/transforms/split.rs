//! The split of a capture's author: nerfstudio's `train_filenames`, `val_filenames` and `test_filenames`, ScanNet++'s
//! `test_frames` beside `frames`, or a `transforms_{train,val,test}.json` per split.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::frames::Listed;
use super::{TRANSFORMS_FILE, frames, lens, transforms_file};
use crate::found;
use crate::json::{self, Object};
use crate::mask;
use crate::settings::{DataConfig, EvalSplit, Split};
use augnerf_base::{Error, Event, Listener, Result};

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

    /// Returns the role of the views that are evaluated.
    pub(in crate::formats) fn evaluated(config: &DataConfig) -> Role {
        match config.eval_split {
            EvalSplit::Test => Role::Test,
            EvalSplit::Val => Role::Val,
        }
    }

    /// Returns the name in files.
    pub fn name(self) -> &'static str {
        match self {
            Role::Train => "train",
            Role::Val => "val",
            Role::Test => "test",
        }
    }

    /// Returns the key of the list of its photos' names.
    fn names_key(self) -> &'static str {
        ["train_filenames", "val_filenames", "test_filenames"][self as usize]
    }

    /// Returns the key of its own frames, as ScanNet++ has them beside `frames`.
    fn frames_key(self) -> &'static str {
        ["train_frames", "val_frames", "test_frames"][self as usize]
    }

    /// Returns these uses with this one.
    fn and(self, mut uses: Uses) -> Uses {
        uses[self as usize] = true;
        uses
    }
}

/// Which of [`Role::ALL`] a view has. One of several is there for files that list it several times.
pub(super) type Uses = [bool; 3];

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
    let names = |role: &Role| names_of(document, *role).is_some() || has_frames(document, *role);
    Ok(Role::ALL.iter().any(names))
}

/// Returns the key of the list of a role's photos. ScanNet++'s may have names instead of frames.
fn names_of(document: Object, role: Role) -> Option<&'static str> {
    let frames = Some(role.frames_key()).filter(|key| document.begins_with(key, Value::is_string));
    Some(role.names_key()).filter(|key| document.get(key).is_some()).or(frames)
}

fn has_frames(document: Object, role: Role) -> bool {
    document.begins_with(role.frames_key(), Value::is_object)
}

/// A capture's frames, each with its author's roles. None if the author names no role for it, or no split.
pub(super) type Roles = Vec<(Listed, Uses)>;

/// The content of a folder's files.
pub(super) struct Listing {
    /// All frames.
    pub(super) frames: Roles,
    /// Whether the files name a split.
    pub(super) named: bool,
    /// Ignored keys, each once.
    pub(super) ignored: Vec<String>,
    /// Photos of frames that are left out because of their role.
    pub(super) aside: Vec<PathBuf>,
}

/// Returns the ignored keys of a document and of its frames.
fn ignored(document: Object) -> Result<BTreeSet<String>> {
    const OF_FRAME: [&str; 2] = ["file_path", "transform_matrix"];
    let is_read = |key: &str| lens::KEYS.contains(&key) || key == mask::KEY;
    let is_list = |key: &str| {
        key == "frames" || Role::ALL.iter().any(|role| [role.names_key(), role.frames_key()].contains(&key))
    };
    let mut keys: BTreeSet<String> =
        document.keys().filter(|key| !is_read(key) && !is_list(key)).map(str::to_string).collect();
    let lists = ["frames"].into_iter().chain(Role::ALL.map(Role::frames_key));
    for key in lists.filter(|key| document.begins_with(key, Value::is_object)) {
        for frame in document.objects(key)? {
            keys.extend(frame.keys().filter(|key| !is_read(key) && !OF_FRAME.contains(key)).map(str::to_string));
        }
    }
    Ok(keys)
}

/// Reads all frames of a folder.
pub(super) fn read(config: &DataConfig, events: &dyn Listener) -> Result<Listing> {
    let dir = Path::new(&config.dir);
    let file = dir.join(TRANSFORMS_FILE);
    let splits: Vec<Role> =
        Role::ALL.into_iter().filter(|role| dir.join(transforms_file(role.name())).is_file()).collect();
    if file.exists() || splits.is_empty() {
        return of_one_file(&file, config, events);
    }
    let (mut all, mut keys) = (Vec::new(), BTreeSet::new());
    for role in splits {
        let file = dir.join(transforms_file(role.name()));
        let value = json::read(&file)?;
        let document = Object::document(&file, &value)?;
        let frames = frames::read(document, "frames", config, events)?;
        keys.append(&mut ignored(document)?);
        all.extend(frames.into_iter().map(|frame| (frame, role.and([false; 3]))));
    }
    Ok(Listing { frames: all, named: true, ignored: keys.into_iter().collect(), aside: Vec::new() })
}

fn of_one_file(file: &Path, config: &DataConfig, events: &dyn Listener) -> Result<Listing> {
    let value = json::read(file)?;
    let document = Object::document(file, &value)?;
    let by_author = config.split != Some(Split::Every);
    let listed = if by_author { listed(document)? } else { vec![None; 3] };
    let own: Vec<Role> = Role::ALL.into_iter().filter(|role| has_frames(document, *role)).collect();
    let mut roles: HashMap<&str, Uses> = HashMap::new();
    for (role, names) in Role::ALL.into_iter().zip(&listed) {
        for name in names.iter().flatten() {
            let uses = roles.entry(name).or_default();
            *uses = role.and(*uses);
        }
    }
    // A frame that no list names belongs to the missing list. If several are missing, it belongs to the first that a
    // capture needs.
    let rest = match &listed[..] {
        [None, None, None] if own.is_empty() => None,
        [None, ..] => Some(Role::Train),
        [_, _, None] if own.is_empty() => Some(Role::Test),
        [_, None, _] if own.is_empty() => Some(Role::Val),
        _ => None,
    };
    let rest = rest.map_or([false; 3], |role| role.and([false; 3]));
    let (mut all, mut aside): (Roles, Vec<PathBuf>) = (Vec::new(), Vec::new());
    if own.is_empty() || document.get("frames").is_some() {
        for frame in frames::read(document, "frames", config, events)? {
            let uses = roles.get(frame.written.as_str()).copied().unwrap_or(rest);
            all.push((frame, uses));
        }
    }
    for role in &own {
        let (key, name) = (role.frames_key(), role.name());
        let frames = frames::read(document, key, config, events)?;
        let words =
            if by_author { format!("are the {name} split") } else { "are left out with data.split=every".into() };
        events
            .on(Event::Note(&document.error(&format!("the {} views of \"{key}\" {words}", frames.len())).to_string()));
        match by_author || all.is_empty() {
            true => all.extend(frames.into_iter().map(|frame| (frame, role.and([false; 3])))),
            false => aside.extend(frames.into_iter().map(|frame| frame.place)),
        }
    }
    let named = !own.is_empty() || listed.iter().any(Option::is_some);
    Ok(Listing { frames: all, named, ignored: ignored(document)?.into_iter().collect(), aside })
}

/// Returns the names in the lists of [`Role::ALL`], each of which a frame must have.
fn listed(document: Object) -> Result<Vec<Option<Vec<String>>>> {
    let mut known = HashSet::new();
    let is_there = |role: &Role| names_of(document, *role).is_some();
    let frames = if Role::ALL.iter().any(is_there) { document.objects("frames")? } else { Vec::new() };
    for frame in frames {
        known.insert(frame.picture("file_path")?.written);
    }
    let of_role = |role: Role| {
        let Some(key) = names_of(document, role) else { return Ok(None) };
        let names = document.texts(key)?.unwrap_or_default();
        let names: Vec<String> = names.iter().map(|name| found::slashes(name)).collect();
        match names.iter().find(|name| !known.contains(*name)) {
            Some(name) => Err(document.error(&format!(
                "\"{}\" names \"{name}\", which is the \"file_path\" of no frame: write it as it stands there",
                key
            ))),
            None => Ok(Some(names)),
        }
    };
    Role::ALL.into_iter().map(of_role).collect()
}

/// Returns the error that there is nothing to evaluate, with advice.
pub(super) fn without(wanted: Role, dir: &str, roles: &[Uses]) -> Error {
    let other = if wanted == Role::Test { Role::Val } else { Role::Test };
    let count = roles.iter().filter(|uses| uses[other as usize]).count();
    let advice = match count {
        0 => "set data.split=every to hold out every data.holdout-th view instead".to_string(),
        count => format!("{count} are for data.eval_split={}", other.name()),
    };
    Error::Data(format!(
        "{dir}: the split that the capture's files name has no views for data.eval_split={}; {advice}",
        wanted.name()
    ))
}
