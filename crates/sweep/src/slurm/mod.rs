//! Sweeps on a cluster: the points are a Slurm job array, and Slurm does scheduling, limits and restarts. The state of
//! a point is read from its files only; the queue tells what waits and where.
//!
//! ```text
//! slurm/points.sbatch     the job array: task N runs point N of points.json
//! slurm/tables.sbatch     the job that collects after the array has ended
//! slurm/jobs.json         the submitted jobs
//! slurm/log/              output of the tasks
//! ```

mod commands;
mod jobs;
mod queue;
mod script;

use std::fs;
use std::path::PathBuf;

use crate::base::files::write_atomic;
use crate::base::{Error, Result};

pub use commands::check_installed;
pub use jobs::{JobId, Submitted};
pub use queue::{Queue, Task};
pub use script::{Request, Script, array};

use super::folder::SweepFolder;
use super::points::Point;
use commands::{sbatch, scancel};
use jobs::Jobs;

pub(super) const FOLDER: &str = "slurm";

/// The points to submit, by their numbers in `points.json`, and counts of the others.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Chosen {
    /// Points to run.
    pub indices: Vec<usize>,
    /// Done.
    pub done: usize,
    /// Failed, not to be retried.
    pub failed: usize,
    /// In the queue already.
    pub queued: usize,
    /// The scene is missing on this machine.
    pub no_data: usize,
}

impl Chosen {
    /// Chooses the points of a folder that have not ended and are not in the queue; with `retry_failed` also those
    /// that failed.
    pub fn among(points: &[Point], folder: &SweepFolder, queue: &Queue, retry_failed: bool) -> Result<Chosen> {
        let mut chosen = Chosen::default();
        for (index, point) in points.iter().enumerate() {
            let own = folder.point(&point.id);
            if own.result()?.is_some() {
                chosen.done += 1;
            } else if own.failure()?.is_some() && !retry_failed {
                chosen.failed += 1;
            } else if point.no_data.is_some() {
                chosen.no_data += 1;
            } else if queue.task(index).is_some() {
                chosen.queued += 1;
            } else {
                chosen.indices.push(index);
            }
        }
        Ok(chosen)
    }

    /// Returns the counts for people: `3 done, 1 failed, 2 in the queue`. Zero counts are skipped.
    pub fn left_out(&self) -> String {
        let Chosen { done, failed, queued, no_data, .. } = self;
        let counts =
            [(done, "done"), (failed, "failed"), (queued, "in the queue already"), (no_data, "without data here")];
        let words: Vec<String> =
            counts.iter().filter(|(count, _)| **count > 0).map(|(count, what)| format!("{count} {what}")).collect();
        words.join(", ")
    }
}

/// The Slurm files in a sweep's folder.
#[derive(Debug)]
pub struct Slurm {
    folder: PathBuf,
    sweep: PathBuf,
}

impl Slurm {
    /// Refers to a sweep's folder, which need not have submitted jobs.
    pub fn of(folder: &SweepFolder) -> Slurm {
        Slurm { folder: folder.path().join(FOLDER), sweep: folder.path().to_path_buf() }
    }

    /// Returns the folder of scripts, jobs and logs.
    pub fn path(&self) -> &std::path::Path {
        &self.folder
    }

    /// Returns the submitted jobs that may still be in the queue.
    pub fn jobs(&self) -> Result<Vec<Submitted>> {
        Ok(Jobs::read(&self.folder)?.jobs)
    }

    /// Returns the sweep's tasks in the queue. Without submitted jobs, the queue is not read.
    ///
    /// # Errors
    /// `squeue` is missing or fails.
    pub fn queue(&self) -> Result<Queue> {
        Queue::of(&self.jobs()?)
    }

    /// Writes both scripts, then submits the points and the job that collects. The caller holds the folder's lock.
    ///
    /// # Errors
    /// `sbatch` is missing or rejects a script.
    pub fn submit(&self, points: &str, tables: &str) -> Result<Submitted> {
        let log = self.folder.join("log");
        fs::create_dir_all(&log).map_err(|e| Error::unwritable(&log, &e))?;
        let write = |name: &str, text: &str| {
            let path = self.folder.join(name);
            write_atomic(&path, text.as_bytes()).map(|()| path)
        };
        let (points, tables) = (write("points.sbatch", points)?, write("tables.sbatch", tables)?);
        let mut submitted = Submitted { points: sbatch(&points, None)?, tables: None };
        let remember = |submitted: &Submitted| {
            let mut jobs = Jobs::read(&self.folder)?;
            // Jobs that left the queue are no longer needed.
            if let Ok(queue) = Queue::of(&jobs.jobs) {
                jobs.jobs.retain(|job| queue.holds(job));
            }
            jobs.jobs.retain(|job| job.points != submitted.points);
            jobs.jobs.push(submitted.clone());
            jobs.write(&self.folder)
        };
        remember(&submitted)?;
        let collecting = sbatch(&tables, Some(&submitted.points)).map_err(|error| {
            Error::Config(format!(
                "the points were submitted as job {}, but the job that collects was not: {error}; run `augnerf sweep collect \
                 {}`",
                submitted.points,
                self.sweep.display()
            ))
        })?;
        submitted.tables = Some(collecting);
        remember(&submitted)?;
        Ok(submitted)
    }

    /// Cancels the sweep's jobs in the queue, and returns them.
    pub fn cancel(&self) -> Result<Queue> {
        let jobs = self.jobs()?;
        let queue = Queue::of(&jobs)?;
        let is_held = |id: &&JobId| queue.tasks.iter().any(|task| task.job == id.number());
        // The collecting job goes first, since it would start when the points are gone. An error for one job does not
        // stop the others.
        let tables = jobs.iter().filter_map(|job| job.tables.as_ref());
        let held = tables.chain(jobs.iter().map(|job| &job.points)).filter(is_held);
        let refused: Vec<String> = held.filter_map(|job| scancel(job).err()).map(|error| error.to_string()).collect();
        if refused.is_empty() { Ok(queue) } else { Err(Error::Config(refused.join("; "))) }
    }
}
