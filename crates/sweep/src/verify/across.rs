//! Comparisons across sweeps, made again from the sweeps' results beside them.

use std::path::Path;

use super::archive::Archive;
use super::files::difference;
use super::findings::Findings;
use super::numbers::Cells;
use crate::across::{ACROSS, AcrossRequest};
use crate::base::files::write_atomic;
use crate::base::{Error, Result};
use crate::outputs::optional;
use crate::view::Source;

/// Compares a folder's files with what the sweeps beside it make, or, with `update`, writes what differs. Returns what pages may
/// quote.
pub fn check(path: &Path, data_root: Option<&Path>, update: bool, findings: &mut Findings) -> Result<Cells> {
    let kept = AcrossRequest::read(path)?;
    let absolute = std::path::absolute(path).map_err(|e| Error::unreadable(path, &e))?;
    let results = absolute.parent().unwrap_or(&absolute);
    let read = |name: &str| {
        // A path would name results that no verification of these looks at.
        if Path::new(name).file_name().is_none_or(|plain| plain != name) {
            return Err(Error::Data(format!("{ACROSS}: sweep '{name}' is not the name of a folder beside this one")));
        }
        let archive = Archive::read(&results.join(name), data_root)?;
        match archive.provenance.name == name {
            true => Ok(archive),
            false => Err(Error::Data(format!(
                "{ACROSS}: the results of sweep '{name}' belong into a folder of that name, and results/{name} holds '{}'",
                archive.provenance.name
            ))),
        }
    };
    let archives = kept.sweep.iter().map(|sweep| read(&sweep.name)).collect::<Result<Vec<_>>>()?;
    let sources: Vec<Source> = archives.iter().map(source_of).collect();
    let (request, across) = AcrossRequest::new(&kept.row, &kept.baseline, &kept.metric, &sources)?;
    let mut wrong = Vec::new();
    for (name, bytes) in request.files(&across)? {
        let found = optional(&path.join(&name))?;
        if found.as_deref() == Some(&bytes[..]) {
            continue;
        }
        if update {
            write_atomic(&path.join(&name), &bytes)?;
            findings.holds(format!("{name}: written anew"));
            continue;
        }
        wrong.push(difference(&name, found.as_deref(), &bytes));
    }
    findings.of(format!("comparisons of {} sweeps, of which {ACROSS} has the hashes", kept.sweep.len()), wrong);
    Cells::of_blocks(path, &across.csv())
}

fn source_of(archive: &Archive) -> Source<'_> {
    Source {
        name: archive.provenance.name.clone(),
        folder: None,
        definition: &archive.definition,
        points: &archive.points,
        outputs: archive.outputs.clone(),
    }
}
