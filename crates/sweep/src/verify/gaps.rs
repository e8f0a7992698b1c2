//! Whether `points.csv` lacks something that a finished sweep has: points that are not done, measurements that are empty.

use super::Verifier;
use super::files::Collected;
use super::findings::Findings;
use crate::base::Result;
use crate::metrics::{METRICS, Metric, Needs, Scope};
use crate::report::{Record, Status};

/// Demands that every place is done and that what pictures alone are needed for is measured, unless `provenance.toml` says
/// that it is missing.
pub fn check(_: &Verifier, sweep: &Collected, findings: &mut Findings) -> Result<()> {
    let archive = &sweep.archive;
    let records = &archive.outputs.records;
    let lacks = |record: &Record| {
        archive.provenance.missing.iter().any(|missing| missing.what.contains(&record.id) && missing.is_reason())
    };
    let done = records.iter().filter(|record| record.status == Status::Done).count();
    let mut wrong: Vec<String> = Vec::new();
    for record in records.iter().filter(|record| !lacks(record)) {
        if record.status != Status::Done {
            wrong.push(format!(
                "points.csv: {} is '{}', and no [[missing]] of provenance.toml names {}",
                record.point_label(),
                record.status.name(),
                record.id
            ));
            continue;
        }
        for metric in METRICS.iter().filter(|metric| is_always_measured(metric)) {
            let key = metric.key;
            let is_like = |other: &&Record| like(record, other, metric) && other.metric(key).is_some();
            if record.metric(key).is_none() && (names(record, metric) || records.iter().any(|other| is_like(&other))) {
                wrong.push(format!("points.csv: {key} of {} is empty, which others have", record.point_label()));
            }
        }
    }
    for missing in archive.provenance.missing.iter().filter(|missing| missing.why.trim().is_empty()) {
        wrong.push(format!("provenance.toml: the [[missing]] of '{}' has no why", missing.what));
    }
    let places = if done == records.len() { format!("{done}") } else { format!("{done} of {}", records.len()) };
    if !wrong.is_empty() && done < records.len() {
        wrong.insert(0, format!("{places} places are done"));
    }
    findings.of(format!("{places} places are done and measured"), wrong);
    Ok(())
}

/// Every point has it that was measured at all: surfaces and depth may be missing where a field shows none.
fn is_always_measured(metric: &Metric) -> bool {
    matches!(metric.needs, Needs::Nothing | Needs::Lpips(_)) || metric.scope == Scope::Lattice
}

/// Two points that are measured alike: one scene, one revision of the program; on a lattice one method.
fn like(a: &Record, b: &Record, metric: &Metric) -> bool {
    let same = |name: &str| a.protocol(name) == b.protocol(name);
    a.scene == b.scene && same("code_revision") && (metric.scope != Scope::Lattice || same("method"))
}

/// The point says that it was measured with the metric's weights.
fn names(record: &Record, metric: &Metric) -> bool {
    match metric.needs {
        Needs::Lpips(backbone) => {
            let named = |one: &str| one.split_once(' ').is_some_and(|(name, _)| name == backbone.name());
            metric.scope == Scope::View && record.protocol("lpips_weights").split(", ").any(named)
        }
        _ => false,
    }
}
