//! What `augnerf verify` checks: one list, which runs the checks, names them in reports and describes them in help and docs.

use std::path::Path;

use super::across::{self, Comparison};
use super::files::Collected;
use super::findings::Findings;
use super::{Verifier, columns, derived, files, gaps, ids, inputs, retrain, runs, source};
use crate::base::Result;

/// One check.
pub struct Check {
    /// The word for it in reports.
    pub name: &'static str,
    /// What must hold.
    pub what: &'static str,
    /// What it leaves out, and reports as not checked if it meets it.
    pub left_out: &'static str,
    pub(super) run: Run,
}

type OfSweep = fn(&Verifier, &Collected, &mut Findings) -> Result<()>;

/// What a check is made of.
pub(super) enum Run {
    Sweep(OfSweep),
    Across(fn(&Verifier, &Comparison, &mut Findings) -> Result<()>),
    Runs(fn(&Path, &mut Findings) -> Result<()>),
    /// Of every folder.
    Quotes,
    /// Of a group of folders, after these.
    Pages,
}

/// The check of what belongs to no one folder.
pub(super) const PAGES: &str = "pages";
/// The check of files that people made.
pub(super) const SUMS: &str = "sums";

/// All checks, in the order in which they run.
pub const CHECKS: [Check; 13] = [
    Check {
        name: "files",
        what: "tables and figures are byte for byte what points.csv, timing.csv and scalars.csv.gz make; so is a report.html without \
               images of runs; files that provenance.toml lists under [pinned] (such as a report.html with them), [inputs] or \
               [archived] have their SHA-256",
        left_out: "figures and a report.html that are not there, and files under [archived] that are not there",
        run: Run::Sweep(files::check),
    },
    Check {
        name: "points",
        what: "points are named by the hashes of their configurations, and are those that sweep.toml asks for",
        left_out: "steps from a budget in seconds whose step times are not kept",
        run: Run::Sweep(ids::check),
    },
    Check {
        name: "source",
        what: "the sweep file below sweeps/ that has the folder's name is its sweep.toml, with the changes of the command line",
        left_out: "differences that a [[missing]] of provenance.toml names",
        run: Run::Sweep(source::check),
    },
    Check {
        name: "columns",
        what: "columns of points.csv are what configurations, provenance.toml and logs say",
        left_out: "columns that need a scene's files, and inactive_levels of points without logs",
        run: Run::Sweep(columns::check),
    },
    Check {
        name: "derived",
        what: "gaps, averages and PSNR of points.csv are what their parts make, and rays per second of timing.csv what its \
               seconds make",
        left_out: "SSIM, LPIPS and depth, which need the images",
        run: Run::Sweep(derived::check),
    },
    Check {
        name: "gaps",
        what: "every line of points.csv is done, and has the metrics of images and density that comparable lines have",
        left_out: "points that [[missing]] of provenance.toml names",
        run: Run::Sweep(gaps::check),
    },
    Check {
        name: "inputs",
        what: "scenes and LPIPS weights have the hashes in points.csv",
        left_out: "those that are not on this machine (--data-root, --lpips-weights)",
        run: Run::Sweep(inputs::check),
    },
    Check {
        name: "retrain",
        what: "with --retrain N, N points that are trained again have every metric and column to the last digit",
        left_out: "metrics whose LPIPS weights are not on this machine",
        run: Run::Sweep(retrain::check),
    },
    Check {
        name: "across",
        what: "comparisons across sweeps and over scenes are what the points of these sweeps make",
        left_out: "figures that are not there",
        run: Run::Across(across::check),
    },
    Check {
        name: "runs",
        what: "single runs: means are those of the views, metrics.csv, summary.csv and config.toml agree with \
               metrics.json",
        left_out: "their weights and configurations",
        run: Run::Runs(runs::check),
    },
    Check {
        name: "quotes",
        what: "numbers and verdicts that quotes.toml traces stand on their page once, and are those of their cells",
        left_out: "numbers and verdicts that it does not trace",
        run: Run::Quotes,
    },
    Check {
        name: PAGES,
        what: "every folder below can be checked, quotes name one folder each, and each page has the untraced numbers with \
               decimals and verdicts that [untraced] of quotes.toml lists",
        left_out: "what the untraced numbers say",
        run: Run::Pages,
    },
    Check {
        name: SUMS,
        what: "files that SHA256SUMS of the folder of all results lists, such as plans and photographs, have their SHA-256",
        left_out: "images and `PLAN.md` beside pages that it does not list",
        run: Run::Pages,
    },
];
