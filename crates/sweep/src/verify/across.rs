//! Comparisons across sweeps and over scenes, made again from the results of these sweeps.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::Verifier;
use super::archive::Archive;
use super::files::{Compared, is_spare, not_kept};
use super::findings::Findings;
use super::tree::sweeps_named;
use crate::across::{ACROSS, AcrossRequest};
use crate::base::{Error, Result};
use crate::folder::DEFINITION;
use crate::over_scenes::{OVER_SCENES, ScenesRequest};
use crate::report::exporters::Content;
use crate::view::{Origin, Source};

/// What a folder asks of sweeps, made from their results.
pub struct Comparison {
    /// The folder.
    pub path: PathBuf,
    /// The file of the request, and the number of sweeps that it names.
    request: (&'static str, usize),
    files: Vec<(String, Content)>,
}

impl Comparison {
    /// Reads what is asked, and the results of its sweeps.
    pub fn read(path: &Path, data_root: Option<&Path>) -> Result<Comparison> {
        if path.join(OVER_SCENES).exists() {
            let kept = ScenesRequest::read(path)?;
            let archives = archives(path, (OVER_SCENES, &kept.sweep), data_root)?;
            let (request, over) = kept.answer(&archives.iter().map(source_of).collect::<Vec<Source>>())?;
            let files = request.files(&over)?;
            return Ok(Comparison { path: path.into(), request: (OVER_SCENES, request.sweep.len()), files });
        }
        let kept = AcrossRequest::read(path)?;
        let archives = archives(path, (ACROSS, &kept.sweep), data_root)?;
        let sources: Vec<Source> = archives.iter().map(source_of).collect();
        let (request, across) = AcrossRequest::new(&kept.row, &kept.baseline, &kept.metric, &sources, &kept.labels())?;
        let files = request.files(&across)?;
        Ok(Comparison { path: path.into(), request: (ACROSS, request.sweep.len()), files })
    }
}

/// Compares a folder's files with what the sweeps make, or, with `update`, writes what differs.
pub fn check(verifier: &Verifier, path: &Path, findings: &mut Findings) -> Result<()> {
    let Comparison { path, request: (request, sweeps), files } = &Comparison::read(path, verifier.data_root)?;
    let made: BTreeMap<String, Content> = files.iter().cloned().collect();
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

fn source_of(archive: &Archive) -> Source<'_> {
    Source {
        name: archive.provenance.name.clone(),
        folder: None,
        definition: &archive.definition,
        points: &archive.points,
        outputs: archive.outputs.clone(),
    }
}
