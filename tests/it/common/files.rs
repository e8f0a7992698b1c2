//! Files that a test reads back.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use augnerf::base::csv::plain_hash;
use augnerf::data::npy::header;

/// Of a run, what need not repeat: clocks and locks.
pub const FLEETING: [&str; 2] = ["timing.json", "run.lock"];

/// A file or folder below `tests/fixtures`.
pub fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(name)
}

/// A file's text.
#[track_caller]
pub fn text(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Replaces the first of a text in a file.
#[track_caller]
pub fn edit(path: &Path, from: &str, to: &str) {
    let before = text(path);
    assert!(before.contains(from), "{}: {from}", path.display());
    std::fs::write(path, before.replacen(from, to, 1)).unwrap();
}

/// A JSON file.
#[track_caller]
pub fn json(path: &Path) -> serde_json::Value {
    serde_json::from_str(&text(path)).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// A line of a CSV file by its columns.
pub type Cells = HashMap<String, String>;

/// A cell's number.
#[track_caller]
pub fn number(row: &Cells, column: &str) -> f64 {
    row[column].parse().unwrap_or_else(|_| panic!("{column}: {row:?}"))
}

/// The rows of a CSV text: each its cells by column.
pub fn rows(csv: &str) -> Vec<Cells> {
    csv::Reader::from_reader(csv.as_bytes()).deserialize().map(|row| row.unwrap()).collect()
}

/// Gives a checkpoint that a test changed the checksums of its files.
pub fn seal(checkpoint: &Path) {
    let sums = checkpoint.join("SHA256SUMS");
    let sum = |line: &str| {
        let (_, name) = line.split_once("  ").unwrap();
        format!("{}  {name}\n", augnerf::train::sha256(&std::fs::read(checkpoint.join(name)).unwrap()))
    };
    let sealed: String = text(&sums).lines().map(sum).collect();
    std::fs::write(sums, sealed).unwrap();
}

/// A line of `points.csv` with what all lines share.
#[derive(Clone, Debug, PartialEq)]
pub struct PointCells(Cells);

impl std::ops::Index<&str> for PointCells {
    type Output = String;

    /// Cells that no line has are no columns.
    fn index(&self, column: &str) -> &String {
        static EMPTY: String = String::new();
        self.0.get(column).unwrap_or(&EMPTY)
    }
}

/// The points of a results folder, each with all of its protocol, hashes without their letter.
#[track_caller]
pub fn points_of(results: &Path) -> Vec<PointCells> {
    let provenance: toml::Table = text(&results.join("provenance.toml")).parse().unwrap();
    let constants = provenance.get("constants").and_then(toml::Value::as_table).cloned().unwrap_or_default();
    let shared = constants.into_iter().map(|(name, value)| match value {
        toml::Value::String(text) => (name, text),
        other => (name, other.to_string()),
    });
    let shared: Vec<(String, String)> = shared.collect();
    let whole = |row: Cells| {
        let is_done = row["status"] == "done";
        let all = row.into_iter().chain(shared.iter().filter(|_| is_done).cloned());
        PointCells(all.map(|(name, cell)| (name, plain_hash(&cell).to_string())).collect())
    };
    rows(&text(&results.join("points.csv"))).into_iter().map(whole).collect()
}

/// The file or folder that a folder holds alone or, by name, last.
#[track_caller]
pub fn newest(folder: &Path) -> PathBuf {
    entries(folder).pop().unwrap_or_else(|| panic!("{} is empty", folder.display()))
}

/// Paths of what a folder holds, by name.
#[track_caller]
pub fn entries(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    paths
}

/// Every file below a folder whose name ends so, by its path.
pub fn ending(folder: &Path, end: &str) -> Vec<PathBuf> {
    let found = files(folder, &[]).into_iter().map(|(place, _)| folder.join(place));
    found.filter(|path| path.to_str().unwrap().ends_with(end)).collect()
}

/// Every file below a folder with its place there, but what lies at one of the places `without`.
#[track_caller]
pub fn files(folder: &Path, without: &[&str]) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(next) = folders.pop() {
        for path in entries(&next) {
            let place = path.strip_prefix(folder).unwrap();
            if without.iter().any(|other| place.starts_with(other)) {
                continue;
            }
            if path.is_dir() {
                folders.push(path);
            } else {
                found.push((place.to_path_buf(), std::fs::read(&path).unwrap()));
            }
        }
    }
    found.sort();
    found
}

/// Copies a folder into another.
pub fn copy(from: &Path, to: &Path) {
    for (place, content) in files(from, &[]) {
        let path = to.join(place);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, content).unwrap();
    }
}

/// A file of an array as NumPy stores it.
pub fn npy(kind: &str, shape: [usize; 2], bytes: &[u8]) -> Vec<u8> {
    [&header(kind, &shape)[..], bytes].concat()
}

/// Writes `poses_bounds.npy`.
pub fn write_poses(folder: &Path, rows: &[[f64; 17]]) {
    let bytes: Vec<u8> = rows.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
    std::fs::write(folder.join("poses_bounds.npy"), npy("<f8", [rows.len(), 17], &bytes)).unwrap();
}

/// Demands that two folders hold the same files with the same bytes, but at the places `without`.
#[track_caller]
pub fn assert_same_files(a: &Path, b: &Path, without: &[&str]) {
    let (a, b) = (files(a, without), files(b, without));
    let names = |files: &[(PathBuf, Vec<u8>)]| files.iter().map(|(name, _)| name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&a), names(&b));
    for ((name, left), (_, right)) in a.iter().zip(&b) {
        assert!(left == right, "{} differs", name.display());
    }
}
