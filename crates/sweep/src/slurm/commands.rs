//! Slurm's own commands: `sbatch`, `squeue`, `scancel`. Never `sacct`, which has nothing to say where no accounting is kept.

use std::path::Path;
use std::process::{Command, Output};

use crate::base::{Error, Result};

use super::jobs::JobId;

/// Runs a command of Slurm.
fn run(program: &str, arguments: &[String]) -> Result<Output> {
    Command::new(program).args(arguments).output().map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => Error::Config(format!(
            "cannot find `{program}`: Slurm's commands are not on this machine's PATH; run this where they are, such as the \
             cluster's login node, or run the points by another way with `augnerf sweep run-point`"
        )),
        _ => Error::Config(format!("cannot run `{program}`: {error}")),
    })
}

/// What it said against its task, in one line.
fn complaint(program: &str, output: &Output) -> String {
    let said = String::from_utf8_lossy(&output.stderr);
    let before = format!("{program}: ");
    let lines = said.lines().map(|line| line.trim().trim_start_matches(&before).trim_start_matches("error: "));
    let said = lines.filter(|line| !line.is_empty()).collect::<Vec<_>>().join("; ");
    if said.is_empty() { format!("it ended with {}", output.status) } else { said }
}

fn on_cluster(job: &JobId) -> Vec<String> {
    job.cluster().map(|cluster| format!("--clusters={cluster}")).into_iter().collect()
}

/// Submits a script, to begin when `after` has ended if there is one.
pub fn sbatch(script: &Path, after: Option<&JobId>) -> Result<JobId> {
    let mut arguments = vec!["--parsable".to_string()];
    if let Some(after) = after {
        arguments.extend(on_cluster(after));
        arguments.push(format!("--dependency=afterany:{}", after.number()));
    }
    arguments.push(script.display().to_string());
    let output = run("sbatch", &arguments)?;
    if !output.status.success() {
        let said = complaint("sbatch", &output);
        let hint =
            if said.contains("array") { " (arrays go up to MaxArraySize - 1 of `scontrol show config`)" } else { "" };
        return Err(Error::Config(format!("sbatch refuses {}: {said}{hint}", script.display())));
    }
    // A site may have it say more.
    let said = String::from_utf8_lossy(&output.stdout);
    let job = said.lines().rev().find_map(|line| JobId::try_from(line.trim().to_string()).ok());
    job.ok_or_else(|| Error::Config(format!("sbatch took {} and named no job: {said:?}", script.display())))
}

/// What the queue has of these jobs, a line a task: job, task, state, reason.
pub fn squeue(jobs: &[&JobId]) -> Result<String> {
    let mut clusters: Vec<Option<&str>> = jobs.iter().map(|job| job.cluster()).collect();
    clusters.sort_unstable();
    clusters.dedup();
    let mut lines = String::new();
    for cluster in clusters {
        let own: Vec<&&JobId> = jobs.iter().filter(|job| job.cluster() == cluster).collect();
        let numbers: Vec<&str> = own.iter().map(|job| job.number()).collect();
        let mut arguments = on_cluster(own[0]);
        let format = ["--noheader", "--array", "--format=%F|%K|%T|%r"].map(String::from);
        arguments.extend(format.into_iter().chain([format!("--jobs={}", numbers.join(","))]));
        let output = run("squeue", &arguments)?;
        let said = complaint("squeue", &output);
        if output.status.success() {
            lines.push_str(&String::from_utf8_lossy(&output.stdout));
        } else if !said.contains("Invalid job id") {
            // That one has left the queue long ago.
            return Err(Error::Config(format!("squeue does not say what is in the queue: {said}")));
        }
    }
    Ok(lines)
}

/// Takes a job out of the queue; what runs gets a SIGTERM first.
pub fn scancel(job: &JobId) -> Result<()> {
    let mut arguments = on_cluster(job);
    arguments.push(job.number().to_string());
    let output = run("scancel", &arguments)?;
    match output.status.success() {
        true => Ok(()),
        false => Err(Error::Config(format!("scancel refuses job {job}: {}", complaint("scancel", &output)))),
    }
}
