//! Comparisons across sweeps, made again from the results of these sweeps.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::Verifier;
use super::archive::Archive;
use super::files::{Compared, is_figure, not_kept};
use super::findings::Findings;
use super::tree::{Tree, root_of};
use crate::across::{ACROSS, AcrossRequest};
use crate::base::{Error, Result};
use crate::folder::DEFINITION;
use crate::report::Across;
use crate::view::Source;

/// What a folder asks of sweeps, made from their results.
pub struct Comparison {
    /// The folder.
    pub path: PathBuf,
    /// What its sweeps make.
    pub across: Across,
    request: AcrossRequest,
}

impl Comparison {
    /// Reads what is request, and the results of its sweeps.
    pub fn read(path: &Path, data_root: Option<&Path>) -> Result<Comparison> {
        let kept = AcrossRequest::read(path)?;
        let folders = kept.sweep.iter().map(|sweep| folder_of(path, &sweep.name)).collect::<Result<Vec<_>>>()?;
        let read = |folder: &PathBuf| Archive::read(folder, data_root);
        let archives = folders.iter().map(read).collect::<Result<Vec<_>>>()?;
        for (archive, sweep) in archives.iter().zip(&kept.sweep) {
            let (found, name) = (&archive.provenance.name, &sweep.name);
            if found != name {
                return Err(Error::Data(format!(
                    "{ACROSS}: the results of sweep '{name}' belong into a folder of that name, and {} holds '{found}'",
                    archive.path.display()
                )));
            }
        }
        let sources: Vec<Source> = archives.iter().map(source_of).collect();
        let (request, across) = AcrossRequest::new(&kept.row, &kept.baseline, &kept.metric, &sources, &kept.labels())?;
        Ok(Comparison { path: path.to_path_buf(), across, request })
    }
}

/// Compares a folder's files with what the sweeps make, or, with `update`, writes what differs.
pub fn check(verifier: &Verifier, comparison: &Comparison, findings: &mut Findings) -> Result<()> {
    let Comparison { path, across, request } = comparison;
    let made: BTreeMap<String, Vec<u8>> = request.files(across)?.into_iter().collect();
    let compared = Compared::new(verifier, path, made.iter(), is_figure, findings)?;
    compared.report(
        &format!("from comparisons of {} sweeps, of which {ACROSS} has the hashes", request.sweep.len()),
        findings,
    );
    not_kept(&compared.absent, None, path, findings);
    Ok(())
}

/// The results of a sweep: beside a folder, or anywhere below the folder of all results.
fn folder_of(path: &Path, name: &str) -> Result<PathBuf> {
    // A path would name results that no verification of these looks at.
    if Path::new(name).file_name().is_none_or(|plain| plain != name) {
        return Err(Error::Data(format!("{ACROSS}: sweep '{name}' is not the name of a folder of results")));
    }
    let absolute = std::path::absolute(path).map_err(|e| Error::unreadable(path, &e))?;
    let above = absolute.parent().unwrap_or(&absolute);
    let beside = above.join(name);
    let root = root_of(above)?.filter(|_| !beside.join(DEFINITION).exists());
    let Some(tree) = root.map(|root| Tree::below(&root)).transpose()? else { return Ok(beside) };
    match tree.named(name)[..] {
        [] => Ok(beside),
        [one] => Ok(one.to_path_buf()),
        [one, other, ..] => Err(Error::Data(format!(
            "{ACROSS}: sweep '{name}' has results in {} and in {}",
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
