//! A sweep file that starts from another: `extends = "tab4_ablation.toml"`.

use std::path::{Path, PathBuf};

use toml::{Table, Value};

use crate::base::input::{TEXT_BYTES, read_named};
use crate::base::{Error, Result};

/// Most points, and so rows, of a sweep.
pub(super) const MOST_POINTS: usize = 10_000;
const EXTENDS: &str = "extends";
/// Most files in a chain of `extends`; a longer chain is probably a cycle.
const DEEPEST: usize = 8;

/// Reads a file's table, merged over the files that it extends. A file names the next one relative to itself. Tables
/// and rows of equal name are merged key by key. A row with `remove = true` removes the row of its name. Other values
/// are replaced.
pub fn read(path: &Path) -> Result<Table> {
    read_at(path, 0)
}

fn read_at(path: &Path, depth: usize) -> Result<Table> {
    let unreadable = |e: std::io::Error| {
        // Probably the name of a scene.
        let tip = match (depth, path.extension()) {
            (0, None) => format!(
                "; a sweep is a TOML file, which `augnerf sweep new` writes; `augnerf train --data {}` trains on a scene",
                path.display()
            ),
            _ => String::new(),
        };
        Error::Config(format!("cannot read the sweep file {}: {e}{tip}", path.display()))
    };
    let text = read_named(path, TEXT_BYTES).map_err(unreadable)?;
    let in_file = |message: String| Error::Config(format!("{}: {message}", path.display()));
    let mut table: Table = toml::from_str(&text).map_err(|e| in_file(e.to_string()))?;
    // Check this before each row is looked up in the extended file.
    let rows = table.get("row").and_then(Value::as_array).map_or(0, Vec::len);
    if rows > MOST_POINTS {
        return Err(in_file(format!("rows: {rows} is more than {MOST_POINTS}; split the sweep")));
    }
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
    let folder = path.parent().map_or_else(PathBuf::new, Path::to_path_buf);
    let mut merged = read_at(&folder.join(&base), depth + 1)?;
    lay_over(&mut merged, table);
    Ok(merged)
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

/// Merges rows into those of equal name; new rows come after.
fn merge_rows(base: &mut Vec<Value>, rows: Vec<Value>) {
    for row in rows {
        let name = row.get("name").cloned();
        if row.get("remove").and_then(Value::as_bool) == Some(true) {
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
