//! The folder of a sweep: its definition, and one folder a point.
//!
//! ```text
//! sweep.toml              the definition of the points below
//! points.json             the points, with their configurations; fixed from then on
//! begin.lock              held while these two files are written
//! step_seconds.json       measured seconds of a step, where budgets are in seconds
//! worker.txt              how the newest worker ended
//! points/ID/config.toml   the point's configuration, before its scene fills it
//! points/ID/run/          the run folder, as `augnerf train` writes it
//! points/ID/result.json   metrics and protocol: the point is done
//! points/ID/failed.json   why the point failed
//! points/ID/claim.json    who works on it, and how far it is
//! slurm/                  scripts, jobs and logs of a cluster
//! ```

use std::collections::{HashMap, HashSet};
use std::fs;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::base::files::{check_own, clean_temporaries, read_large_json, write_atomic};
use crate::base::input::{TEXT_BYTES, read_text};
use crate::base::{Error, Result};

use super::definition::{Definition, scene_name};
use super::point_folder::PointFolder;
use super::points::Point;
use super::slurm;
use super::varied::Varied;
use crate::report::{AxisValue, Record, Status};

pub(super) const DEFINITION: &str = "sweep.toml";
pub(super) const PLAN: &str = "points.json";
/// Measured seconds of a step, in a sweep's folder and next to its tables.
pub(super) const STEP_SECONDS: &str = "step_seconds.json";
/// Size limit of `points.json` in bytes, enough for the most points that a sweep may have.
const PLAN_BYTES: u64 = 64 << 20;
const BEGIN_LOCK: &str = "begin.lock";
const POINTS: &str = "points";
/// Advice for a damaged list of points.
const DELETE_PLAN: &str = "delete it, and `augnerf sweep run` writes it again";
/// Length limit of a point's name.
const LONGEST_ID: usize = 64;

/// The folder of one sweep.
#[derive(Clone, Debug)]
pub struct SweepFolder {
    path: PathBuf,
}

/// `points.json`.
#[derive(Serialize, Deserialize)]
struct Plan {
    /// The data root when the folder was created.
    data_root: Option<PathBuf>,
    points: Vec<Point>,
}

impl Plan {
    /// Returns the file's text, which has one line a point.
    fn to_json(&self) -> serde_json::Result<String> {
        let points: serde_json::Result<Vec<String>> = self.points.iter().map(serde_json::to_string).collect();
        let data_root = serde_json::to_string(&self.data_root)?;
        Ok(format!("{{\"data_root\":{data_root},\"points\":[\n{}\n]}}\n", points?.join(",\n")))
    }
}

/// Relation of a definition to the one that a folder was created with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// The folder is new.
    New,
    /// The definitions are equal.
    None,
    /// The definitions differ.
    Changed,
}

impl SweepFolder {
    /// Refers to the folder at `path`, which need not exist.
    pub fn new(path: &Path) -> SweepFolder {
        SweepFolder { path: path.to_path_buf() }
    }

    /// The folder itself.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns whether a sweep was created here.
    pub fn is_begun(&self) -> bool {
        self.path.join(PLAN).is_file() && self.path.join(DEFINITION).is_file()
    }

    /// Returns the path of `step_seconds.json`.
    pub fn step_seconds(&self) -> PathBuf {
        self.path.join(STEP_SECONDS)
    }

    /// Reads the definition that the folder was created with.
    pub fn definition(&self) -> Result<Definition> {
        let path = self.path.join(DEFINITION);
        let text = read_text(&path, TEXT_BYTES).map_err(|e| {
            Error::Checkpoint(format!(
                "{} is not a sweep folder: cannot read {}: {e}; `augnerf sweep run FILE` creates one",
                self.path.display(),
                path.display()
            ))
        })?;
        Definition::parse(&text, &path.display().to_string())
    }

    /// Compares a definition with the one that the folder was created with.
    pub fn compare(&self, definition: &Definition) -> Result<Change> {
        if !self.path.join(DEFINITION).exists() {
            return Ok(Change::New);
        }
        Ok(if self.definition()? == *definition { Change::None } else { Change::Changed })
    }

    /// Creates the folder and locks it until the returned file is dropped.
    pub fn lock(&self) -> Result<fs::File> {
        let points = self.path.join(POINTS);
        self.check_entries()?;
        fs::create_dir_all(&points).map_err(|e| Error::unwritable(&points, &e))?;
        let path = self.path.join(BEGIN_LOCK);
        let file = fs::File::options().create(true).truncate(false).write(true).open(&path);
        let file = file.map_err(|e| Error::unwritable(&path, &e))?;
        // Without locks nobody can be kept out, so that another process may be writing what looks left over.
        if file.lock().is_ok() {
            clean_temporaries(&self.path)?;
        }
        Ok(file)
    }

    /// Checks that the folder's own entries are no links that would lead writes elsewhere.
    pub(super) fn check_entries(&self) -> Result<()> {
        let own =
            |names: &[&str], is_folder| names.iter().try_for_each(|name| check_own(&self.path.join(name), is_folder));
        own(&[BEGIN_LOCK, PLAN, DEFINITION, STEP_SECONDS], false)?;
        own(&[POINTS, slurm::FOLDER], true)
    }

    /// Writes the folder's points, then its definition.
    pub fn begin(&self, definition: &Definition, points: &[Point], data_root: Option<&Path>) -> Result<()> {
        let data_root = data_root.map(|root| std::path::absolute(root).unwrap_or_else(|_| root.to_path_buf()));
        self.write_plan(definition, Plan { data_root, points: points.to_vec() })
    }

    /// Writes the same next to a sweep's tables, without this machine's paths of scenes and weights.
    pub fn archive(&self, definition: &Definition, points: &[Point]) -> Result<()> {
        let mut points = points.to_vec();
        points.iter_mut().for_each(|point| point.locate(None));
        self.write_plan(definition, Plan { data_root: None, points })
    }

    fn write_plan(&self, definition: &Definition, plan: Plan) -> Result<()> {
        let path = self.path.join(PLAN);
        write_atomic(&path, plan.to_json().map_err(|e| Error::unwritable(&path, &e.into()))?.as_bytes())?;
        write_atomic(&self.path.join(DEFINITION), definition.to_toml().as_bytes())
    }

    /// Returns the folder's points, or `None` before they are written. Scenes are looked for below `data_root`, or
    /// where they were when the folder was created.
    pub fn points(&self, data_root: Option<&Path>) -> Result<Option<Vec<Point>>> {
        let path = self.path.join(PLAN);
        let Some(Plan { data_root: then, mut points }) = read_large_json(&path, PLAN_BYTES, DELETE_PLAN)? else {
            return Ok(None);
        };
        check_points(&points)
            .map_err(|found| Error::Checkpoint(format!("cannot use {}: {found}; {DELETE_PLAN}", path.display())))?;
        points.iter_mut().for_each(|point| point.locate(data_root.or(then.as_deref())));
        Ok(Some(points))
    }

    /// Returns the folder of a point.
    pub fn point(&self, id: &str) -> PointFolder {
        PointFolder::new(self.path.join(POINTS).join(id))
    }

    /// Returns all points as records, one for each position in the table, in the definition's order of scenes, rows,
    /// axes and seeds.
    pub fn records(&self, definition: &Definition, points: &[Point]) -> Result<Vec<Record>> {
        let (mut records, varied) = (Vec::new(), Varied::of(definition, points));
        for point in points {
            let own = self.point(&point.id).record(point)?;
            for place in &point.places {
                let mut record = Record { row: place.row.clone(), axes: place.axes.clone(), ..own.clone() };
                if own.status == Status::Done {
                    let columns = varied.columns(point, &place.axes, Some(&own.result.protocol));
                    record.result.protocol.extend(columns);
                }
                records.push(record.ordered());
            }
        }
        let names: Vec<String> = definition.scenes.iter().map(|scene| scene_name(scene)).collect();
        let scenes = positions(names.iter().map(String::as_str));
        let rows = positions(definition.row.iter().map(|row| row.name.as_str()));
        let places = definition.axis_positions();
        records.sort_by_cached_key(|record| {
            let axes: Vec<_> = record.axes.iter().map(|value| places.get(value)).collect();
            (scenes.get(record.scene.as_str()), rows.get(record.row.as_str()), axes)
        });
        Ok(group_seeds(records))
    }
}

/// Returns the position of each name in a list without repetitions.
fn positions<'a>(names: impl Iterator<Item = &'a str>) -> HashMap<&'a str, usize> {
    names.enumerate().map(|(index, name)| (name, index)).collect()
}

/// Groups the seeds of equal cells, cells in order of first appearance.
fn group_seeds(records: Vec<Record>) -> Vec<Record> {
    let mut cells: Vec<Vec<Record>> = Vec::new();
    let mut known: HashMap<(String, String, Vec<AxisValue>), usize> = HashMap::new();
    for record in records {
        let cell = (record.scene.clone(), record.row.clone(), record.axes.clone());
        let index = *known.entry(cell).or_insert(cells.len());
        match cells.get_mut(index) {
            Some(cell) => cell.push(record),
            None => cells.push(vec![record]),
        }
    }
    cells.into_iter().flatten().collect()
}

/// Returns an error for points that `begin` would not have written. Their names become names of folders, those of
/// scenes names of files.
fn check_points(points: &[Point]) -> std::result::Result<(), String> {
    let mut ids = HashSet::new();
    let is_id = |id: &str| {
        let plain = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'-';
        (1..=LONGEST_ID).contains(&id.len()) && id.bytes().all(plain)
    };
    for point in points {
        let id = &point.id;
        if !is_id(id) {
            return Err(format!("a point's id is {id:?}, but an id has only letters, digits and -"));
        }
        if !ids.insert(id) {
            return Err(format!("two points have the id {id}"));
        }
        if point.places.is_empty() {
            return Err(format!("point {id} has no position in the table (places is empty)"));
        }
        if point.scene != scene_name(&point.source) {
            return Err(format!("the scene of point {id} is {:?}, its source {:?}", point.scene, point.source));
        }
        point.config.check_ranges().map_err(|error| format!("point {id}: {error}"))?;
    }
    Ok(())
}
