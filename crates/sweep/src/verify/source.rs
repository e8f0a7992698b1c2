//! Whether the sweep file that a results folder is said to be of is the definition that it was made with.

use std::path::{Path, PathBuf};

use super::Verifier;
use super::archive::Archive;
use super::files::Collected;
use super::findings::Findings;
use super::tree::{names_in, root_of};
use crate::base::{Error, Result};
use crate::definition::Definition;
use crate::differences::differences;
use crate::provenance::PROVENANCE;

/// The folder of sweep files, next to that of all results.
const SWEEPS: &str = "sweeps";
/// Folders of sweep files within each other.
const DEEPEST: usize = 3;

/// Compares `sweeps/**/NAME.toml`, if there is one, with the folder's `sweep.toml`. What `provenance.toml` names in a `[[missing]]`
/// may differ, in that and nothing else.
pub fn check(_: &Verifier, sweep: &Collected, findings: &mut Findings) -> Result<()> {
    let archive = &sweep.archive;
    let above = std::path::absolute(&archive.path).map_err(|e| Error::unreadable(&archive.path, &e))?;
    let root = above.parent().map_or(Ok(None), root_of)?;
    let Some(place) = root.as_deref().and_then(Path::parent) else { return Ok(()) };
    let sweeps = place.join(SWEEPS);
    if !sweeps.is_dir() {
        return Ok(());
    }
    let Some(file) = find(&sweeps, &format!("{}.toml", archive.provenance.name), DEEPEST)? else { return Ok(()) };
    let name = file.strip_prefix(place).unwrap_or(&file).display().to_string();
    let definition = match Definition::read(&file) {
        Ok(definition) => definition,
        Err(error) => {
            findings.wrong(error);
            return Ok(());
        }
    };
    let (kept, given) = alike(archive, definition)?;
    let found = differences(&kept, &given);
    let explained = |found: &str| {
        archive.provenance.missing.iter().any(|missing| missing.what == name && missing.why.contains(found))
    };
    if found.is_empty() {
        findings.holds(format!("{name} is the definition of these results"));
    } else if !explained(&found) {
        findings.wrong(format!(
            "{name}: it is not the definition that these results were made with (sweep.toml here); it differs in {found}. \
             Restore it, or say why in a [[missing]] of {PROVENANCE}, with what = \"{name}\" and these differences in why"
        ));
    }
    Ok(())
}

/// The folder's definition and the file's, each with what decides the other's points: changes of the command line, and defaults
/// of the revision that made them.
fn alike(archive: &Archive, mut given: Definition) -> Result<(Definition, Definition)> {
    let mut kept = archive.definition.clone();
    given.repeat_changes(&kept)?;
    // No point hangs on it.
    given.title.clone_from(&kept.title);
    for (path, value) in &archive.provenance.defaults_then {
        if given.set.get(path) == Some(value) {
            kept.set.entry(path.clone()).or_insert_with(|| value.clone());
        }
    }
    Ok((kept, given))
}

fn find(folder: &Path, name: &str, depth: usize) -> Result<Option<PathBuf>> {
    let file = folder.join(name);
    if file.is_file() {
        return Ok(Some(file));
    }
    let below = names_in(folder)?.into_iter().map(|name| folder.join(name)).filter(|path| path.is_dir());
    for path in below.filter(|_| depth > 1) {
        if let Some(found) = find(&path, name, depth - 1)? {
            return Ok(Some(found));
        }
    }
    Ok(None)
}
