//! `provenance.toml`: the code that made a results folder, and which of its files cannot be made again.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::base::files::write_atomic;
use crate::base::input::{TEXT_BYTES, read_text};
use crate::base::{Error, Result};
use crate::report::{Record, Status};

use super::axes::text;
use super::outputs::SweepOutputs;
use super::words::check_name;
use crate::report::tables::Constants;

/// The file's name.
pub const PROVENANCE: &str = "provenance.toml";

/// The origin of a results folder.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// The sweep's name, as in its tables.
    pub name: String,
    /// Revision of the code that made its points.
    pub code_revision: String,
    /// Files that tables are made of and nothing makes again, with the SHA-256 that they had when they were collected.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub inputs: BTreeMap<String, String>,
    /// Files that cannot be made again from what is kept, with the SHA-256 of their content.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub pinned: BTreeMap<String, String>,
    /// Files that are not kept here, though a commit has them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub archived: Option<Archived>,
    /// What is not kept or not checked, with the reason.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub missing: Vec<Missing>,
    /// Protocol fields that all points share. `points.csv` and `table.csv` have no column of them.
    #[serde(default, skip_serializing_if = "Table::is_empty")]
    pub constants: Table,
}

/// Files of an earlier commit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Archived {
    /// The commit that has them.
    pub commit: String,
    /// The SHA-256 of what they hold there.
    pub files: BTreeMap<String, String>,
}

/// A part that a results folder lacks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Missing {
    /// A file, or a check that needs it.
    pub what: String,
    /// The reason.
    pub why: String,
}

impl Missing {
    /// Returns whether it gives the reason why a point is not done.
    pub(super) fn names(&self, record: &Record) -> bool {
        record.status != Status::Done && self.what.contains(&record.id) && !self.why.trim().is_empty()
    }
}

impl Provenance {
    /// Returns the provenance of points that were all collected now.
    pub fn of(name: &str, records: &[Record]) -> Provenance {
        let mut revisions: Vec<&str> = Vec::new();
        for record in records.iter().filter(|record| record.status == Status::Done) {
            let revision = record.protocol("code_revision");
            if !revisions.contains(&revision) {
                revisions.push(revision);
            }
        }
        Provenance { name: name.into(), code_revision: revisions.join(", "), ..Provenance::default() }
    }

    /// Sets what all points share.
    pub fn set_constants(&mut self, outputs: &SweepOutputs) {
        self.constants = toml_of(&outputs.constants());
    }

    /// Returns what all points share as text.
    pub fn constants(&self) -> Constants {
        self.constants.iter().map(|(name, value)| (name.clone(), text(value))).collect()
    }

    /// Reads the provenance of a results folder, or returns `None` if it has none.
    pub fn read(results: &Path) -> Result<Option<Provenance>> {
        let path = results.join(PROVENANCE);
        let text = match read_text(&path, TEXT_BYTES) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(Error::unreadable(&path, &error)),
        };
        let bad = |e: String| Error::Data(format!("{}: {e}", path.display()));
        let read: Provenance = toml::from_str(&text).map_err(|e| bad(e.to_string()))?;
        read.check_names().map_err(bad)?;
        Ok(Some(read))
    }

    /// Checks that listed files are in the folder itself and that the sweep's name can be printed.
    fn check_names(&self) -> std::result::Result<(), String> {
        check_name("the sweep's name", &self.name)?;
        let is_plain = |name: &str| Path::new(name).file_name().is_some_and(|plain| plain == name);
        let archived = self.archived.iter().flat_map(|archived| archived.files.keys());
        match self.pinned.keys().chain(self.inputs.keys()).chain(archived).find(|name| !is_plain(name)) {
            Some(name) => Err(format!("{name:?} is not the name of a file in this folder")),
            None => Ok(()),
        }
    }

    /// Writes it into a results folder.
    pub fn write(&self, results: &Path) -> Result<()> {
        let text = toml::to_string(self).expect("plain data");
        write_atomic(&results.join(PROVENANCE), text.as_bytes())
    }
}

/// Returns constants as TOML, numbers as numbers.
pub(super) fn toml_of(constants: &Constants) -> Table {
    let value = |cell: &str| {
        let integer = cell.parse().ok().map(Value::Integer);
        let others = [cell.parse().ok().map(Value::Float), cell.parse().ok().map(Value::Boolean)];
        integer.into_iter().chain(others.into_iter().flatten()).find(|value| text(value) == cell).unwrap_or(cell.into())
    };
    constants.iter().map(|(name, cell)| (name.clone(), value(cell))).collect()
}
