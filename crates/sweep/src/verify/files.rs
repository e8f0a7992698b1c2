//! Tables and figures, made again and compared byte for byte.

use std::collections::BTreeMap;

use super::archive::Archive;
use super::findings::Findings;
use crate::base::files::write_atomic;
use crate::base::{Error, Result};
use crate::collect::PAGE;
use crate::folder::{DEFINITION, PLAN, STEP_SECONDS};
use crate::outputs::{SCALARS, optional};
use crate::provenance::{PROVENANCE, sha256};
use crate::report::exporters::{EXPORTERS, OF_LOGS};
use crate::scored::SCORED;

/// What tables and figures are made of: read, never made.
const KEPT: [&str; 7] = [DEFINITION, PLAN, STEP_SECONDS, SCALARS, SCORED, PROVENANCE, "timing.csv"];

/// Whether a file of a results' folder is one that tables and figures are made of.
pub fn is_kept(name: &str) -> bool {
    KEPT.contains(&name)
}

/// Files by their names.
pub type Made = BTreeMap<String, Vec<u8>>;

/// Compares all files of a results' folder with what its points make, or, with `update`, writes what differs. Returns what
/// the points make.
pub fn check(archive: &Archive, update: bool, findings: &mut Findings) -> Result<Made> {
    let mut made = Made::new();
    let table = archive.files(&mut |name, bytes| {
        made.insert(name.into(), bytes.to_vec());
        Ok(())
    })?;
    if let Some(line) = table.lines.iter().find(|line| !line.mixed.is_empty()) {
        findings.not_checked(format!(
            "whether rows may stand side by side: '{}' differs in {}, as the table says",
            line.label,
            line.mixed.join(", ")
        ));
    }
    let mut wrong = Vec::new();
    for (name, bytes) in &made {
        let path = archive.path.join(name);
        let found = optional(&path)?;
        // A sweep without any clock has had none since it was collected.
        if found.as_ref() == Some(bytes) || (found.is_none() && name == "timing.csv") {
            continue;
        }
        if update {
            write_atomic(&path, bytes)?;
            findings.holds(format!("{name}: written anew"));
            continue;
        }
        wrong.push(difference(name, found.as_deref(), bytes));
    }
    findings.of(format!("{} tables and figures from {} points", made.len(), archive.done().count()), wrong);
    pins(archive, &made, findings)?;
    others(archive, &made, update, findings)?;
    for missing in &archive.provenance.missing {
        findings.not_checked(format!("{}: {}", missing.what, missing.why));
    }
    Ok(made)
}

/// Files that are held to their hash, because nothing makes them again. What is made again needs none, and a hash would be
/// no proof of it.
fn pins(archive: &Archive, made: &Made, findings: &mut Findings) -> Result<()> {
    for (name, hash) in &archive.provenance.pinned {
        if let Some(reason) = no_pin(archive, made, name) {
            findings.wrong(format!("{name}: {PROVENANCE} has its hash under [pinned], but {reason}"));
            continue;
        }
        match optional(&archive.path.join(name))? {
            None => findings.wrong(format!("{name}: it is not there, {PROVENANCE} has its hash")),
            Some(bytes) if sha256(&bytes) != *hash => {
                findings.wrong(format!("{name}: its SHA-256 is {}, {PROVENANCE} has {hash}", sha256(&bytes)));
            }
            Some(_) => findings.not_checked(format!("{name}: it is as it was committed; nothing here makes it again")),
        }
    }
    Ok(())
}

/// Why a file must not be pinned; none where it may be. What is made of logs, and surfaces, are made of what a results' folder may
/// lack.
fn no_pin(archive: &Archive, made: &Made, name: &str) -> Option<String> {
    let Some(owner) = EXPORTERS.iter().find(|exporter| exporter.owns(name)) else {
        return KEPT.contains(&name).then(|| "tables are made of it".into());
    };
    let lacks = |what: &str| archive.provenance.missing.iter().any(|missing| missing.what.contains(what));
    match () {
        () if made.contains_key(name) => Some("the points make it".into()),
        () if !owner.repeats() => None,
        () if !OF_LOGS.iter().any(|exporter| exporter.owns(name)) => Some("the points do not make it".into()),
        () if lacks(SCALARS) => None,
        () => Some(format!("no [[missing]] says why there is no {SCALARS} to make it of")),
    }
}

/// Files that the points do not make: figures of an earlier time do not belong.
fn others(archive: &Archive, made: &Made, update: bool, findings: &mut Findings) -> Result<()> {
    let pinned = &archive.provenance.pinned;
    let listed = std::fs::read_dir(&archive.path).map_err(|e| Error::unreadable(&archive.path, &e))?;
    let mut names = Vec::new();
    for entry in listed {
        let entry = entry.map_err(|e| Error::unreadable(&archive.path, &e))?;
        names.push(entry.file_name().to_string_lossy().into_owned());
    }
    names.sort();
    for name in names {
        let accounted = made.contains_key(&name) || pinned.contains_key(&name) || KEPT.contains(&name.as_str());
        if accounted {
            continue;
        }
        let without_png = name.ends_with(".png") && made.contains_key(&name.replace(".png", ".svg"));
        if without_png {
            findings.not_checked(format!("{name}: this program is built without PNG figures"));
        } else if name == PAGE {
            findings.not_checked(format!("{name}: it shows these files, with pictures that lie with the runs"));
        } else if !EXPORTERS.iter().any(|exporter| exporter.owns(&name)) {
            findings.not_checked(format!("{name}: nothing here makes it, and {PROVENANCE} does not name it"));
        } else if update {
            let path = archive.path.join(&name);
            std::fs::remove_file(&path).map_err(|e| Error::unwritable(&path, &e))?;
            findings.holds(format!("{name}: deleted, the points do not make it"));
        } else {
            findings.wrong(format!("{name}: the points do not make it"));
        }
    }
    Ok(())
}

/// Where a file differs, for a person: the first line of a text.
pub fn difference(name: &str, found: Option<&[u8]>, made: &[u8]) -> String {
    let Some(found) = found else { return format!("{name}: the points make it, and it is not there") };
    let texts = std::str::from_utf8(found).ok().zip(std::str::from_utf8(made).ok());
    let Some((found, made)) = texts else { return format!("{name}: it is not the picture that the points make") };
    let (mut ours, mut theirs) = (found.lines(), made.lines());
    let mut line = 1;
    loop {
        match (ours.next(), theirs.next()) {
            (None, None) => return format!("{name}: its line endings are not those that the points make"),
            (a, b) if a == b => line += 1,
            (a, b) => {
                let (a, b) = around_difference(a.unwrap_or("(nothing)"), b.unwrap_or("(nothing)"));
                return format!("{name}, line {line}: '{a}' stands there, the points make '{b}'");
            }
        }
    }
}

/// A few words of each of two lines from where they differ.
fn around_difference(a: &str, b: &str) -> (String, String) {
    const BEFORE: usize = 12;
    const SHOWN: usize = 48;
    let same = a.chars().zip(b.chars()).take_while(|(a, b)| a == b).count();
    let part = |text: &str| text.chars().skip(same.saturating_sub(BEFORE)).take(SHOWN).collect::<String>();
    (part(a), part(b))
}
