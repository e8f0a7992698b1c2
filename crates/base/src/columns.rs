//! Columns of tables: their names and cells in files.

use crate::csv::{hash_cell, plain_hash};

/// Fields that have another name in files, where their own is a keyword of Python.
const RENAMED: [(&str, &str); 1] = [("lambda", "perturb_lambda")];
/// Columns of hashes.
const HASHES: [&str; 6] = ["id", "config_hash", "data_hash", "corruption_hash", "code_revision", "parent"];

/// Returns whether cells of a column are hashes.
pub fn has_hashes(name: &str) -> bool {
    HASHES.contains(&name)
}

/// Returns the name of a field in files.
pub fn file_name(name: &str) -> &str {
    RENAMED.iter().find(|(own, _)| *own == name).map_or(name, |(_, other)| other)
}

/// Returns a field's name and cell in files.
pub fn file_field((name, cell): (String, String)) -> (String, String) {
    let cell = if has_hashes(&name) { hash_cell(&cell) } else { cell };
    (file_name(&name).into(), cell)
}

/// Returns the name and text that were given to [`file_field`].
pub fn plain_field((name, cell): (String, String)) -> (String, String) {
    let cell = if has_hashes(&name) { plain_hash(&cell).to_string() } else { cell };
    (RENAMED.iter().find(|(_, other)| *other == name).map_or(name, |(own, _)| own.to_string()), cell)
}
