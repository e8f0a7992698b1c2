//! `provenance.toml`: which code made a results' folder, and what of it cannot be made again.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use toml::Table;

use crate::base::files::write_atomic;
use crate::base::input::{TEXT_BYTES, read_text};
use crate::base::{Error, Result};
use crate::report::{Record, Status};

use super::words::check_name;

/// The file's name.
pub const PROVENANCE: &str = "provenance.toml";

/// Where a results' folder comes from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// The sweep's name, as its tables print it.
    pub name: String,
    /// Revision of the code that its points were made by.
    pub code_revision: String,
    /// Settings that its revision did not have: no part of its points' names.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub settings_since: Vec<String>,
    /// Settings whose default has changed since, with what it was.
    #[serde(default, skip_serializing_if = "Table::is_empty")]
    pub defaults_then: Table,
    /// Files that cannot be made again from what is kept, with the SHA-256 of what they hold.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub pinned: BTreeMap<String, String>,
    /// What is not kept, or not checked, with the reason.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub missing: Vec<Missing>,
}

/// Something that a results' folder lacks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Missing {
    /// A file, or what could be checked with it.
    pub what: String,
    /// Why it is not there.
    pub why: String,
}

impl Provenance {
    /// That of points which were all collected just now.
    pub fn of(name: &str, records: &[Record]) -> Provenance {
        let mut revisions: Vec<&str> = Vec::new();
        for record in records.iter().filter(|record| record.status == Status::Done) {
            let revision = record.protocol("code_revision");
            if !revisions.contains(&revision) {
                revisions.push(revision);
            }
        }
        let open = records.iter().filter(|record| record.status != Status::Done);
        let missing = open.map(|record| Missing {
            what: format!("the numbers of {} ({})", record.id, record.point_label()),
            why: [record.status.name(), &record.reason].join(" ").trim().into(),
        });
        let missing = missing.collect();
        Provenance { name: name.into(), code_revision: revisions.join(", "), missing, ..Provenance::default() }
    }

    /// That of a results' folder; none where it has none.
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

    /// Pinned files lie in the folder itself, and the sweep's name can be printed.
    fn check_names(&self) -> std::result::Result<(), String> {
        check_name("the sweep's name", &self.name)?;
        let is_plain = |name: &str| Path::new(name).file_name().is_some_and(|plain| plain == name);
        match self.pinned.keys().find(|name| !is_plain(name)) {
            Some(name) => Err(format!("pinned: {name:?} is not the name of a file in this folder")),
            None => Ok(()),
        }
    }

    /// Writes it into a results' folder.
    pub fn write(&self, results: &Path) -> Result<()> {
        let text = toml::to_string(self).expect("plain data");
        write_atomic(&results.join(PROVENANCE), text.as_bytes())
    }
}

/// A file's SHA-256 in hexadecimal digits.
pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}
