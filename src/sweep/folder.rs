//! The folder of a sweep: its definition, one folder a point, and what became of each point.
//!
//! ```text
//! sweep.toml              the definition that the points below belong to
//! points.json             the points that it asks for, with their configurations: fixed from then on
//! begin.lock              held while these two are made
//! step_seconds.json       measured seconds of a step, where budgets are in seconds
//! points/ID/config.toml   the point's configuration, before its scene fills it
//! points/ID/run/          the run folder, as `augnerf train` leaves it
//! points/ID/result.json   metrics and protocol: the point is done
//! points/ID/failed.json   why it is not
//! points/ID/claim.json    who works on it, and how far it is
//! ```

use std::fs;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::base::files::{clean_temporaries, read_json, write_atomic, write_json};
use crate::base::{Class, Error, Result};
use crate::settings::Config;

use super::claim::{Claim, Claimed};
use super::definition::{Definition, scene_name};
use super::points::Point;
use crate::report::{Record, Status};

const DEFINITION: &str = "sweep.toml";
const PLAN: &str = "points.json";
/// Measured seconds of a step, in a sweep's folder and beside its tables.
pub(super) const STEP_SECONDS: &str = "step_seconds.json";
const BEGIN_LOCK: &str = "begin.lock";
const POINTS: &str = "points";
/// What to do with a damaged file of a point.
const DELETE: &str = "delete it to have the point done again";

/// What a finished point leaves.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PointResult {
    /// Name and value of each metric.
    pub metrics: Vec<(String, Option<f64>)>,
    /// Name and text of each field of the protocol.
    pub protocol: Vec<(String, String)>,
    /// Sites whose deltas had no effect on the loss.
    pub inactive_levels: Vec<String>,
}

impl PointResult {
    /// The value of a metric by its key, as `psnr`; none where it was not measured.
    pub fn metric(&self, name: &str) -> Option<f64> {
        self.metrics.iter().find(|(known, _)| known == name).and_then(|(_, value)| *value)
    }
}

/// Why a point ended without a result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Failure {
    /// The error's sentence.
    pub reason: String,
    /// The exit code of its class.
    pub exit_code: u8,
}

impl Failure {
    /// The error's class; none for a code that no version of this program has.
    pub fn class(&self) -> Option<Class> {
        Class::of_exit_code(self.exit_code)
    }
}

/// The folder of one sweep.
#[derive(Clone, Debug)]
pub struct SweepFolder {
    path: PathBuf,
}

/// `points.json`.
#[derive(Serialize, Deserialize)]
struct Plan {
    /// Where scenes lay.
    data_root: Option<PathBuf>,
    points: Vec<Point>,
}

/// How a definition relates to the one that a folder was begun with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// The folder is new.
    New,
    /// They are equal.
    None,
    /// They differ.
    Changed,
}

impl SweepFolder {
    /// The folder at `path`, whether it exists or not.
    pub fn new(path: &Path) -> SweepFolder {
        SweepFolder { path: path.to_path_buf() }
    }

    /// The folder itself.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// `step_seconds.json`.
    pub fn step_seconds(&self) -> PathBuf {
        self.path.join(STEP_SECONDS)
    }

    /// The definition that the folder was begun with.
    pub fn definition(&self) -> Result<Definition> {
        let path = self.path.join(DEFINITION);
        let text = fs::read_to_string(&path).map_err(|e| {
            Error::Checkpoint(format!(
                "{} is not the folder of a sweep: cannot read {}: {e}; `augnerf sweep run FILE` makes one",
                self.path.display(),
                path.display()
            ))
        })?;
        Definition::parse(&text, &path.display().to_string())
    }

    /// Compares a definition with the one that the folder was begun with.
    pub fn compare(&self, definition: &Definition) -> Result<Change> {
        if !self.path.join(DEFINITION).exists() {
            return Ok(Change::New);
        }
        Ok(if self.definition()? == *definition { Change::None } else { Change::Changed })
    }

    /// Makes the folder and keeps others from beginning it until the value is dropped.
    pub fn lock(&self) -> Result<fs::File> {
        let points = self.path.join(POINTS);
        fs::create_dir_all(&points).map_err(|e| Error::unwritable(&points, &e))?;
        let path = self.path.join(BEGIN_LOCK);
        let file = fs::File::options().create(true).truncate(false).write(true).open(&path);
        let file = file.map_err(|e| Error::unwritable(&path, &e))?;
        match file.lock() {
            Err(error) if error.kind() != std::io::ErrorKind::Unsupported => Err(Error::unwritable(&path, &error)),
            _ => Ok(file),
        }
    }

    /// Writes what the folder is for: its points, then the definition that they belong to.
    pub fn begin(&self, definition: &Definition, points: &[Point], data_root: Option<&Path>) -> Result<()> {
        let data_root = data_root.map(|root| std::path::absolute(root).unwrap_or_else(|_| root.to_path_buf()));
        self.write_plan(definition, Plan { data_root, points: points.to_vec() })
    }

    /// The same beside a sweep's tables: for any machine, so without where scenes and weights lay on this one.
    pub fn archive(&self, definition: &Definition, points: &[Point]) -> Result<()> {
        let mut points = points.to_vec();
        points.iter_mut().for_each(|point| point.locate(None));
        self.write_plan(definition, Plan { data_root: None, points })
    }

    fn write_plan(&self, definition: &Definition, plan: Plan) -> Result<()> {
        write_json(&self.path.join(PLAN), &plan)?;
        write_atomic(&self.path.join(DEFINITION), definition.to_toml().as_bytes())
    }

    /// The points that the folder was begun with, their scenes looked for below `data_root` or
    /// where they were then; none before it was begun.
    pub fn points(&self, data_root: Option<&Path>) -> Result<Option<Vec<Point>>> {
        let plan: Option<Plan> = read_json(&self.path.join(PLAN), DELETE)?;
        Ok(plan.map(|Plan { data_root: then, mut points }| {
            points.iter_mut().for_each(|point| point.locate(data_root.or(then.as_deref())));
            points
        }))
    }

    /// The folder of a point.
    pub fn point(&self, id: &str) -> PointFolder {
        PointFolder { path: self.path.join(POINTS).join(id) }
    }

    /// All points as records, one for each place in the table, in the definition's order of scenes,
    /// rows, axes and seeds.
    pub fn records(&self, definition: &Definition, points: &[Point]) -> Result<Vec<Record>> {
        let mut records = Vec::new();
        for point in points {
            let state = self.point(&point.id).state(point)?;
            for place in &point.places {
                records.push(Record {
                    id: point.id.clone(),
                    scene: point.scene.clone(),
                    row: place.row.clone(),
                    axes: place.axes.clone(),
                    seed: point.config.seed,
                    status: state.status,
                    // What else a state has to say depends on the clock.
                    reason: match state.status {
                        Status::Failed | Status::NoData => state.reason.clone(),
                        _ => String::new(),
                    },
                    metrics: state.result.metrics.clone(),
                    protocol: state.result.protocol.clone(),
                    inactive_levels: state.result.inactive_levels.clone(),
                });
            }
        }
        let position = |list: &[String], name: &str| list.iter().position(|known| known == name);
        let scenes: Vec<String> = definition.scenes.iter().map(|scene| scene_name(scene).to_string()).collect();
        let rows: Vec<String> = definition.row.iter().map(|row| row.name.clone()).collect();
        records.sort_by_key(|record| {
            let axes: Vec<_> = record.axes.iter().map(|value| definition.axis_position(value)).collect();
            (position(&scenes, &record.scene), position(&rows, &record.row), axes)
        });
        Ok(group_seeds(records))
    }
}

/// Brings the seeds of equal cells together, cells in order of first appearance.
fn group_seeds(records: Vec<Record>) -> Vec<Record> {
    let mut cells: Vec<Vec<Record>> = Vec::new();
    for record in records {
        let same = |cell: &&mut Vec<Record>| {
            cell[0].scene == record.scene && cell[0].row == record.row && cell[0].axes == record.axes
        };
        match cells.iter_mut().find(same) {
            Some(cell) => cell.push(record),
            None => cells.push(vec![record]),
        }
    }
    cells.into_iter().flatten().collect()
}

/// What the files of a point say.
#[derive(Clone, Debug)]
pub struct PointState {
    /// How far it is.
    pub status: Status,
    /// Why it failed or waits; empty otherwise.
    pub reason: String,
    /// Its result; empty unless done.
    pub result: PointResult,
    /// Who works on it.
    pub claim: Option<Claimed>,
}

/// The folder of one point.
#[derive(Clone, Debug)]
pub struct PointFolder {
    path: PathBuf,
}

impl PointFolder {
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
        fs::create_dir_all(&self.path).map_err(|e| Error::unwritable(&self.path, &e))?;
        let config = self.path.join("config.toml");
        if config.exists() {
            let text = fs::read_to_string(&config).map_err(|e| Error::unreadable(&config, &e))?;
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
        write_atomic(&config, format!("# {}\n{}", point.label(), point.config.to_toml()).as_bytes())
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
        let has = |name: &String| result.metrics.iter().any(|(known, value)| known == name && value.is_some());
        Ok(!metrics.iter().all(has))
    }

    /// When the point was measured last; tells one measurement from another.
    pub fn finished_at(&self) -> Option<std::time::SystemTime> {
        fs::metadata(self.result_file()).and_then(|metadata| metadata.modified()).ok()
    }

    /// When the point failed; tells one failure from another.
    pub fn failed_at(&self) -> Option<std::time::SystemTime> {
        fs::metadata(self.failure_file()).and_then(|metadata| metadata.modified()).ok()
    }

    /// Marks the point as done.
    pub fn finish(&self, result: &PointResult) -> Result<()> {
        write_json(&self.result_file(), result)
    }

    /// Marks the point as failed.
    pub fn fail(&self, failure: &Failure) -> Result<()> {
        write_json(&self.failure_file(), failure)
    }

    /// Takes a failure back, so that the point is tried again: from its last checkpoint, or, where
    /// that was what failed, from the start.
    pub fn forgive(&self) -> Result<()> {
        let Some(failure) = self.failure()? else { return Ok(()) };
        let run = self.run();
        if failure.class() == Some(Class::Checkpoint) && run.exists() {
            fs::remove_dir_all(&run).map_err(|e| Error::unwritable(&run, &e))?;
        }
        let path = self.failure_file();
        fs::remove_file(&path).map_err(|e| Error::unwritable(&path, &e))
    }

    /// Deletes what a killed runner left half-written. Call it while holding the point's claim.
    pub fn clean(&self) -> Result<()> {
        clean_temporaries(&self.path).map(|_| ())
    }

    /// What the files say about a point.
    pub fn state(&self, point: &Point) -> Result<PointState> {
        let state = |status, reason: String| PointState { status, reason, result: PointResult::default(), claim: None };
        if let Some(result) = self.result()? {
            return Ok(PointState { result, ..state(Status::Done, String::new()) });
        }
        if let Some(failure) = self.failure()? {
            let first = failure.reason.lines().next().unwrap_or_default().to_string();
            return Ok(state(Status::Failed, first));
        }
        match Claim::look(&self.path) {
            Some(claim) if claim.alive => {
                Ok(PointState { claim: Some(claim), ..state(Status::Running, String::new()) })
            }
            Some(claim) => {
                let reason = format!("its runner ({}, process {}) died at step {}", claim.host, claim.pid, claim.step);
                Ok(PointState { claim: Some(claim), ..state(Status::Waiting, reason) })
            }
            None => Ok(match &point.no_data {
                Some(reason) => state(Status::NoData, reason.clone()),
                None => state(Status::Waiting, String::new()),
            }),
        }
    }
}
