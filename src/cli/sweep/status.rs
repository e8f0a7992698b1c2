//! `augnerf sweep status`.

use std::collections::{BTreeMap, HashMap};
use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use serde_json::json;

use crate::base::{Error, Result, shown};
use crate::cli::answer::Answer;
use crate::cli::progress::{print_shown, print_to_reader};
use crate::cli::whole;
use crate::metrics::PSNR;
use crate::report::{Record, Status};
use crate::sweep::{Pace, Point, SweepFolder, SweepOutputs, last_words};

use super::opened::Opened;
use super::{check_done, duration, one_of_each, states_of};

pub const EXAMPLES: &str = "Examples:
  augnerf sweep status runs/smoke
  augnerf sweep status runs/smoke --watch 10  # every 10 s until all points have ended
  augnerf sweep status results/checks/smoke   # what a results folder says

Exit codes: 0 all points are done, 7 points failed, 11 points are waiting or running, 8 scenes are missing.";

#[derive(Args)]
pub struct StatusArguments {
    /// Folder of a sweep: runs/NAME, that of --out, or results/NAME
    folder: PathBuf,
    /// Folder of the scenes
    #[arg(long, env = "AUGNERF_DATA", value_name = "DIR")]
    data_root: Option<PathBuf>,
    /// Show the points again every N seconds until all have ended
    #[arg(long, value_name = "SECONDS", value_parser = whole::<u16>(1..=u16::MAX.into()))]
    watch: Option<u16>,
    /// List each point of a large sweep, not only those that run or failed
    #[arg(long)]
    all: bool,
    #[command(flatten)]
    answer: Answer,
}

/// The state of a point.
#[derive(Serialize)]
struct PointStatus<'a> {
    id: &'a str,
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

impl PointStatus<'_> {
    /// What a results folder says of a point.
    fn of_record(record: &Record) -> PointStatus<'_> {
        PointStatus {
            id: &record.id,
            label: record.point_label(),
            status: record.status.name(),
            reason: record.reason.clone(),
            step: None,
            steps: record.protocol("steps").parse().ok(),
            seconds_left: None,
            host: None,
            process: None,
            psnr: record.metric(PSNR.key),
        }
    }
}

impl StatusArguments {
    pub fn run(self) -> Result<()> {
        let opened = Opened::read(&self.folder, self.data_root.as_deref())?;
        if let Some(outputs) = opened.kept() {
            return self.of_results(&opened, outputs);
        }
        let Opened { folder, points, .. } = opened;
        if self.answer.json {
            return self.as_json(&folder, &points);
        }
        let terminal = console::Term::stdout();
        let mut on_screen = 0;
        loop {
            let (mut lines, left) = states(&folder, &points, self.all)?;
            if self.watch.is_some() {
                lines.insert(0, utc_now());
            }
            // On a terminal the new table replaces the old one.
            terminal
                .clear_last_lines(on_screen)
                .map_err(|e| Error::Output(format!("cannot write to the terminal: {e}")))?;
            let table: Vec<_> = lines.iter().map(|line| shown(line)).collect();
            let is_read = print_to_reader(&table.join("\n"))?;
            match self.watch {
                Some(seconds) if left > 0 && is_read => {
                    std::thread::sleep(std::time::Duration::from_secs(seconds.into()));
                }
                _ => return check_done(&states_of(&folder, &points)?),
            }
            on_screen = if terminal.is_term() { screen_lines(&lines, terminal.size()) } else { 0 };
        }
    }

    /// Prints the points as an object in one line, with `--watch` again and again until all have ended or nobody reads it.
    fn as_json(&self, folder: &SweepFolder, points: &[Point]) -> Result<()> {
        loop {
            let is_read = print_to_reader(&statuses(folder, points)?.to_string())?;
            let is_open = |point: &Point| point.no_data.is_none() && !folder.point(&point.id).ended();
            match self.watch.filter(|_| is_read && points.iter().any(is_open)) {
                Some(seconds) => std::thread::sleep(std::time::Duration::from_secs(seconds.into())),
                None => return check_done(&states_of(folder, points)?),
            }
        }
    }

    /// Shows what a results folder says of its points. Nothing runs there.
    fn of_results(&self, opened: &Opened, outputs: &SweepOutputs) -> Result<()> {
        let points: Vec<PointStatus> = one_of_each(&outputs.records).map(PointStatus::of_record).collect();
        let counts = counts(&points);
        if self.answer.json {
            let folder = opened.folder.path().display().to_string();
            self.answer.give_silently(&json!({ "folder": folder, "counts": counts, "points": points }))?;
            return check_done(&opened.states()?);
        }
        let listed = points.iter().filter(|point| is_listed(point.status, points.len(), self.all));
        for point in listed {
            let what = point.psnr.map_or(point.reason.clone(), |psnr| format!("PSNR {psnr:.2} dB"));
            print_shown(&format!("{:8} {} {}  {what}", point.status, point.id, point.label))?;
        }
        unlisted(points.len(), self.all).into_iter().try_for_each(|line| print_shown(&line))?;
        let counts = counts.iter().filter(|(_, count)| **count != 0);
        let counts: Vec<String> = counts.map(|(status, count)| format!("{count} {status}")).collect();
        print_shown(&format!("{}: results, {}", opened.folder.path().display(), counts.join(", ")))?;
        check_done(&opened.states()?)
    }
}

/// The date and time now, as `2026-11-26 19:45:03 UTC`.
fn utc_now() -> String {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).map_or(0, |since| since.as_secs());
    utc(now)
}

/// A time in seconds since 1970, as `2026-11-26 19:45:03 UTC`.
fn utc(seconds: u64) -> String {
    let (mut days, of_day) = (seconds / 86_400, seconds % 86_400);
    let is_leap = |year: u64| year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400));
    let mut year = 1970;
    while days >= 365 + u64::from(is_leap(year)) {
        days -= 365 + u64::from(is_leap(year));
        year += 1;
    }
    let mut month = 0;
    let lengths = [31, 28 + u64::from(is_leap(year)), 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    while days >= lengths[month] {
        days -= lengths[month];
        month += 1;
    }
    let (hour, minute, second) = (of_day / 3600, of_day / 60 % 60, of_day % 60);
    format!("{year}-{:02}-{:02} {hour:02}:{minute:02}:{second:02} UTC", month + 1, days + 1)
}

/// Counts the points in each state.
fn counts(points: &[PointStatus]) -> serde_json::Map<String, serde_json::Value> {
    let count = |status: Status| points.iter().filter(|point| point.status == status.name()).count();
    Status::ALL.into_iter().map(|status| (status.name().into(), count(status).into())).collect()
}

/// Returns how many lines a terminal of `(rows, columns)` uses for these, at most those that it can clear.
fn screen_lines(lines: &[String], (rows, columns): (u16, u16)) -> usize {
    let of_line = |line: &String| line.chars().count().div_ceil(usize::from(columns).max(1)).max(1);
    lines.iter().map(of_line).sum::<usize>().min(usize::from(rows).saturating_sub(1))
}

/// Returns the points' states as JSON.
fn statuses(folder: &SweepFolder, points: &[Point]) -> Result<serde_json::Value> {
    let mut statuses = Vec::new();
    for point in points {
        let state = folder.point(&point.id).state(point)?;
        let claim = state.claim.as_ref();
        statuses.push(PointStatus {
            id: &point.id,
            label: point.label(),
            status: state.status.name(),
            step: claim.map(|claim| claim.step),
            steps: Some(point.config.train.steps),
            seconds_left: claim.and_then(|claim| claim.seconds_left),
            host: claim.map(|claim| claim.host.clone()),
            process: claim.map(|claim| claim.pid),
            psnr: state.result.metric(PSNR.key),
            reason: state.reason,
        });
    }
    let counts = counts(&statuses);
    Ok(json!({ "folder": folder.path().display().to_string(), "counts": counts, "points": statuses }))
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

/// Returns the points' states as lines, and how many have not ended.
fn states(folder: &SweepFolder, points: &[Point], all: bool) -> Result<(Vec<String>, usize)> {
    let (mut lines, mut running, mut trained) = (Vec::new(), 0, HashMap::new());
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for point in points {
        let state = folder.point(&point.id).state(point)?;
        *counts.entry(state.status.name()).or_default() += 1;
        let what = match (state.status, &state.claim) {
            (Status::Running, Some(claim)) => {
                running += 1;
                trained.insert(&point.id, claim.step as f64 / claim.steps.max(1) as f64);
                let left = claim.seconds_left.map_or(String::new(), |left| format!(", {} left", duration(left)));
                let step = match claim.steps {
                    0 => "starting".to_string(),
                    steps => format!("step {} of {steps}", claim.step),
                };
                format!("{step}{left} ({}, process {})", claim.host, claim.pid)
            }
            (Status::Done, _) => {
                state.result.metric(PSNR.key).map_or(String::new(), |psnr| format!("PSNR {psnr:.2} dB"))
            }
            _ => shortened(&state.reason),
        };
        if is_listed(state.status.name(), points.len(), all) {
            lines.push(format!("{:8} {} {}  {what}", state.status.name(), point.id, point.label()));
        }
    }
    lines.extend(unlisted(points.len(), all));
    lines.extend(by_row(folder, points)?);
    if running == 0 && counts.contains_key(Status::Waiting.name()) {
        lines.extend(last_words(folder));
    }
    let counts: Vec<String> = counts.iter().map(|(status, count)| format!("{count} {status}")).collect();
    let open = |point: &&Point| point.no_data.is_none() && !folder.point(&point.id).ended();
    let left: Vec<&Point> = points.iter().filter(open).collect();
    let pace = Pace::of(folder, &points.iter().collect::<Vec<&Point>>());
    // Running points count with their remaining fraction.
    let of_point = |point: &&Point| {
        let trained = trained.get(&point.id).copied().unwrap_or(0.0);
        Some(pace.seconds_of(std::iter::once(*point))? * (1.0 - trained))
    };
    let seconds: Option<f64> = left.iter().map(of_point).sum();
    let eta = seconds.filter(|_| running > 0).map_or(String::new(), |seconds| {
        format!("; about {} left with {running} at once", duration(seconds / f64::from(running)))
    });
    lines.push(format!("{}: {}{eta}", folder.path().display(), counts.join(", ")));
    Ok((lines, left.len()))
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
fn by_row(folder: &SweepFolder, points: &[Point]) -> Result<Vec<String>> {
    let mut rows: Vec<(&str, [usize; 3])> = Vec::new();
    for point in points {
        let status = folder.point(&point.id).state(point)?.status;
        for place in &point.places {
            let index = rows.iter().position(|(row, _)| *row == place.row).unwrap_or(rows.len());
            if index == rows.len() {
                rows.push((&place.row, [0; 3]));
            }
            let [all, done, failed] = &mut rows[index].1;
            *all += 1;
            *done += usize::from(status == Status::Done);
            *failed += usize::from(status == Status::Failed);
        }
    }
    let line = |(row, [all, done, failed]): &(&str, [usize; 3])| {
        let failed = if *failed > 0 { format!(", {failed} failed") } else { String::new() };
        format!("row {row}: {done} of {all} done{failed}")
    };
    Ok(if rows.len() > 1 { rows.iter().map(line).collect() } else { Vec::new() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_is_told_in_utc() {
        assert_eq!(utc(0), "1970-01-01 00:00:00 UTC");
        assert_eq!(utc(951_782_399), "2000-02-28 23:59:59 UTC");
        assert_eq!(utc(951_782_400), "2000-02-29 00:00:00 UTC");
        assert_eq!(utc(1_795_722_303), "2026-11-26 19:45:03 UTC");
    }

    #[test]
    fn a_long_reason_is_cut() {
        assert_eq!(shortened("short"), "short");
        let long = shortened(&"ä".repeat(200));
        assert!(long.chars().count() == LONGEST_REASON && long.ends_with('…'), "{long}");
    }
}
