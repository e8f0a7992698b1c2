//! Whether committed results come out of what they are said to be made of: `augnerf verify`.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicUsize;

use rayon::prelude::*;

use crate::base::{Error, Result};
use crate::runtime::Runtime;
use crate::training::Trainings;

mod archive;
mod comparisons;
mod files;
mod findings;
mod retrain;
mod tree;

pub use archive::Archive;
pub use findings::{Finding, Findings, Outcome};

use tree::{Kind, leaves_below};

/// How thoroughly results are verified.
pub struct Verifier<'a> {
    /// Folder that scenes lie in.
    pub data_root: Option<&'a Path>,
    /// What points are trained by.
    pub trainings: &'a Trainings<'a>,
    /// Where points are trained again.
    pub runtime: &'a Runtime,
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

impl Verifier<'_> {
    /// Verifies a folder of results, or all of a group of such, and hands over what was found in each.
    ///
    /// # Errors
    /// No results at all; what cannot be read.
    pub fn verify(&self, path: &Path, show: &mut dyn FnMut(&Path, &Findings) -> Result<()>) -> Result<()> {
        let leaves = leaves_below(path)?;
        if leaves.iter().any(|(folder, kind)| folder == path && matches!(kind, Kind::Other | Kind::Pages)) {
            return Err(Error::Data(format!("{} holds no results: {NOTHING}", path.display())));
        }
        // A training has all threads, and nothing reads a folder while another is written anew.
        let at_once = if self.retrain > 0 || self.update { 1 } else { AT_ONCE };
        let leaf = |(folder, kind): &(PathBuf, Kind)| self.leaf(folder, *kind);
        for leaves in leaves.chunks(at_once) {
            let found: Vec<Result<Findings>> = match at_once {
                1 => leaves.iter().map(leaf).collect(),
                _ => self.runtime.install(|| leaves.par_iter().map(leaf).collect()),
            };
            leaves.iter().zip(found).try_for_each(|((folder, _), found)| show(folder, &found?))?;
        }
        Ok(())
    }

    fn leaf(&self, path: &Path, kind: Kind) -> Result<Findings> {
        let mut findings = Findings::default();
        let checked = match kind {
            Kind::Sweep => self.sweep(path, &mut findings),
            Kind::Comparison => comparisons::check(self, path, &mut findings),
            Kind::View => {
                findings.not_checked("a view of sweeps; what it shows stands in their own results");
                Ok(())
            }
            Kind::Runs => {
                findings.not_checked("single runs; their training alone makes them again");
                Ok(())
            }
            Kind::Pages => Ok(()),
            Kind::Other => {
                findings.wrong(format!("nothing in it can be checked: {NOTHING}"));
                Ok(())
            }
        };
        match checked {
            // Files that do not fit together are what is looked for.
            Err(error) if is_found(kind, &error) => findings.wrong(error),
            checked => checked?,
        }
        Ok(findings)
    }

    fn sweep(&self, path: &Path, findings: &mut Findings) -> Result<()> {
        let archive = Archive::read(path, self.data_root)?;
        files::check(self, &archive, findings)?;
        retrain::check(self, &archive, findings)
    }
}

const NOTHING: &str = "neither a sweep's (points.csv) nor a comparison (across.toml, over_scenes.toml)";

/// Returns whether an error is what a verification looks for.
fn is_found(kind: Kind, error: &Error) -> bool {
    let of_comparison = matches!(error, Error::Checkpoint(_) | Error::NotComparable(_)) || error.is_of_settings();
    matches!(error, Error::Data(_)) || kind == Kind::Comparison && of_comparison
}
