//! Points trained again, and their numbers compared to the last digit.

use super::Verifier;
use super::archive::Archive;
use super::findings::Findings;
use crate::base::csv::csv_number;
use crate::base::rng::{Random, Stream};
use crate::base::{Error, Result};
use crate::claim::Sharing;
use crate::folder::SweepFolder;
use crate::metrics::{METRICS, Needs, Scope};
use crate::points::Point;
use crate::report::{PointResult, Record, distinct};
use crate::revision::revision;
use crate::runner::{Options, Runner};

/// Columns that say which program or machine it was: they may differ.
const OF_THE_PROGRAM: [&str; 3] = ["program", "code_revision", "device"];
/// Hashes of settings. Another revision may hash otherwise.
const HASHES: [&str; 2] = ["config_hash", "parent"];

/// Trains as many points again as are asked for, drawn at random, and compares metrics and protocol as `points.csv` has them.
///
/// # Errors
/// This program is another revision than the points', unless `any_revision`.
pub fn check(verifier: &Verifier, archive: &Archive, findings: &mut Findings) -> Result<()> {
    let Verifier { runtime, stop, any_revision, retrain_seed, .. } = verifier;
    if verifier.retrain == 0 {
        return Ok(());
    }
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
    let count = verifier.retrain.min(at_hand.len());
    if count == 0 {
        findings.not_checked("training again: no scene of the points is here");
        return Ok(());
    }
    let points: Vec<Point> = drawn(count, at_hand.len(), *retrain_seed).map(|index| at_hand[index].clone()).collect();
    let scratch = tempfile::tempdir().map_err(|e| Error::unwritable(&std::env::temp_dir(), &e))?;
    let (folder, mut open) = (SweepFolder::new(scratch.path()), Vec::new());
    let options =
        Options { jobs: 1, fail_fast: false, retry_failed: false, remeasure: Vec::new(), sharing: Sharing::Locks };
    let (events, work) = (verifier.trainings.events, verifier.trainings);
    Runner { folder: &folder, points: &points, runtime, work, options, events, stop }.run()?;
    for point in &points {
        let records = archive.sweep.outputs.records.iter().find(|record| record.id == point.id);
        let record = records.expect("a point that is done has a record");
        if let Some(failure) = folder.point(&point.id).failure()? {
            findings.wrong(format!("{}: {}", point.label(), failure.reason));
            continue;
        }
        let result = folder.point(&point.id).result()?.expect("it has not failed");
        let wrong = differences(archive, record, &result, &mut open);
        findings.of(format!("{}: trained again, every number to the last digit", point.label()), wrong);
    }
    for metric in distinct(open.into_iter()) {
        findings.not_checked(format!("{metric} of points trained again: it is not measured here"));
    }
    Ok(())
}

/// Returns `count` of 0..`all` in order, drawn at random: at even distances they could all be of one row.
fn drawn(count: usize, all: usize, seed: u64) -> impl Iterator<Item = usize> {
    let mut drawn = Random::new(seed, Stream::Retrain, 0).distinct(count, all as u32);
    drawn.sort_unstable();
    drawn.into_iter().map(|index| index as usize)
}

/// What is another number than in the record, or is there in one of them alone. Names of metrics that could not be
/// compared are left in `open`.
fn differences(archive: &Archive, record: &Record, result: &PointResult, open: &mut Vec<&'static str>) -> Vec<String> {
    let records = &archive.sweep.outputs.records;
    let mut wrong = Vec::new();
    for metric in METRICS.iter().filter(|metric| metric.scope != Scope::Common) {
        let key = metric.key;
        // Metrics that are younger than the points are not in their file.
        let Some((_, then)) = record.result.metrics.iter().find(|(name, _)| name == key) else { continue };
        let (then, now) = (csv_number(*then), csv_number(result.metric(key)));
        let weights_differ = matches!(metric.needs, Needs::Lpips(_))
            && (now.is_empty() || !records.iter().any(|record| record.metric(key).is_some()));
        match now {
            now if now == then => {}
            _ if weights_differ => open.push(key),
            now => wrong.push(format!("{}: {key} is '{now}', points.csv has '{then}'", record.point_label())),
        }
    }
    let is_own = revision() == archive.provenance.code_revision;
    let may_differ = |name: &str| OF_THE_PROGRAM.contains(&name) || !is_own && HASHES.contains(&name);
    for (name, now) in result.protocol.iter().filter(|(name, _)| !may_differ(name)) {
        // Columns that are younger than the points are not in their file.
        let then = record.result.protocol.iter().find(|(known, _)| known == name).map(|(_, then)| then);
        if then.is_some_and(|then| then != now && !(name == "lpips_weights" && (then.is_empty() || now.is_empty()))) {
            let then = record.protocol(name);
            wrong.push(format!("{}: {name} is '{now}', points.csv has '{then}'", record.point_label()));
        }
    }
    if record.result.inactive_levels != result.inactive_levels {
        let (then, now) = (record.result.inactive_levels.join(" "), result.inactive_levels.join(" "));
        wrong.push(format!("{}: inactive_levels is '{now}', points.csv has '{then}'", record.point_label()));
    }
    wrong
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_drawn_of_all_rows() {
        let of = |count: usize| drawn(count, 720, 0).collect::<Vec<usize>>();
        assert_eq!(of(8), of(8));
        assert_ne!(of(8), drawn(8, 720, 1).collect::<Vec<usize>>());
        assert!(of(8).is_sorted() && of(8).last().unwrap() < &720 && distinct(of(8).into_iter()).len() == 8);
        // Rows of 15 repeat every 30 points.
        assert!(distinct(of(8).into_iter().map(|index| index % 30)).len() > 4, "{:?}", of(8));
        assert_eq!(drawn(5, 5, 0).collect::<Vec<usize>>(), [0, 1, 2, 3, 4]);
    }
}
