//! The sweep files that come with the program: a commented template, and those of `sweeps/`.

use std::path::{Path, PathBuf};

use crate::base::files::write_atomic;
use crate::base::{Error, Result};

/// A template with every key of the schema, explained.
pub const TEMPLATE: &str = include_str!("new.toml");

/// Name, place in the repository and text of the files of `sweeps/`, in the order of their places.
pub const SHIPPED: &[(&str, &str, &str)] = include!(concat!(env!("OUT_DIR"), "/shipped.rs"));

/// Writes a sweep file to `file`: the template, or the shipped file `from` together with the files that it extends.
/// Returns the written paths, `file` first.
///
/// # Errors
/// No such sweep is shipped; a file exists already.
pub fn write_new(file: &Path, from: Option<&str>) -> Result<Vec<PathBuf>> {
    let mut files = vec![(file.to_path_buf(), TEMPLATE)];
    if let Some(name) = from {
        files = vec![(file.to_path_buf(), asked(name)?)];
        let mut base = base_of(files[0].1);
        while let Some(name) = base {
            let text = asked(&name)?;
            files.push((file.with_file_name(format!("{name}.toml")), text));
            base = base_of(text);
        }
    }
    for (index, (path, text)) in files.iter().enumerate() {
        // An extended file that exists as shipped is used as it is.
        let same = index > 0 && std::fs::read(path).is_ok_and(|found| found == text.as_bytes());
        let taken = path.symlink_metadata().is_ok() || files[..index].iter().any(|(other, _)| other == path);
        if taken && !same {
            return Err(Error::Output(format!("{} exists already; name another file", path.display())));
        }
    }
    files.iter().try_for_each(|(path, text)| write_atomic(path, text.as_bytes()))?;
    Ok(files.into_iter().map(|(path, _)| path).collect())
}

/// Returns the text of a sweep file: the template, or the shipped file `from`.
///
/// # Errors
/// No such sweep is shipped.
pub fn template(from: Option<&str>) -> Result<&'static str> {
    from.map_or(Ok(TEMPLATE), asked)
}

/// Name and text of the shipped sweep of this name.
pub(super) fn shipped(name: &str) -> Option<(&'static str, &'static str)> {
    SHIPPED.iter().find(|(known, ..)| *known == name).map(|(known, _, text)| (*known, *text))
}

/// Returns name and place in the repository of the shipped sweep of this name, or of a name that differs by at most two letters.
pub(super) fn nearest(name: &str) -> Option<(&'static str, &'static str)> {
    let distance = |known: &str| strsim::osa_distance(known, name);
    let named = SHIPPED.iter().map(|(known, place, _)| (*known, *place));
    named.min_by_key(|(known, _)| distance(known)).filter(|(known, _)| distance(known) <= 2)
}

/// The text of the shipped sweep that `--from` names, by its name or its file.
fn asked(from: &str) -> Result<&'static str> {
    let name = Path::new(from).file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
    shipped(name).map(|(_, text)| text).ok_or_else(|| {
        let names: Vec<&str> = SHIPPED.iter().map(|(name, ..)| *name).collect();
        Error::Config(format!("--from {from}: no shipped sweep has this name; choose from {}", names.join(", ")))
    })
}

/// Returns the name of the shipped file that a text extends.
fn base_of(text: &str) -> Option<String> {
    let table: toml::Table = toml::from_str(text).ok()?;
    let base = table.get("extends")?.as_str()?;
    Some(base.trim_end_matches(".toml").to_string())
}
