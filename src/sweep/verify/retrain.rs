//! Points trained again, and their numbers compared to the last digit.

use std::path::PathBuf;
use std::sync::atomic::AtomicUsize;

use super::archive::Archive;
use super::findings::Findings;
use crate::base::csv::csv_number;
use crate::base::{Error, Result, revision};
use crate::report::Record;
use crate::runtime::Runtime;
use crate::sweep::folder::SweepFolder;
use crate::sweep::points::Point;
use crate::sweep::runner::{Options, Runner};
use crate::sweep::training::Trainings;

/// Columns that say which program or machine it was: they may differ.
const OF_THE_PROGRAM: [&str; 3] = ["program", "code_revision", "device"];

/// Trains `count` points again, spread over the sweep, and compares metrics and protocol as `points.csv` has them.
///
/// # Errors
/// This program is another revision than the points', unless `any_revision`.
pub fn check(
    archive: &Archive,
    (count, any_revision): (usize, bool),
    runtime: &Runtime,
    trainings: &Trainings,
    stop: &AtomicUsize,
    findings: &mut Findings,
) -> Result<()> {
    let pinned = &archive.provenance.code_revision;
    if revision() != pinned && !any_revision {
        return Err(Error::Config(format!(
            "--retrain: {} was made by revision {pinned}, this program is {}; `git worktree add ../augnerf-{pinned} \
             {pinned}` checks that out, and there `cargo run --release -- sweep run {}/sweep.toml` trains it; \
             --any-revision asks whether this program gives the same numbers",
            archive.path.display(),
            revision(),
            archive.path.display()
        )));
    }
    let at_hand: Vec<&Point> = archive.done().filter(|point| point.no_data.is_none()).collect();
    let count = count.min(at_hand.len());
    if count == 0 {
        findings.not_checked("training again: no scene of the points is at hand");
        return Ok(());
    }
    let points: Vec<Point> = (0..count).map(|index| at_hand[index * at_hand.len() / count].clone()).collect();
    let scratch = Scratch::new()?;
    let folder = SweepFolder::new(&scratch.0);
    let options = Options { jobs: 1, fail_fast: false, retry_failed: false, most_deaths: 1, remeasure: Vec::new() };
    let (events, work) = (trainings.events, trainings);
    Runner { folder: &folder, points: &points, runtime, work, options, events, stop }.run()?;
    for point in &points {
        let records = archive.material.records.iter().find(|record| record.id == point.id);
        let record = records.expect("a point that is done has a record");
        if let Some(failure) = folder.point(&point.id).failure()? {
            findings.wrong(format!("{}: {}", point.label(), failure.reason));
            continue;
        }
        let result = folder.point(&point.id).result()?.expect("it has not failed");
        let wrong = differences(record, &result.metrics, &result.protocol);
        findings.of(format!("{}: trained again, every number to the last digit", point.label()), wrong);
    }
    Ok(())
}

/// What is another number than in the record. What only one of them has was not measured there.
fn differences(record: &Record, metrics: &[(String, Option<f64>)], protocol: &[(String, String)]) -> Vec<String> {
    let mut wrong = Vec::new();
    for (name, value) in metrics {
        let (then, now) = (csv_number(record.metric(name)), csv_number(*value));
        if !then.is_empty() && !now.is_empty() && then != now {
            wrong.push(format!("{}: {name} is {now}, points.csv has {then}", record.point_label()));
        }
    }
    for (name, now) in protocol.iter().filter(|(name, _)| !OF_THE_PROGRAM.contains(&name.as_str())) {
        let then = record.protocol(name);
        if !then.is_empty() && then != now {
            wrong.push(format!("{}: {name} is '{now}', points.csv has '{then}'", record.point_label()));
        }
    }
    wrong
}

/// A folder that is deleted at the end.
struct Scratch(PathBuf);

impl Scratch {
    fn new() -> Result<Scratch> {
        let path = std::env::temp_dir().join(format!("augnerf-verify-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).map_err(|e| Error::unwritable(&path, &e))?;
        Ok(Scratch(path))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // Trainings of a process that is killed stay behind; what stays otherwise is only space.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
