//! A sweep file that starts from another: `extends = "tab4_ablation.toml"`.

use std::path::Path;

use toml::{Table, Value};

use crate::base::input::{TEXT_BYTES, read_named};
use crate::base::{Error, Result};

use super::definition::is_named;
use super::shipped::{nearest, shipped};

const EXTENDS: &str = "extends";
/// Most files in a chain of `extends`; a longer chain is probably a cycle.
const DEEPEST: usize = 8;

/// Reads a file's table, merged over the files that it extends. A file names the next one relative to itself. Tables
/// and rows of equal name are merged key by key. A row with `remove = true` removes the row of its name. Other values
/// are replaced. A bare
/// name that is no file is that of a shipped sweep.
pub fn read(path: &Path) -> Result<Table> {
    match path.to_str().filter(|_| !path.exists() || path.is_dir()).and_then(shipped) {
        Some(found) => read_shipped(found, 0),
        None => read_file(path, 0),
    }
}

fn read_shipped((name, text): (&str, &str), depth: usize) -> Result<Table> {
    over_base(text, Path::new(name), depth, |base| {
        let found = base.strip_suffix(".toml").and_then(shipped);
        read_shipped(found.ok_or_else(|| Error::Config(format!("{name}: no shipped sweep is {base}")))?, depth + 1)
    })
}

fn read_file(path: &Path, depth: usize) -> Result<Table> {
    let unreadable = |e: std::io::Error| {
        let stem = path.file_stem().and_then(|stem| stem.to_str());
        let tip = match (depth, stem.and_then(nearest)) {
            (0, Some((name, place))) if Some(name) == stem => format!("; the shipped sweep of this name is {place}"),
            (0, Some((name, place))) => format!("; similar: the shipped sweep {name}, {place}"),
            // Probably the name of a scene.
            (0, None) if path.extension().is_none() => format!(
                "; a sweep is a TOML file, which `augnerf sweep new` writes, or the name of a shipped one; `augnerf train \
                 --data {}` trains on a scene",
                path.display()
            ),
            _ => String::new(),
        };
        Error::Config(format!("cannot read the sweep file {}: {e}{tip}", path.display()))
    };
    let text = read_named(path, TEXT_BYTES).map_err(unreadable)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    over_base(&text, path, depth, |base| read_file(&folder.join(base), depth + 1))
}

/// A text's table over that of the file that it extends, which `read_base` reads.
fn over_base(text: &str, path: &Path, depth: usize, read_base: impl FnOnce(&str) -> Result<Table>) -> Result<Table> {
    let in_file = |message: String| Error::Config(format!("{}: {message}", path.display()));
    let mut table: Table = toml::from_str(text).map_err(|e| in_file(e.to_string()))?;
    let Some(base) = table.remove(EXTENDS) else {
        return Ok(table);
    };
    let Value::String(base) = base else {
        return Err(in_file(format!("extends = {base} is not the name of a sweep file in quotes")));
    };
    if depth == DEEPEST {
        return Err(in_file(format!(
            "extends = \"{base}\" is more than {DEEPEST} files deep; check whether files extend each other"
        )));
    }
    let mut merged = read_base(&base)?;
    drop_scenes(&mut merged, &table);
    check_removed(&merged, &table).map_err(|name| {
        in_file(format!(
            "[[row]] {name}: remove = true, but {base} has no row of this name; check how it is written there"
        ))
    })?;
    lay_over(&mut merged, table);
    Ok(merged)
}

/// Drops the settings of scenes that a file replaces by others.
fn drop_scenes(base: &mut Table, table: &Table) {
    let Some(scenes) = table.get("scenes").and_then(Value::as_array) else { return };
    let stay = |name: &str| scenes.iter().filter_map(Value::as_str).any(|scene| is_named(scene, name));
    if let Some(Value::Table(by_scene)) = base.get_mut("by_scene") {
        by_scene.retain(|name, _| stay(name));
    }
}

fn lay_over(base: &mut Table, table: Table) {
    for (key, value) in table {
        match (base.get_mut(&key), value) {
            (Some(Value::Table(below)), Value::Table(above)) => lay_over(below, above),
            (Some(Value::Array(below)), Value::Array(above)) if key == "row" => merge_rows(below, above),
            (_, value) => {
                base.insert(key, value);
            }
        }
    }
}

fn is_removed(row: &Value) -> bool {
    row.get("remove").and_then(Value::as_bool) == Some(true)
}

/// Returns the name of a row that a file removes and the extended file lacks as the error.
fn check_removed(base: &Table, table: &Table) -> std::result::Result<(), String> {
    let rows = |table: &Table| table.get("row").and_then(Value::as_array).cloned().unwrap_or_default();
    let known = rows(base);
    let is_known = |name: Option<&Value>| known.iter().any(|row| name.is_some() && row.get("name") == name);
    match rows(table).iter().find(|row| is_removed(row) && !is_known(row.get("name"))) {
        Some(row) => Err(row.get("name").map_or("without a name".into(), Value::to_string)),
        None => Ok(()),
    }
}

/// Merges rows into those of equal name; new rows come after.
fn merge_rows(base: &mut Vec<Value>, rows: Vec<Value>) {
    for row in rows {
        let name = row.get("name").cloned();
        if is_removed(&row) {
            base.retain(|known| known.get("name") != name.as_ref());
            continue;
        }
        let known = base.iter_mut().find(|known| name.is_some() && known.get("name") == name.as_ref());
        match (known, row) {
            (Some(Value::Table(below)), Value::Table(above)) => lay_over(below, above),
            (_, row) => base.push(row),
        }
    }
}
