//! Tables and figures, made again and compared byte for byte.

use std::collections::BTreeMap;
use std::path::Path;

use super::Verifier;
use super::archive::Archive;
use super::findings::Findings;
use super::tree::names_in;
use crate::base::files::write_atomic;
use crate::base::{Error, Result};
use crate::collect::{PAGE, TIMING};
use crate::folder::{DEFINITION, PLAN, STEP_SECONDS};
use crate::outputs::{SCALARS, optional};
use crate::provenance::{Archived, PROVENANCE};
use crate::report::exporters::{is_made, is_made_of_logs};
use crate::report::tables::Constants;
use crate::report::{Record, Status};
use crate::train::sha256;

/// What tables and figures are made of: read, never made.
const KEPT: [&str; 6] = [DEFINITION, PLAN, STEP_SECONDS, SCALARS, PROVENANCE, TIMING];

/// Whether a file of a results' folder is one that tables and figures are made of.
pub fn is_kept(name: &str) -> bool {
    KEPT.contains(&name)
}

/// Files by their names.
pub type Made = BTreeMap<String, Vec<u8>>;

/// Compares all files of a results' folder with what its points make, or, with `update`, writes what differs.
pub fn check(verifier: &Verifier, archive: &Archive, findings: &mut Findings) -> Result<()> {
    let mut files = Vec::new();
    let table = archive.files(&mut files)?;
    let made: Made = files.into_iter().collect();
    if let Some(line) = table.lines.iter().find(|line| !line.mixed.is_empty()) {
        findings.not_checked(format!(
            "whether rows may stand side by side: '{}' differs in {}, as the table says",
            line.label,
            line.mixed.join(", ")
        ));
    }
    let archived = archive.provenance.archived.as_ref();
    // A sweep without any clock has had none since it was collected.
    let may_lack = |name: &str| {
        is_spare(&archive.path, name) || name == TIMING || archived.is_some_and(|a| a.files.contains_key(name))
    };
    let held = inputs(archive, findings)?;
    let compared = Compared::new(verifier, &archive.path, made.iter(), may_lack, findings)?;
    match archive.done().count() {
        0 if compared.wrong.is_empty() => {
            findings.not_checked("tables and figures: no point is done, so that they show no results");
        }
        done => compared.report(&format!("from {done} points"), findings),
    }
    not_kept(&compared.absent, archived, &archive.path, findings);
    pins(archive, &made, findings)?;
    let sorted = |mut constants: Constants| {
        constants.sort();
        constants
    };
    if sorted(archive.provenance.constants()) != sorted(archive.sweep.outputs.constants()) {
        findings.wrong(format!("{PROVENANCE}: [constants] are not the fields that all points share, without a column"));
    }
    if verifier.update {
        repin(archive, &held)?;
    }
    findings.of(
        format!("{} points: each is done, or a [[missing]] says why not", archive.sweep.points.len()),
        gaps(archive),
    );
    page(archive, verifier.update, findings)?;
    others(archive, &made, verifier.update, findings)?;
    for missing in &archive.provenance.missing {
        findings.not_checked(format!("{}: {}", missing.what, missing.why));
    }
    Ok(())
}

/// Returns which points have no line, or no numbers and no reason why.
fn gaps(archive: &Archive) -> Vec<String> {
    let (records, missing) = (&archive.sweep.outputs.records, &archive.provenance.missing);
    let mut wrong = Vec::new();
    for point in &archive.sweep.points {
        let own = records.iter().filter(|record| record.id == point.id);
        if own.clone().count() < point.places.len() {
            wrong.push(format!("points.csv lacks {}, which points.json has", point.label()));
        }
        let unexplained =
            |record: &&Record| record.status != Status::Done && !missing.iter().any(|missing| missing.names(record));
        if let Some(record) = own.clone().find(unexplained) {
            let (label, status) = (record.point_label(), record.status.name());
            wrong.push(format!(
                "points.csv: {label} is '{status}', and no [[missing]] of {PROVENANCE} with a why names {}",
                record.id
            ));
        }
    }
    wrong
}

/// Holds what tables are made of to its hash. Returns the names of the files that have theirs.
fn inputs<'a>(archive: &'a Archive, findings: &mut Findings) -> Result<Vec<&'a str>> {
    let hashes = &archive.provenance.inputs;
    let mut held = Vec::new();
    for (name, hash) in hashes {
        match optional(&archive.path.join(name))?.map(|bytes| sha256(&bytes)) {
            None => findings.wrong(format!("{name}: it is not there, {PROVENANCE} has its hash")),
            Some(found) if found != *hash => findings.wrong(format!(
                "{name}: its SHA-256 is {found}, {PROVENANCE} has {hash} under [inputs]; restore it, or collect the sweep again"
            )),
            Some(_) => held.push(name.as_str()),
        }
    }
    if !hashes.contains_key(DEFINITION) {
        findings.not_checked(format!("{DEFINITION}: {PROVENANCE} has no hash of it under [inputs]"));
    }
    Ok(held)
}

/// Writes the hashes of files that had theirs and were written anew.
fn repin(archive: &Archive, held: &[&str]) -> Result<()> {
    let path = archive.path.join(PROVENANCE);
    let bytes = optional(&path)?.unwrap_or_default();
    let before = String::from_utf8_lossy(&bytes);
    let mut text = before.to_string();
    for name in held {
        let bytes = optional(&archive.path.join(name))?.unwrap_or_default();
        // In place, so that comments stay.
        text = text.replace(&archive.provenance.inputs[*name], &sha256(&bytes));
    }
    if text == before { Ok(()) } else { write_atomic(&path, text.as_bytes()) }
}

/// The page, where there is one: what `augnerf report` makes of these results, or the one that was collected with images of runs.
fn page(archive: &Archive, update: bool, findings: &mut Findings) -> Result<()> {
    let path = archive.path.join(PAGE);
    let Some(found) = optional(&path)?.filter(|_| !archive.provenance.pinned.contains_key(PAGE)) else { return Ok(()) };
    let (_, made) = archive.page(None)?;
    if found == made.as_bytes() {
        findings.holds(format!("{PAGE}: it is what `augnerf report` makes of these results"));
    } else if update {
        write_atomic(&path, made.as_bytes())?;
        findings.holds(format!("{PAGE}: written anew"));
    } else {
        findings.wrong(format!(
            "{PAGE}: it is not what `augnerf report` makes of these results, and {PROVENANCE} has no hash of it under [pinned]; \
             `augnerf report {}` writes it again",
            archive.path.display()
        ));
    }
    Ok(())
}

/// Files that were compared with what makes them.
pub struct Compared {
    count: usize,
    wrong: Vec<String>,
    /// Names of those that are not there and may be so.
    pub absent: Vec<String>,
}

impl Compared {
    /// Compares the files in a folder, or, as the verifier updates, writes what differs.
    pub fn new<'m>(
        verifier: &Verifier,
        folder: &Path,
        made: impl Iterator<Item = (&'m String, &'m Vec<u8>)>,
        may_lack: impl Fn(&str) -> bool,
        findings: &mut Findings,
    ) -> Result<Compared> {
        let mut compared = Compared { count: 0, wrong: Vec::new(), absent: Vec::new() };
        for (name, bytes) in made {
            let path = folder.join(name);
            let found = optional(&path)?;
            if found.is_none() && may_lack(name) && !verifier.all {
                compared.absent.push(name.clone());
                continue;
            }
            compared.count += 1;
            if found.as_ref() == Some(bytes) {
                continue;
            }
            if verifier.update {
                write_atomic(&path, bytes)?;
                findings.holds(format!("{name}: written anew"));
            } else {
                compared.wrong.push(difference(name, found.as_deref(), bytes));
            }
        }
        Ok(compared)
    }

    /// Says how many hold, or each that does not.
    pub fn report(&self, from: &str, findings: &mut Findings) {
        findings.of(format!("{} tables and figures {from}", self.count), self.wrong.clone());
    }
}

/// Whether a file is a picture.
pub fn is_figure(name: &str) -> bool {
    name.ends_with(".svg")
}

/// Whether a file shows a CSV table once more, as Markdown or LaTeX.
fn is_twin(name: &str) -> bool {
    name.ends_with(".md") || name.ends_with(".tex")
}

/// Whether a folder may do without a file: a picture, the caption of a picture that it does without, too, or a CSV table's twin.
pub fn is_spare(folder: &Path, name: &str) -> bool {
    let has = |ending: &str| folder.join(name).with_extension(ending).exists();
    is_figure(name) || is_twin(name) || name.ends_with(".txt") && !has("svg")
}

/// Says in one line what is not there, and where it is to be had.
pub fn not_kept(absent: &[String], archived: Option<&Archived>, folder: &Path, findings: &mut Findings) {
    let of_commit: Vec<&str> = archived.iter().flat_map(|archived| archived.files.keys()).map(String::as_str).collect();
    let lost: Vec<&str> = of_commit.iter().copied().filter(|name| !folder.join(name).exists()).collect();
    let figures = absent.iter().filter(|name| is_figure(name)).count();
    let twins = absent.iter().filter(|name| is_twin(name)).cloned();
    let made: Vec<String> = (figures > 0).then(|| format!("{figures} figures")).into_iter().chain(twins).collect();
    let mut parts = Vec::new();
    if !made.is_empty() {
        parts.push(format!("{}, which `--update --all` makes", made.join(", ")));
    }
    if let Some(archived) = archived.filter(|_| !lost.is_empty()) {
        parts.push(format!("{}, which commit {} has", lost.join(", "), archived.commit));
    }
    if !parts.is_empty() {
        findings.not_checked(format!("not kept: {}", parts.join("; ")));
    }
}

/// Files that are held to their hash, because nothing makes them again. What is made again needs none, and a hash would be
/// no proof of it.
fn pins(archive: &Archive, made: &Made, findings: &mut Findings) -> Result<()> {
    let provenance = &archive.provenance;
    let archived = provenance.archived.iter().flat_map(|archived| &archived.files);
    for (name, hash) in archived.filter(|(name, _)| !made.contains_key(*name)) {
        if let Some(bytes) = optional(&archive.path.join(name))? {
            pin(name, "[archived]", hash, &bytes, findings);
        }
    }
    for (name, hash) in &provenance.pinned {
        if let Some(reason) = no_pin(archive, made, name) {
            findings.wrong(format!("{name}: {PROVENANCE} has its hash under [pinned], but {reason}"));
            continue;
        }
        match optional(&archive.path.join(name))? {
            None => findings.wrong(format!("{name}: it is not there, {PROVENANCE} has its hash")),
            // Compared above.
            Some(_) if made.contains_key(name) => {}
            Some(bytes) => pin(name, "[pinned]", hash, &bytes, findings),
        }
    }
    Ok(())
}

fn pin(name: &str, list: &str, hash: &str, bytes: &[u8], findings: &mut Findings) {
    match sha256(bytes) {
        found if found == hash => {
            findings.not_checked(format!(
                "{name}: its hash is that under {list}; it cannot be made again from the files here"
            ));
        }
        found => findings.wrong(format!("{name}: its SHA-256 is {found}, {PROVENANCE} has {hash} under {list}")),
    }
}

/// Why a file must not be pinned; none where it may be. What is made of logs is made of what a results' folder may lack.
fn no_pin(archive: &Archive, made: &Made, name: &str) -> Option<String> {
    if !is_made(name) {
        return KEPT.contains(&name).then(|| "tables are made of it".into());
    }
    let provenance = &archive.provenance;
    let is_archived = provenance.archived.iter().any(|archived| archived.files.contains_key(SCALARS));
    let is_missing = provenance.missing.iter().any(|missing| missing.what.contains(SCALARS));
    let of_logs = is_made_of_logs(name);
    match () {
        // With or without the logs, which one may get.
        () if of_logs && is_archived => None,
        () if made.contains_key(name) => Some("the points make it".into()),
        () if !of_logs => Some("the points do not make it".into()),
        () if is_missing => None,
        () => Some(format!("no [[missing]] says why there is no {SCALARS} to make it of")),
    }
}

/// Files that the points do not make: figures of an earlier time do not belong.
fn others(archive: &Archive, made: &Made, update: bool, findings: &mut Findings) -> Result<()> {
    let archived = archive.provenance.archived.iter().flat_map(|archived| archived.files.keys());
    let listed: Vec<&String> = archive.provenance.pinned.keys().chain(archived).collect();
    for name in names_in(&archive.path)? {
        let accounted =
            made.contains_key(&name) || listed.contains(&&name) || KEPT.contains(&name.as_str()) || name == PAGE;
        if accounted {
            continue;
        }
        if !is_made(&name) {
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
