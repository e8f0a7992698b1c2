//! A sweep's tasks in Slurm's queue.

use std::fmt;

use crate::base::Result;

use super::commands::squeue;
use super::jobs::{JobId, Submitted};

/// A task in the queue.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Task {
    /// Its job's number.
    pub job: String,
    /// Its number in the array, which is the point's, or `None` if the job is not an array.
    pub index: Option<usize>,
    /// `RUNNING`, `PENDING`, `COMPLETING`, ...
    pub state: String,
    /// Why it waits; empty if Slurm gives no reason.
    pub reason: String,
}

impl fmt::Display for Task {
    /// Writes `job 12_3 PENDING (Priority)`.
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "job {}", self.job)?;
        if let Some(index) = self.index {
            write!(f, "_{index}")?;
        }
        write!(f, " {}", self.state)?;
        if self.reason.is_empty() { Ok(()) } else { write!(f, " ({})", self.reason) }
    }
}

/// A sweep's part of the queue.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Queue {
    /// Tasks of arrays, and other jobs.
    pub tasks: Vec<Task>,
}

impl Queue {
    pub(super) fn of(jobs: &[Submitted]) -> Result<Queue> {
        if jobs.is_empty() {
            return Ok(Queue::default());
        }
        let all: Vec<&JobId> = jobs.iter().flat_map(|job| [&job.points].into_iter().chain(&job.tables)).collect();
        Ok(Queue::parse(&squeue(&all)?))
    }

    /// Parses lines of `JOB|TASK|STATE|REASON`, as `squeue` writes them; skips others.
    pub fn parse(lines: &str) -> Queue {
        let task = |line: &str| {
            let [job, index, state, reason] = line.trim().split('|').collect::<Vec<_>>().try_into().ok()?;
            let reason = if reason == "None" { "" } else { reason };
            let index = index.parse().ok();
            Some(Task { job: job.into(), index, state: state.into(), reason: reason.into() })
        };
        Queue { tasks: lines.lines().filter_map(task).collect() }
    }

    /// Returns the task of a point; of several, the running one.
    pub fn task(&self, index: usize) -> Option<&Task> {
        let own = self.tasks.iter().filter(|task| task.index == Some(index));
        own.min_by_key(|task| task.state != "RUNNING")
    }

    /// Returns the jobs that collect.
    pub fn tables(&self) -> impl Iterator<Item = &Task> {
        self.tasks.iter().filter(|task| task.index.is_none())
    }

    pub(super) fn holds(&self, job: &Submitted) -> bool {
        let is = |task: &Task, id: &JobId| task.job == id.number();
        self.tasks.iter().any(|task| is(task, &job.points) || job.tables.as_ref().is_some_and(|id| is(task, id)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_queue_is_read_line_by_line() {
        let lines = "7|0|RUNNING|None\n7|2|PENDING|JobArrayTaskLimit\nCLUSTER: gpu\n9|2|RUNNING|None\n8|N/A|PENDING|Dependency\n";
        let queue = Queue::parse(lines);
        assert_eq!(queue.tasks.len(), 4);
        assert_eq!(queue.task(0).unwrap().to_string(), "job 7_0 RUNNING");
        // Of two tasks of one point, the running one counts.
        assert_eq!(queue.task(2).unwrap().job, "9");
        assert_eq!(queue.task(1), None);
        let tables: Vec<String> = queue.tables().map(ToString::to_string).collect();
        assert_eq!(tables, ["job 8 PENDING (Dependency)"]);
        let job = |number: &str| JobId::try_from(number.to_string()).unwrap();
        let submitted = |points, tables| Submitted { points: job(points), tables: Some(job(tables)) };
        assert!(queue.holds(&submitted("7", "70")) && queue.holds(&submitted("1", "8")));
        assert!(!queue.holds(&submitted("70", "78")));
    }
}
