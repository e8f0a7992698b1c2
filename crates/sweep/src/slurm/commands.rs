//! Calls Slurm's commands `sbatch`, `squeue` and `scancel`. Never `sacct`, which needs accounting that many clusters
//! lack.

use std::path::Path;
use std::process::{Command, Output};

use crate::base::{Error, Result};

use super::jobs::JobId;

/// Returns the error for a command that is not on the PATH.
fn missing(program: &str) -> Error {
    Error::Config(format!(
        "cannot find `{program}`: Slurm's commands are not on the PATH; run this where they are, such as the \
         cluster's login node, or run points in another way with `augnerf sweep run-point`"
    ))
}

/// Checks that Slurm's commands are here, before anything is measured or written for them.
///
/// # Errors
/// [`Error::Config`]: `sbatch` is not on the PATH.
pub fn check_installed() -> Result<()> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let found = std::env::split_paths(&path).any(|folder| folder.join("sbatch").is_file());
    if found { Ok(()) } else { Err(missing("sbatch")) }
}

/// Runs a Slurm command.
fn run(program: &str, arguments: &[String]) -> Result<Output> {
    Command::new(program).args(arguments).output().map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => missing(program),
        _ => Error::Config(format!("cannot run `{program}`: {error}")),
    })
}

/// Returns the command's error message, on one line.
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

/// Submits a script; the job starts after `after` has ended, if given.
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
        return Err(Error::Config(format!("sbatch rejected {}: {said}{hint}", script.display())));
    }
    // A cluster may make it print more.
    let said = String::from_utf8_lossy(&output.stdout);
    let job = said.lines().rev().find_map(|line| JobId::try_from(line.trim().to_string()).ok());
    job.ok_or_else(|| Error::Config(format!("sbatch accepted {} but named no job: {said:?}", script.display())))
}

/// Returns the queue's lines for these jobs, one a task: job, task, state, reason.
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
            // This job left the queue long ago.
            return Err(Error::Config(format!("squeue cannot read the queue: {said}")));
        }
    }
    Ok(lines)
}

/// Removes a job from the queue; running tasks get a SIGTERM first.
pub fn scancel(job: &JobId) -> Result<()> {
    let mut arguments = on_cluster(job);
    arguments.push(job.number().to_string());
    let output = run("scancel", &arguments)?;
    match output.status.success() {
        true => Ok(()),
        false => Err(Error::Config(format!("scancel rejected job {job}: {}", complaint("scancel", &output)))),
    }
}
