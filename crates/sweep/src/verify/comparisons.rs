//! Comparisons over sweeps and scenes, made again from the results of these sweeps.

use std::path::{Path, PathBuf};

use super::Verifier;
use super::archive::Archive;
use super::files::{Compared, Made, is_spare, not_kept};
use super::findings::Findings;
use super::tree::sweeps_named;
use crate::base::{Error, Result};
use crate::comparisons::ComparisonRequest;
use crate::folder::DEFINITION;
use crate::sweep::Sweep;
use crate::view::Origin;

/// Compares a folder's files with what the sweeps make, or, with `update`, writes what differs.
pub fn check(verifier: &Verifier, path: &Path, findings: &mut Findings) -> Result<()> {
    let kept = ComparisonRequest::read(path)?;
    let (request, sweeps) = (kept.file(), kept.sweep.len());
    let archives = archives(path, (request, &kept.sweep), verifier.data_root)?;
    let sources: Vec<Sweep> = archives.into_iter().map(|archive| archive.sweep).collect();
    let labels = kept.labels();
    let (asked, comparisons) = kept.answer(&sources, &labels)?;
    let made: Made = asked.files(&comparisons).into_iter().collect();
    let compared = Compared::new(verifier, path, made.iter(), |name| is_spare(path, name), findings)?;
    compared.report(&format!("from comparisons of {sweeps} sweeps, of which {request} has the hashes"), findings);
    not_kept(&compared.absent, None, path, findings);
    Ok(())
}

/// The results of the sweeps that a request names.
fn archives(path: &Path, (request, sweeps): (&str, &[Origin]), data_root: Option<&Path>) -> Result<Vec<Archive>> {
    let read = |sweep: &Origin| {
        let archive = Archive::read(&folder_of(path, request, &sweep.name)?, data_root)?;
        let (found, name) = (&archive.provenance.name, &sweep.name);
        if found != name {
            return Err(Error::Data(format!(
                "{request}: the results of sweep '{name}' belong into a folder of that name, and {} holds '{found}'",
                archive.path.display()
            )));
        }
        Ok(archive)
    };
    sweeps.iter().map(read).collect()
}

/// The results of a sweep: beside a folder, or anywhere below the folder of all results.
fn folder_of(path: &Path, request: &str, name: &str) -> Result<PathBuf> {
    // A path would name results that no verification of these looks at.
    if Path::new(name).file_name().is_none_or(|plain| plain != name) {
        return Err(Error::Data(format!("{request}: sweep '{name}' is not the name of a folder of results")));
    }
    let absolute = std::path::absolute(path).map_err(|e| Error::unreadable(path, &e))?;
    let beside = absolute.parent().unwrap_or(&absolute).join(name);
    if beside.join(DEFINITION).exists() {
        return Ok(beside);
    }
    match &sweeps_named(path, name)?[..] {
        [] => Ok(beside),
        [one] => Ok(one.clone()),
        [one, other, ..] => Err(Error::Data(format!(
            "{request}: sweep '{name}' has results in {} and in {}",
            one.display(),
            other.display()
        ))),
    }
}
