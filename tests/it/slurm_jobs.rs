//! The script of `sweep slurm` with the Slurm of this machine: tasks at once on its nodes, kills, preemptions, failures, a
//! cancelled sweep.
//!
//! ```sh
//! tools/slurm_here.sh DIR && . DIR/env      # where there is none: two nodes on this machine
//! cargo test --release --test it slurm_jobs:: -- --ignored --nocapture
//! DIR/stop
//! ```

use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use super::slurm::{TINY, points};
use crate::common::files::{assert_same_files, entries, json, text};
use crate::common::program::Place;

/// As long as all that is submitted here may take.
const PATIENCE: Duration = Duration::from_secs(600);

/// Six points, four of some seconds and two that fail.
fn definition() -> String {
    let seeds = TINY.replace("seeds = [0]", "seeds = [0, 1]");
    let steps = seeds.replace("\"train.steps\" = 30", "\"train.steps\" = 4000");
    steps.replace("\"train.checkpoint_every\" = 10", "\"train.checkpoint_every\" = 50")
}

/// A folder with the sweep in it.
fn workplace() -> Place {
    let answered = Command::new("sinfo").arg("--noheader").output().is_ok_and(|output| output.status.success());
    assert!(answered, "no Slurm answers (sinfo): `tools/slurm_here.sh DIR && . DIR/env` starts one for this test");
    Place::with("tiny.toml", &definition())
}

/// What a command of Slurm says.
#[track_caller]
fn slurm(program: &str, arguments: &[&str]) -> String {
    let output = Command::new(program).args(arguments).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{program} {arguments:?}: {said}");
    String::from_utf8(output.stdout).unwrap()
}

/// Submits the sweep's script with options of `sbatch`, and returns the job's number.
fn submit(place: &Place, options: &[&str]) -> String {
    let script = place.at("runs/tiny/slurm/points.sbatch");
    slurm("sbatch", &[&["--parsable"], options, &[script.to_str().unwrap()]].concat()).trim().to_string()
}

/// Tasks of the job in the queue: task, state, node.
fn queue() -> Vec<(String, String, String)> {
    let said = slurm("squeue", &["-h", "-r", "--name", "tiny", "-o", "%K %T %N"]);
    let line = |line: &str| {
        let mut words = line.split(' ').map(String::from);
        let mut next = || words.next().unwrap_or_default();
        (next(), next(), next())
    };
    said.lines().map(line).collect()
}

#[track_caller]
fn wait_for(what: &str, place: &Place, holds: impl Fn() -> bool) {
    let started = Instant::now();
    while !holds() {
        if started.elapsed() > PATIENCE {
            let logs = entries(&place.at("runs/tiny/slurm/log"));
            let logs: Vec<String> = logs.iter().map(|log| format!("{}:\n{}", log.display(), text(log))).collect();
            panic!("{what}: not within {PATIENCE:?}; {:?}\n{}", queue(), logs.join("\n"));
        }
        std::thread::sleep(Duration::from_millis(200));
    }
}

/// It is trained right now and will be for a while.
fn in_training(point: &Path) -> bool {
    let lines = std::fs::read_to_string(point.join("run/scalars.csv")).map_or(0, |text| text.lines().count());
    point.join("claim.json").exists() && lines > 4
}

fn sessions(point: &Path) -> u64 {
    json(&point.join("run/timing.json"))["sessions"].as_u64().unwrap()
}

#[test]
#[ignore = "needs Slurm"]
fn a_sweep_on_a_cluster_equals_one_at_home_whatever_befalls_its_tasks() {
    let (home, place) = (workplace(), workplace());
    place.says("sweep slurm tiny.toml", 0, &["6 of 6 points", "sbatch runs/tiny/slurm/points.sbatch"]);
    let job = submit(&place, &["--cpus-per-task=1", "--mem=200", "--time=20"]);
    let all = points(&place);
    // Of each seed the first, broken, and the last row.
    let good = [0, 2, 3, 5];
    wait_for("four points at once", &place, || good.iter().all(|&index| in_training(&all[index])));
    let running = queue();
    let mut nodes: Vec<&str> = running.iter().filter(|task| task.1 == "RUNNING").map(|task| task.2.as_str()).collect();
    assert!(nodes.len() >= 4, "{running:?}");
    nodes.sort_unstable();
    nodes.dedup();
    assert_eq!(nodes.len(), 2, "{running:?}");

    // A job that takes a node's place, a signal before the end of the time, a kill.
    let node = |index: usize| running.iter().find(|task| task.0 == index.to_string()).map(|task| task.2.as_str());
    let (mut preempted, others): (Vec<_>, Vec<_>) = good.iter().partition(|&&index| node(index) == node(0));
    if slurm("sinfo", &["-h", "-o", "%R"]).lines().any(|partition| partition == "urgent") {
        let there = format!("--nodelist={}", node(0).unwrap());
        slurm("sbatch", &["--partition=urgent", &there, "--exclusive", "--output=/dev/null", "--wrap", "sleep 1"]);
    } else {
        preempted = vec![0];
        slurm("scontrol", &["requeue", &format!("{job}_0")]);
    }
    slurm("scancel", &["--signal=USR1", "--batch", &format!("{job}_{}", others[0])]);
    let pid = json(&all[others[1]].join("claim.json"))["pid"].to_string();
    assert!(Command::new("kill").args(["-9", &pid]).status().unwrap().success());
    wait_for("the end of all jobs", &place, || queue().is_empty());
    let logs: Vec<String> = entries(&place.at("runs/tiny/slurm/log")).iter().map(|log| text(log)).collect();
    let stopped = logs.iter().filter(|log| log.contains("stopping with a checkpoint")).count();
    assert_eq!(stopped, preempted.len() + 1, "{logs:#?}");
    for index in good {
        let disturbed = preempted.contains(&index) || others[..2].contains(&index);
        assert_eq!(sessions(&all[index]), if disturbed { 2 } else { 1 }, "{index}: {logs:#?}");
    }
    place.says("sweep status runs/tiny", 7, &["4 done, 2 failed", "not a number"]);
    place.run("sweep collect runs/tiny", 7);

    home.run("sweep run tiny.toml --quiet", 7);
    assert_same_files(&home.at("results/tiny"), &place.at("results/tiny"), &["timing.csv"]);
    for (a, b) in points(&home).iter().zip(&all) {
        assert_same_files(a, b, &["run/timing.json", "run/run.lock"]);
    }
}
