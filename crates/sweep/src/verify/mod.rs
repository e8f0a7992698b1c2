//! Whether committed results come out of what they are said to be made of: `augnerf verify`.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicUsize;

use crate::across::{ACROSS, ACROSS_PAGE};
use crate::base::{Error, Result};
use crate::report::exporters::EXPORTERS;
use crate::runtime::Runtime;
use crate::training::Trainings;
use crate::view::VIEW;

mod across;
mod archive;
mod columns;
mod files;
mod findings;
mod gaps;
mod ids;
mod inputs;
mod numbers;
mod pages;
mod retrain;
mod runs;

pub use archive::Archive;
pub use findings::{Finding, Findings, Outcome};

use files::Made;
use numbers::Cells;
use pages::Page;

/// How thoroughly results are verified.
pub struct Verifier<'a> {
    /// Folder that scenes lie in.
    pub data_root: Option<&'a Path>,
    /// What scenes are loaded with and points trained by; LPIPS weights, where they are at hand.
    pub trainings: &'a Trainings<'a>,
    /// Where points are trained again.
    pub runtime: &'a Runtime,
    /// Write tables and figures that differ anew.
    pub update: bool,
    /// So many points are trained again.
    pub retrain: usize,
    /// By any revision of the program, not only by that of the points.
    pub any_revision: bool,
    /// Holds a signal's number when it is time to stop.
    pub stop: &'a AtomicUsize,
}

impl Verifier<'_> {
    /// Verifies a sweep's results, or a folder of single runs.
    pub fn folder(&self, path: &Path) -> Result<Findings> {
        let mut findings = Findings::default();
        if path.join(VIEW).exists() {
            findings.not_checked(format!(
                "{}: a view of sweeps; what it shows stands in their own results",
                path.display()
            ));
            return Ok(findings);
        }
        let cells = match kind(path)? {
            Kind::Sweep => match Archive::read(path, self.data_root) {
                Ok(archive) => Cells::of_sweep(path, &self.sweep(&archive, &mut findings)?)?,
                // Files that do not fit together are what is looked for.
                Err(Error::Data(message)) => {
                    findings.wrong(message);
                    return Ok(findings);
                }
                Err(error) => return Err(error),
            },
            Kind::Runs => {
                runs::check(path, &mut findings)?;
                Cells::of_runs(path)?
            }
            Kind::Pages => {
                findings
                    .not_checked("pages: the numbers that they quote are checked with the folders that these are of");
                return Ok(findings);
            }
            Kind::Across => match across::check(path, self.data_root, self.update, &mut findings) {
                Ok(cells) => cells,
                // What is missing beside it, or does not fit any more, is what is looked for.
                Err(error @ (Error::Data(_) | Error::Checkpoint(_) | Error::NotComparable(_))) => {
                    findings.wrong(error);
                    return Ok(findings);
                }
                Err(error) if error.is_of_settings() => {
                    findings.wrong(error);
                    return Ok(findings);
                }
                Err(error) => return Err(error),
            },
            Kind::Other => {
                return Err(Error::Data(format!(
                    "{} holds no results: neither a sweep's (points.csv) nor single runs (RUN/metrics.json)",
                    path.display()
                )));
            }
        };
        quoted(path, &cells, &mut findings)?;
        Ok(findings)
    }

    fn sweep(&self, archive: &Archive, findings: &mut Findings) -> Result<Made> {
        let made = files::check(archive, self.update, findings)?;
        ids::check(archive, self.data_root, findings)?;
        columns::check(archive, findings)?;
        gaps::check(archive, findings);
        inputs::check(archive, &self.trainings.lpips, self.trainings.events, findings)?;
        if self.retrain > 0 {
            let how = (self.retrain, self.any_revision);
            retrain::check(archive, how, self.runtime, self.trainings, self.stop, findings)?;
        }
        Ok(made)
    }
}

/// What a folder holds.
enum Kind {
    Sweep,
    Runs,
    /// One comparison of each of several sweeps.
    Across,
    /// Text on results in other folders.
    Pages,
    Other,
}

fn kind(path: &Path) -> Result<Kind> {
    if path.join("points.csv").exists() || path.join("sweep.toml").exists() {
        return Ok(Kind::Sweep);
    }
    if !runs::run_folders(path)?.is_empty() {
        return Ok(Kind::Runs);
    }
    if !folders_in(path)?.is_empty() {
        return Ok(Kind::Other);
    }
    Ok(match path.join(ACROSS).exists() {
        true => Kind::Across,
        false if holds_pages_alone(path)? => Kind::Pages,
        false => Kind::Other,
    })
}

/// Whether people wrote all that a folder holds: a page at least, and nothing that the program leaves in results.
fn holds_pages_alone(path: &Path) -> Result<bool> {
    let names = files_in(path)?;
    let is_made = |name: &String| files::is_kept(name) || EXPORTERS.iter().any(|exporter| exporter.owns(name));
    Ok(names.iter().any(|name| name.ends_with(".md")) && !names.iter().any(is_made))
}

/// The results' folders that are meant by a path: itself, or those that lie in it.
pub fn results_in(path: &Path) -> Result<Vec<PathBuf>> {
    if !matches!(kind(path)?, Kind::Other | Kind::Pages) {
        return Ok(vec![path.to_path_buf()]);
    }
    let mut folders = folders_in(path)?;
    folders.retain(|folder| !matches!(kind(folder), Ok(Kind::Other)));
    if folders.is_empty() {
        return Err(Error::Data(format!(
            "{} holds no results: neither a sweep's (points.csv) nor single runs (RUN/metrics.json)",
            path.display()
        )));
    }
    Ok(folders)
}

/// Numbers that pages quote from a results' folder.
fn quoted(path: &Path, cells: &Cells, findings: &mut Findings) -> Result<()> {
    for page in pages_beside(path)? {
        let (mut count, mut wrong) = (0, Vec::new());
        for quote in page.quotes.iter().filter(|quote| quote.folder == cells.name) {
            let (numbers, reasons) = quote.check(cells);
            count += numbers;
            wrong.extend(reasons.into_iter().map(|reason| format!("{}, line {}: {reason}", page.name, quote.line)));
        }
        if count > 0 || !wrong.is_empty() {
            findings.of(format!("{}: {count} quoted numbers", page.name), wrong);
        }
    }
    Ok(())
}

/// What belongs to no folder of results: folders that hold something else, comments on pages beside them that name no
/// folder, and numbers there that no comment traces.
pub fn untraced(results: &Path) -> Result<Findings> {
    let mut findings = Findings::default();
    let mut names = Vec::new();
    for folder in folders_in(results)? {
        let name = folder.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        match kind(&folder)? {
            Kind::Other => findings.wrong(format!(
                "{name}: neither a sweep's results (points.csv) nor single runs (RUN/metrics.json): nothing in it can be \
                 checked"
            )),
            Kind::Sweep | Kind::Runs | Kind::Across => names.push(name),
            Kind::Pages => {}
        }
    }
    for page in pages_beside(&results.join("any"))? {
        for quote in page.quotes.iter().filter(|quote| !names.contains(&quote.folder)) {
            findings
                .wrong(format!("{}, line {}: there is no results folder '{}'", page.name, quote.line, quote.folder));
        }
        if page.unmarked > 0 {
            findings
                .not_checked(format!("{}: {} numbers with decimals that no comment traces", page.name, page.unmarked));
        }
    }
    Ok(findings)
}

/// The folders in a folder, by name.
fn folders_in(path: &Path) -> Result<Vec<PathBuf>> {
    let mut folders = Vec::new();
    for entry in std::fs::read_dir(path).map_err(|e| Error::unreadable(path, &e))? {
        let entry = entry.map_err(|e| Error::unreadable(path, &e))?.path();
        if entry.is_dir() {
            folders.push(entry);
        }
    }
    folders.sort();
    Ok(folders)
}

/// The pages on results: those in the folder above, those in folders of pages there, and the README above that.
fn pages_beside(path: &Path) -> Result<Vec<Page>> {
    let absolute = std::path::absolute(path).map_err(|e| Error::unreadable(path, &e))?;
    let Some(results) = absolute.parent() else { return Ok(Vec::new()) };
    let mut paths = pages_in(results)?;
    for folder in folders_in(results)? {
        if matches!(kind(&folder), Ok(Kind::Pages | Kind::Across)) {
            paths.extend(pages_in(&folder)?);
        }
    }
    let root = results.parent().unwrap_or(results);
    paths.extend(Some(root.join("README.md")).filter(|path| root != results && path.exists()));
    paths.iter().map(|path| Page::read(path, root)).collect()
}

/// The pages in a folder that people wrote.
fn pages_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut names = files_in(folder)?;
    let made = folder.join(ACROSS).exists();
    names.retain(|name| name.ends_with(".md") && !(made && name == ACROSS_PAGE));
    Ok(names.into_iter().map(|name| folder.join(name)).collect())
}

/// Names in a folder, folders among them.
fn files_in(folder: &Path) -> Result<Vec<String>> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|e| Error::unreadable(folder, &e))? {
        let entry = entry.map_err(|e| Error::unreadable(folder, &e))?;
        names.push(entry.file_name().to_string_lossy().into_owned());
    }
    names.sort();
    Ok(names)
}
