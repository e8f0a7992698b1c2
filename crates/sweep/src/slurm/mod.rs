//! A sweep on many machines: its points as a job array of Slurm, which does scheduling, limits and restarts. What became of a
//! point is read from its files alone; the queue says only what waits and where.
//!
//! ```text
//! slurm/points.sbatch     the job array: task N runs point N of points.json
//! slurm/tables.sbatch     the job that collects when the array has ended
//! slurm/jobs.json         what was submitted
//! slurm/log/              what the tasks said
//! ```

mod commands;
mod jobs;
mod queue;
mod script;

use std::fs;
use std::path::PathBuf;

use crate::base::files::write_atomic;
use crate::base::{Error, Result};

pub use jobs::{JobId, Submitted};
pub use queue::{Queue, Task};
pub use script::{Request, Script, array, quoted};

use super::folder::SweepFolder;
use super::points::Point;
use commands::{sbatch, scancel};
use jobs::Jobs;

const FOLDER: &str = "slurm";

/// Which points are submitted, by their numbers in `points.json`, and how many are not.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Chosen {
    /// To be run.
    pub indices: Vec<usize>,
    /// Done.
    pub done: usize,
    /// Failed, and not to be tried again.
    pub failed: usize,
    /// In the queue since an earlier time.
    pub queued: usize,
    /// Without their scene on this machine.
    pub no_data: usize,
}

impl Chosen {
    /// Of the points in a folder those that have not ended and are not in the queue; with `retry_failed` those that failed, too.
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

    /// For a person: `3 done, 1 failed, 2 in the queue`; empty where there is nothing of it.
    pub fn left_out(&self) -> String {
        let Chosen { done, failed, queued, no_data, .. } = self;
        let counts =
            [(done, "done"), (failed, "failed"), (queued, "in the queue already"), (no_data, "without data here")];
        let words: Vec<String> =
            counts.iter().filter(|(count, _)| **count > 0).map(|(count, what)| format!("{count} {what}")).collect();
        words.join(", ")
    }
}

/// What a sweep's folder has to do with Slurm.
#[derive(Debug)]
pub struct Slurm {
    folder: PathBuf,
    sweep: PathBuf,
}

impl Slurm {
    /// Of a sweep's folder, whether anything of it was ever submitted or not.
    pub fn of(folder: &SweepFolder) -> Slurm {
        Slurm { folder: folder.path().join(FOLDER), sweep: folder.path().to_path_buf() }
    }

    /// Where scripts, jobs and logs are.
    pub fn path(&self) -> &std::path::Path {
        &self.folder
    }

    /// What was submitted and may still be in the queue.
    pub fn jobs(&self) -> Result<Vec<Submitted>> {
        Ok(Jobs::read(&self.folder)?.jobs)
    }

    /// What of it is in the queue now; nothing is asked where nothing was submitted.
    ///
    /// # Errors
    /// `squeue` is missing or refuses to answer.
    pub fn queue(&self) -> Result<Queue> {
        Queue::of(&self.jobs()?)
    }

    /// Writes both scripts, submits the points, then what collects them. Call it while holding the folder's lock.
    ///
    /// # Errors
    /// `sbatch` is missing, or why it refuses.
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
            // Those that are out of the queue have nothing more to say.
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
                "the points are submitted as job {}, but not the job that collects them: {error}; `augnerf sweep collect \
                 {}` does it by hand",
                submitted.points,
                self.sweep.display()
            ))
        })?;
        submitted.tables = Some(collecting);
        remember(&submitted)?;
        Ok(submitted)
    }

    /// Takes out of the queue what is in it, and returns it.
    pub fn cancel(&self) -> Result<Queue> {
        let jobs = self.jobs()?;
        let queue = Queue::of(&jobs)?;
        let is_held = |id: &&JobId| queue.tasks.iter().any(|task| task.job == id.number());
        // What collects first: it would begin when the points are gone. What is refused keeps no other job in the queue.
        let tables = jobs.iter().filter_map(|job| job.tables.as_ref());
        let held = tables.chain(jobs.iter().map(|job| &job.points)).filter(is_held);
        let refused: Vec<String> = held.filter_map(|job| scancel(job).err()).map(|error| error.to_string()).collect();
        if refused.is_empty() { Ok(queue) } else { Err(Error::Config(refused.join("; "))) }
    }
}
