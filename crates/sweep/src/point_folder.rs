//! The folder of one point: its configuration, its run, and what became of it.

use std::fs;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::base::files::{
    check_own, clean_temporaries, discard, is_temporary, read_json, remove, write_atomic, write_json,
};
use crate::base::input::{TEXT_BYTES, read_text};
use crate::base::{BAD_CHECKPOINT, Error, Result};
use crate::metrics::{Metric, Scope};
use crate::report::{PointResult, Record, Status};
use crate::run::RunDir;
use crate::settings::Config;

use super::claim::{CLAIM, Claim, Sharing};
use super::layout::TablePosition;
use super::points::Point;

/// What to do with a damaged file of a point.
const DELETE: &str = "delete it to have the point done again";

/// Turns of a scheduler that led to nothing.
const STOPS: &str = "stops.json";

/// `stops.json`.
#[derive(Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Stops {
    /// Turns, one after the other, that began with the training done and ended before the evaluation did.
    evaluations: u32,
}

/// Why a point ended without a result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Failure {
    /// The error's sentence.
    pub reason: String,
    /// Its exit code.
    pub exit_code: u8,
}

/// The folder of one point.
#[derive(Clone, Debug)]
pub struct PointFolder {
    path: PathBuf,
}

impl PointFolder {
    pub(super) fn new(path: PathBuf) -> PointFolder {
        PointFolder { path }
    }

    /// The folder itself.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The run folder of its training.
    pub fn run(&self) -> PathBuf {
        self.path.join("run")
    }

    fn result_file(&self) -> PathBuf {
        self.path.join("result.json")
    }

    fn failure_file(&self) -> PathBuf {
        self.path.join("failed.json")
    }

    /// Makes the folder with the point's configuration, which is never changed afterwards.
    pub fn begin(&self, point: &Point) -> Result<()> {
        self.check_entries()?;
        fs::create_dir_all(&self.path).map_err(|e| Error::unwritable(&self.path, &e))?;
        let config = self.path.join("config.toml");
        if config.exists() {
            let text = read_text(&config, TEXT_BYTES).map_err(|e| Error::unreadable(&config, &e))?;
            let found = Config::from_toml(&text, &config.display().to_string())?;
            if point.id.starts_with(&found.hash()) || found.hash() == point.config.hash() {
                return Ok(());
            }
            return Err(Error::Checkpoint(format!(
                "{} was changed after the point was begun: its hash is {}; restore it, or delete {} to train the point \
                 again",
                config.display(),
                found.hash(),
                self.path.display()
            )));
        }
        point.config.validate().map_err(|error| error.within(&format!("point {}", point.id)))?;
        write_atomic(&config, format!("# {}\n{}", point.label(), point.config.to_toml()).as_bytes())
    }

    /// Checks that the folder and its run are folders, not links that would lead writes elsewhere.
    fn check_entries(&self) -> Result<()> {
        check_own(&self.path, true)?;
        check_own(&self.run(), true)
    }

    /// The result, if the point is done.
    pub fn result(&self) -> Result<Option<PointResult>> {
        read_json(&self.result_file(), DELETE)
    }

    /// Why the point failed, if it did.
    pub fn failure(&self) -> Result<Option<Failure>> {
        read_json(&self.failure_file(), DELETE)
    }

    /// Done or failed: nothing is left to do.
    pub fn ended(&self) -> bool {
        self.result_file().exists() || self.failure_file().exists()
    }

    /// The point is done and lacks one of these metrics.
    pub fn lacks(&self, metrics: &[String]) -> Result<bool> {
        let Some(result) = self.result()? else { return Ok(false) };
        let is_common = |name: &str| Metric::find(name).is_some_and(|metric| metric.scope == Scope::Common);
        let has = |name: &String| match is_common(name) {
            // Made of all rows when they are collected, from what each evaluation keeps.
            true => RunDir::depth_errors_in(&self.run()).is_file(),
            false => result.metrics.iter().any(|(known, value)| known == name && value.is_some()),
        };
        Ok(!metrics.iter().all(has))
    }

    /// When the point was measured last; tells one measurement from another.
    pub fn finished_at(&self) -> Option<std::time::SystemTime> {
        fs::metadata(self.result_file()).and_then(|metadata| metadata.modified()).ok()
    }

    /// Counts a turn that could only evaluate and was stopped before it had. Returns how many there were.
    pub fn count_stop(&self) -> Result<u32> {
        let file = self.path.join(STOPS);
        let stops = read_json::<Stops>(&file, DELETE)?.unwrap_or_default().evaluations.saturating_add(1);
        write_json(&file, &Stops { evaluations: stops })?;
        Ok(stops)
    }

    fn forget_stops(&self) -> Result<()> {
        let file = self.path.join(STOPS);
        remove(&file).map_err(|e| Error::unwritable(&file, &e))
    }

    /// When the point failed; tells one failure from another.
    pub fn failed_at(&self) -> Option<std::time::SystemTime> {
        fs::metadata(self.failure_file()).and_then(|metadata| metadata.modified()).ok()
    }

    /// Marks the point as done.
    pub fn finish(&self, result: &PointResult) -> Result<()> {
        self.forget_stops()?;
        write_json(&self.result_file(), result)
    }

    /// Marks the point as failed.
    pub fn fail(&self, failure: &Failure) -> Result<()> {
        write_json(&self.failure_file(), failure)
    }

    /// Takes a failure back, so that the point is tried again: from its last checkpoint, or, where
    /// that was what failed, from the start. The run of a finished point stays: older versions marked it as failed if
    /// measuring it again did.
    pub fn clear_failure(&self) -> Result<()> {
        let Some(failure) = self.failure()? else { return Ok(()) };
        self.check_entries()?;
        self.forget_stops()?;
        let run = self.run();
        if failure.exit_code == BAD_CHECKPOINT && self.finished_at().is_none() {
            discard(&run).map_err(|e| Error::unwritable(&run, &e))?;
        }
        let path = self.failure_file();
        fs::remove_file(&path).map_err(|e| Error::unwritable(&path, &e))
    }

    /// Deletes what a killed worker left half-written. Call it while holding the point's claim.
    pub fn clean(&self) -> Result<()> {
        clean_temporaries(&self.path).map(|_| ())
    }

    /// Deletes what a worker that was killed right after the point's end left: its claim, and files half-written.
    pub fn clean_up(&self, sharing: Sharing) -> Result<()> {
        let entries = fs::read_dir(&self.path).map_err(|e| Error::unreadable(&self.path, &e))?;
        let left = entries.flatten().any(|entry| is_temporary(&entry.file_name()) || entry.file_name() == CLAIM);
        if !left || !self.ended() {
            return Ok(());
        }
        match Claim::take(&self.path, sharing)? {
            // Dropped, the claim is gone.
            Some(_claim) => self.clean(),
            None => Ok(()),
        }
    }

    /// Returns what the files say about a point, at its first position in the table.
    pub fn record(&self, point: &Point) -> Result<Record> {
        let TablePosition { row, axes } = point.places[0].clone();
        let (id, scene, seed) = (point.id.clone(), point.scene.clone(), Some(point.config.seed));
        let record = Record { id, scene, row, axes, seed, ..Record::default() };
        if let Some(result) = self.result()? {
            return Ok(Record { status: Status::Done, result, ..record });
        }
        if let Some(failure) = self.failure()? {
            let reason = failure.reason.lines().next().unwrap_or_default().to_string();
            return Ok(Record { status: Status::Failed, reason, ..record });
        }
        Ok(match (Claim::look(&self.path), &point.no_data) {
            (Some(claim), _) if claim.alive => Record { status: Status::Running, ..record },
            // What a killed worker left here waits for the scene, too.
            (_, Some(reason)) => Record { status: Status::NoData, reason: reason.clone(), ..record },
            _ => Record { status: Status::Waiting, ..record },
        })
    }
}
