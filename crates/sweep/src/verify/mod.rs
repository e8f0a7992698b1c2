//! Whether committed results come out of what they are said to be made of: `augnerf verify`.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicUsize;

use rayon::prelude::*;

use crate::base::{Error, Result};
use crate::runtime::Runtime;
use crate::training::Trainings;

mod across;
mod archive;
mod checks;
mod columns;
mod derived;
mod files;
mod findings;
mod gaps;
mod ids;
mod inputs;
mod numbers;
mod quotes;
mod retrain;
mod runs;
mod source;
mod sums;
mod tree;

pub use archive::Archive;
pub use checks::{CHECKS, Check};
pub use findings::{Finding, Findings, Outcome};
pub use inputs::SceneHashes;

use checks::Run;
use files::Collected;
use numbers::Cells;
use quotes::Quotes;
use tree::{Kind, Tree, root_of};

/// How thoroughly results are verified.
pub struct Verifier<'a> {
    /// Folder that scenes lie in.
    pub data_root: Option<&'a Path>,
    /// What scenes are loaded with and points trained by; LPIPS weights, where they are at hand.
    pub trainings: &'a Trainings<'a>,
    /// Where points are trained again.
    pub runtime: &'a Runtime,
    /// Hashes of scenes that were read; `None` where none is to be read.
    pub scenes: Option<SceneHashes>,
    /// Write tables and figures that differ anew.
    pub update: bool,
    /// Write with them those that are not kept.
    pub all: bool,
    /// So many points are trained again.
    pub retrain: usize,
    /// Draws these points.
    pub retrain_seed: u64,
    /// By any revision of the program, not only by that of the points.
    pub any_revision: bool,
    /// Holds a signal's number when it is time to stop.
    pub stop: &'a AtomicUsize,
}

/// So many folders are checked side by side before what was found in them is shown.
const AT_ONCE: usize = 16;

/// What a folder's checks look at.
#[expect(clippy::large_enum_variant, reason = "one at a time")]
enum Subject {
    Sweep(Collected),
    Across(across::Comparison),
    Runs(PathBuf),
}

impl Verifier<'_> {
    /// Verifies a folder of results, or all of a group of such, and hands over what was found in each.
    ///
    /// # Errors
    /// No results at all; what cannot be read.
    pub fn verify(&self, path: &Path, show: &mut dyn FnMut(&Path, &Findings) -> Result<()>) -> Result<()> {
        let tree = Tree::below(path)?;
        if let [(folder, kind)] = &tree.leaves[..]
            && folder == path
        {
            let kind = if *kind == Kind::Pages { Kind::Other } else { *kind };
            return show(path, &self.leaf(path, kind)?);
        }
        let mut findings = Findings::default();
        findings.begin(checks::PAGES);
        let leaf = |(folder, kind): &(PathBuf, Kind)| (*kind != Kind::Other).then(|| self.leaf(folder, *kind));
        // A training has all threads, and nothing reads a folder while another is written anew.
        let at_once = if self.retrain > 0 || self.update { 1 } else { AT_ONCE };
        for leaves in tree.leaves.chunks(at_once) {
            let found: Vec<Option<Result<Findings>>> = match at_once {
                1 => leaves.iter().map(leaf).collect(),
                _ => self.runtime.install(|| leaves.par_iter().map(leaf).collect()),
            };
            for ((folder, _), found) in leaves.iter().zip(found) {
                match found {
                    Some(found) => show(folder, &found?)?,
                    None => findings.wrong(format!("{}: {NOTHING}: nothing in it can be checked", folder.display())),
                }
            }
        }
        let root = root_of(path)?.map_or_else(|| std::path::absolute(path), Ok);
        let root = root.map_err(|e| Error::unreadable(path, &e))?;
        let all = Tree::below(&root)?;
        Quotes::read(&root)?.check_pages(&root, &tree, &all, &mut findings);
        findings.begin(checks::SUMS);
        sums::check(&root, &tree, &all, &mut findings)?;
        show(path, &findings)
    }

    /// Verifies a sweep's results, a comparison, or a folder of single runs.
    pub fn folder(&self, path: &Path) -> Result<Findings> {
        match Tree::below(path)?.leaves.as_slice() {
            [(folder, kind)] if folder == path => self.leaf(path, *kind),
            _ => Err(Error::Data(format!("{} holds no results of its own", path.display()))),
        }
    }

    fn leaf(&self, path: &Path, kind: Kind) -> Result<Findings> {
        let mut findings = Findings::default();
        let subject = match kind {
            Kind::Sweep => Collected::read(path, self.data_root).map(Subject::Sweep),
            Kind::Across => across::Comparison::read(path, self.data_root).map(Subject::Across),
            Kind::Runs => Ok(Subject::Runs(path.to_path_buf())),
            Kind::View => {
                let why = "a view of sweeps; what it shows stands in their own results";
                findings.not_checked(format!("{}: {why}", path.display()));
                return Ok(findings);
            }
            Kind::Pages => {
                findings
                    .not_checked("pages: the numbers that they quote are checked with the folders that these are of");
                return Ok(findings);
            }
            Kind::Other => return Err(Error::Data(format!("{} holds no results: {NOTHING}", path.display()))),
        };
        match subject {
            Ok(subject) => self.check(&subject, &mut findings)?,
            // Files that do not fit together are what is looked for.
            Err(error) if is_found(kind, &error) => findings.wrong(error),
            Err(error) => return Err(error),
        }
        Ok(findings)
    }

    fn check(&self, subject: &Subject, findings: &mut Findings) -> Result<()> {
        for check in &CHECKS {
            findings.begin(check.name);
            match (&check.run, subject) {
                (Run::Sweep(run), Subject::Sweep(sweep)) => run(self, sweep, findings)?,
                (Run::Across(run), Subject::Across(comparison)) => run(self, comparison, findings)?,
                (Run::Runs(run), Subject::Runs(path)) => run(path, findings)?,
                (Run::Quotes, subject) => quoted(subject, findings)?,
                _ => {}
            }
        }
        Ok(())
    }
}

const NOTHING: &str = "neither a sweep's (points.csv) nor single runs (RUN/metrics.json)";

/// Whether an error is what a verification looks for.
fn is_found(kind: Kind, error: &Error) -> bool {
    let of_across = matches!(error, Error::Checkpoint(_) | Error::NotComparable(_)) || error.is_of_settings();
    matches!(error, Error::Data(_)) || kind == Kind::Across && of_across
}

/// Numbers that pages quote from a folder.
fn quoted(subject: &Subject, findings: &mut Findings) -> Result<()> {
    let (path, cells) = match subject {
        Subject::Sweep(sweep) => (&sweep.archive.path, Cells::of_sweep(sweep)),
        Subject::Across(comparison) => (&comparison.path, Cells::of_comparison(comparison)),
        Subject::Runs(path) => (path, Cells::of_runs(path)),
    };
    let cells = match cells {
        // A table that was damaged.
        Err(error @ Error::Data(_)) => {
            findings.wrong(error);
            return Ok(());
        }
        cells => cells?,
    };
    let absolute = std::path::absolute(path).map_err(|e| Error::unreadable(path, &e))?;
    let above = absolute.parent().unwrap_or(&absolute);
    let root = root_of(above)?.unwrap_or_else(|| above.to_path_buf());
    Quotes::read(&root)?.check(&root, &cells, findings);
    Ok(())
}
