//! `augnerf sweep status`.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use serde_json::json;

use crate::base::Result;
use crate::cli::answer::Answer;
use crate::cli::progress::print_shown;
use crate::metrics::PSNR;
use crate::report::{Record, Status, distinct};
use crate::sweep::{Claim, Pace, Point, Sweep, last_words};

use super::{check_done, duration, one_of_each, open};

pub const EXAMPLES: &str = "Examples:
  augnerf sweep status runs/smoke
  augnerf sweep status results/checks/smoke  # what a results folder says

`watch -n 10 augnerf sweep status runs/smoke` shows it every 10 s.
Exit codes: 0 all points are done, 7 points failed, 11 points are waiting or running, 8 scenes are missing.";

#[derive(Args)]
pub struct StatusArguments {
    /// Folder of a sweep: runs/NAME, that of --out, or results/NAME
    folder: PathBuf,
    /// Folder of the scenes
    #[arg(long, env = "AUGNERF_DATA", value_name = "DIR")]
    data_root: Option<PathBuf>,
    /// List each point of a large sweep, not only those that run or failed
    #[arg(long)]
    all: bool,
    #[command(flatten)]
    answer: Answer,
}

/// The state of a point.
#[derive(Serialize)]
struct PointStatus {
    id: String,
    label: String,
    status: &'static str,
    reason: String,
    step: Option<u64>,
    steps: Option<u64>,
    seconds_left: Option<f64>,
    host: Option<String>,
    process: Option<u32>,
    psnr: Option<f64>,
}

impl PointStatus {
    /// Returns what the files of a sweep say of a point, with the worker that has it.
    fn of(record: &Record, sweep: &Sweep) -> PointStatus {
        let point = sweep.points.iter().find(|point| point.id == record.id);
        let is_open = [Status::Running, Status::Waiting].contains(&record.status);
        let runs = sweep.runs.as_ref().filter(|_| is_open);
        let claim = runs.and_then(|runs| Claim::look(runs.point(&record.id).path()));
        let fate = claim.as_ref().filter(|claim| !claim.alive).map(|claim| claim.fate());
        // Until training begins, a worker has no step.
        let training = claim.as_ref().filter(|claim| claim.steps > 0);
        PointStatus {
            id: record.id.clone(),
            label: record.point_label(),
            status: record.status.name(),
            reason: fate.unwrap_or_else(|| record.reason.clone()),
            step: training.map(|claim| claim.step),
            steps: training.map(|claim| claim.steps).or(point.map(|point| point.config.train.steps)),
            seconds_left: claim.as_ref().and_then(|claim| claim.seconds_left),
            process: claim.as_ref().map(|claim| claim.pid),
            host: claim.map(|claim| claim.host),
            psnr: record.metric(PSNR.key),
        }
    }

    fn is(&self, status: Status) -> bool {
        self.status == status.name()
    }

    /// Returns how far the point is, its PSNR, or why it has none.
    fn what(&self) -> String {
        match (&self.host, self.process) {
            (Some(host), Some(process)) if self.is(Status::Running) => {
                let left = self.seconds_left.map_or(String::new(), |left| format!(", {} left", duration(left)));
                let of_steps = |(step, steps)| format!("step {step} of {steps}");
                let step = self.step.zip(self.steps).map_or("starting".into(), of_steps);
                format!("{step}{left} ({host}, process {process})")
            }
            _ => self.psnr.map_or_else(|| shortened(&self.reason), |psnr| format!("PSNR {psnr:.2} dB")),
        }
    }
}

impl StatusArguments {
    pub fn run(self) -> Result<()> {
        let sweep = open(&self.folder, self.data_root.as_deref())?;
        let records = &sweep.outputs.records;
        let points: Vec<PointStatus> = one_of_each(records).map(|record| PointStatus::of(record, &sweep)).collect();
        let counts = Status::ALL.map(|status| (status, points.iter().filter(|point| point.is(status)).count()));
        let by_name: serde_json::Map<_, _> =
            counts.iter().map(|(status, count)| (status.name().into(), (*count).into())).collect();
        let folder = self.folder.display().to_string();
        self.answer.give(&json!({ "folder": folder, "counts": by_name, "points": points }), || {
            for point in points.iter().filter(|point| is_listed(point.status, points.len(), self.all)) {
                print_shown(&format!("{:8} {} {}  {}", point.status, point.id, point.label, point.what()))?;
            }
            unlisted(points.len(), self.all).into_iter().try_for_each(|line| print_shown(&line))?;
            by_row(records).iter().try_for_each(|line| print_shown(line))?;
            let is_left_alone = points.iter().all(|point| !point.is(Status::Running));
            let left_alone = sweep.runs.as_ref().filter(|_| is_left_alone);
            if let Some(runs) = left_alone.filter(|_| points.iter().any(|point| point.is(Status::Waiting))) {
                last_words(runs).into_iter().try_for_each(|line| print_shown(&line))?;
            }
            let counts = counts.iter().filter(|(_, count)| *count > 0);
            let counts: Vec<String> = counts.map(|(status, count)| format!("{count} {}", status.name())).collect();
            let results = if sweep.runs.is_none() { "results, " } else { "" };
            print_shown(&format!("{folder}: {results}{}{}", counts.join(", "), time_left(&sweep, &points)))
        })?;
        check_done(records)
    }
}

/// Returns an estimate of the time that is left while points run; running ones count with their remaining fraction.
fn time_left(sweep: &Sweep, statuses: &[PointStatus]) -> String {
    let running = statuses.iter().filter(|point| point.is(Status::Running)).count();
    let Some(runs) = sweep.runs.as_ref().filter(|_| running > 0) else { return String::new() };
    let pace = Pace::of(runs, &sweep.points.iter().collect::<Vec<&Point>>());
    let open = statuses.iter().filter(|point| point.is(Status::Running) || point.is(Status::Waiting));
    let of_point = |status: &PointStatus| {
        let point = sweep.points.iter().find(|point| point.id == status.id)?;
        let trained = status.step.filter(|_| status.is(Status::Running)).unwrap_or(0);
        let share = trained as f64 / point.config.train.steps as f64;
        Some(pace.seconds_of(std::iter::once(point))? * (1.0 - share))
    };
    let seconds: Option<f64> = open.map(of_point).sum();
    seconds.map_or(String::new(), |seconds| {
        format!("; about {} left with {running} at once", duration(seconds / running as f64))
    })
}

/// Most points that are listed one by one.
const MOST_LISTED: usize = 100;

/// Returns whether a point of this status has a line among those of `points` points.
fn is_listed(status: &str, points: usize, all: bool) -> bool {
    all || points <= MOST_LISTED || [Status::Running, Status::Failed].iter().any(|listed| listed.name() == status)
}

/// Returns the line that stands for points without one.
fn unlisted(points: usize, all: bool) -> Option<String> {
    let text = format!("of {points} points, those that run or failed are listed; --all lists each");
    (!all && points > MOST_LISTED).then_some(text)
}

/// Longest reason in a line, in letters; `--json` has the whole.
const LONGEST_REASON: usize = 80;

fn shortened(reason: &str) -> String {
    match reason.chars().count() > LONGEST_REASON {
        true => reason.chars().take(LONGEST_REASON - 1).chain(['…']).collect(),
        false => reason.into(),
    }
}

/// Returns a line for each of several rows: how many of its points are done, and how many failed.
fn by_row(records: &[Record]) -> Vec<String> {
    let rows = distinct(records.iter().map(|record| record.row.as_str()));
    let line = |row: &&str| {
        let own = || records.iter().filter(|record| record.row == **row);
        let count = |status| own().filter(|record| record.status == status).count();
        let failed = match count(Status::Failed) {
            0 => String::new(),
            failed => format!(", {failed} failed"),
        };
        format!("row {row}: {} of {} done{failed}", count(Status::Done), own().count())
    };
    if rows.len() > 1 { rows.iter().map(line).collect() } else { Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_reason_is_cut() {
        assert_eq!(shortened("short"), "short");
        let long = shortened(&"ä".repeat(200));
        assert!(long.chars().count() == LONGEST_REASON && long.ends_with('…'), "{long}");
    }
}
