//! `sweep run-point`, and the script of `sweep slurm` without Slurm: two of its commands are stood in for by scripts that
//! write down how they were called. `slurm_jobs.rs` has the real one.

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use crate::common::assert_says;
use crate::common::files::{assert_same_files, entries, json, text};
use crate::common::program::{self, augnerf, wait_for};
use tempfile::TempDir;

/// Three points of a second; the second one fails.
pub const TINY: &str = r#"
title = "tiny"
preset = "smoke"
scenes = ["builtin"]
seeds = [0]
metrics = ["psnr"]
baseline = "NeRF"

[set]
"data.width" = 16
"field.width" = 16
"sampling.coarse" = 8
"sampling.fine" = 8
"train.rays" = 64
"train.chunk" = 32
"train.steps" = 30
"train.checkpoint_every" = 10
"eval.pictures" = 0

[[row]]
name = "NeRF"

[[row]]
name = "broken"
set = { "train.learning_rate" = 1e30 }

[[row]]
name = "Aug-NeRF"
set = { method = "aug-nerf", "perturb.attack" = "calibrated" }
"#;

/// The same with steps enough to be interrupted in.
fn long() -> String {
    let steps = TINY.replace("\"train.steps\" = 30", "\"train.steps\" = 2000");
    steps.replace("\"train.checkpoint_every\" = 10", "\"train.checkpoint_every\" = 50")
}

fn workplace(definition: &str) -> TempDir {
    let dir = TempDir::new().unwrap();
    std::fs::write(dir.path().join("tiny.toml"), definition).unwrap();
    dir
}

fn command(arguments: &[&str], dir: &Path) -> Command {
    let mut command = augnerf(arguments);
    command.current_dir(dir);
    command
}

#[track_caller]
fn demand(arguments: &[&str], dir: &Path, code: i32) -> String {
    program::demand(&mut command(arguments, dir), code)
}

fn point(index: &str) -> [&str; 6] {
    ["sweep", "run-point", "runs/tiny", "--threads=1", "--index", index]
}

fn signal(child: &Child, signal: &str) {
    assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
}

/// The points' folders, in the order of their numbers.
fn points(dir: &Path) -> Vec<PathBuf> {
    let folder = dir.join("runs/tiny");
    let ids = json(&folder.join("points.json"))["points"].as_array().unwrap().clone();
    ids.iter().map(|point| folder.join("points").join(point["id"].as_str().unwrap())).collect()
}

fn in_training(point: &Path) -> bool {
    std::fs::read_to_string(point.join("run/scalars.csv")).is_ok_and(|text| text.lines().count() > 2)
}

#[test]
fn points_that_are_run_one_by_one_make_the_tables_of_a_sweep() {
    let (whole, single) = (workplace(TINY), workplace(TINY));
    demand(&["sweep", "run", "tiny.toml", "--quiet"], whole.path(), 7);
    let dir = single.path();
    let said = demand(&["sweep", "run", "--create", "tiny.toml"], dir, 0);
    assert_says(&said, &["runs/tiny: 3 points", "0 to 2", "run-point"]);
    assert_eq!(entries(&dir.join("runs/tiny/points")).len(), 0, "nothing was run");
    demand(&point("2"), dir, 0);
    let name = points(dir)[0].file_name().unwrap().to_str().unwrap().to_string();
    let by_name = ["sweep", "run-point", "runs/tiny", "--id", &name[..8]];
    assert_says(&demand(&by_name, dir, 0), &["done: NeRF · builtin · seed 0"]);
    let said = demand(&point("1"), dir, 7);
    assert_says(&said, &["broken · builtin · seed 0 failed", "--retry-failed", "not a number"]);
    // What has ended is not done again.
    let ends = || {
        let file = |point: &PathBuf| {
            entries(point).into_iter().find(|file| file.ends_with("result.json") || file.ends_with("failed.json"))
        };
        points(dir).iter().map(|point| file(point).unwrap().metadata().unwrap().modified().unwrap()).collect::<Vec<_>>()
    };
    let ended = ends();
    assert_says(&demand(&point("0"), dir, 0), &["was already done"]);
    demand(&point("1"), dir, 7);
    assert_eq!(ends(), ended);
    demand(&[&point("1")[..], &["--retry-failed"]].concat(), dir, 7);
    demand(&["sweep", "collect", "runs/tiny"], dir, 7);
    assert_same_files(&whole.path().join("results/tiny"), &dir.join("results/tiny"), &["timing.csv"]);
}

#[test]
fn a_point_that_is_not_there_is_refused() {
    let dir = workplace(TINY);
    assert_says(&demand(&point("0"), dir.path(), 5), &["runs/tiny", "points.json"]);
    demand(&["sweep", "run", "--create", "tiny.toml"], dir.path(), 0);
    assert_says(&demand(&point("3"), dir.path(), 2), &["--index 3", "3 points, choose 0 to 2"]);
    let by = |id| ["sweep", "run-point", "runs/tiny", "--id", id];
    assert_says(&demand(&by("zz"), dir.path(), 2), &["--id 'zz'", "sweep status"]);
    assert_says(&demand(&by(""), dir.path(), 2), &["--id ''"]);
    demand(&["sweep", "run-point", "runs/tiny"], dir.path(), 2);
    demand(&[&point("0")[..], &["--id", "1"]].concat(), dir.path(), 2);
    let away =
        demand(&["sweep", "run", "--create", "tiny.toml", "--scenes", "orchids", "--out", "away"], dir.path(), 0);
    assert_says(&away, &["away: 3 points"]);
    let said = demand(&["sweep", "run-point", "away", "--index", "0"], dir.path(), 8);
    assert_says(&said, &["no data here", "orchids", "AUGNERF_DATA"]);
}

/// As a scheduler sends them: to the script and to the program, several at once.
#[test]
fn signals_of_a_scheduler_stop_a_point_with_a_checkpoint_however_many_come() {
    let (whole, stopped) = (workplace(&long()), workplace(&long()));
    let dir = stopped.path();
    let first = ["--seeds", "0", "--quiet"];
    for dir in [whole.path(), dir] {
        demand(&[&["sweep", "run", "--create", "tiny.toml"][..], &first].concat(), dir, 0);
    }
    let own = points(dir)[0].clone();
    let child = command(&point("0"), dir).stderr(Stdio::piped()).spawn().unwrap();
    wait_for("a step", || in_training(&own));
    for name in ["-USR1", "-TERM", "-USR1", "-TERM"] {
        signal(&child, name);
    }
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(143), "{said}");
    assert_says(&said, &["stopping with a checkpoint", "signal 15"]);
    assert!(!own.join("claim.json").exists() && !own.join("result.json").exists());
    demand(&point("0"), dir, 0);
    demand(&point("0"), whole.path(), 0);
    assert_eq!(json(&own.join("run/timing.json"))["sessions"], 2);
    assert_same_files(&points(whole.path())[0], &own, &["run/timing.json", "run/run.lock"]);
}

#[test]
fn a_point_that_another_runner_works_on_is_left_to_it() {
    let dir = workplace(&long());
    demand(&["sweep", "run", "--create", "tiny.toml"], dir.path(), 0);
    let own = points(dir.path())[0].clone();
    let mut child = command(&point("0"), dir.path()).stderr(Stdio::null()).spawn().unwrap();
    wait_for("a step", || in_training(&own));
    let said = demand(&point("0"), dir.path(), 0);
    assert_says(&said, &["is skipped", &format!("process {}", child.id())]);
    assert!(child.try_wait().unwrap().is_none(), "the other one goes on");
    child.kill().unwrap();
    child.wait().unwrap();
}

/// Slurm's commands that the script calls, in a folder of their own; each call is written down.
struct Cluster {
    bin: TempDir,
}

impl Cluster {
    fn new() -> Cluster {
        let cluster = Cluster { bin: TempDir::new().unwrap() };
        cluster.says("");
        std::fs::write(cluster.bin.path().join("calls"), "").unwrap();
        for (name, body) in [("squeue", "cat \"$here/queue\""), ("scontrol", "echo \"scontrol $*\" >> \"$here/calls\"")]
        {
            let path = cluster.bin.path().join(name);
            std::fs::write(&path, format!("#!/bin/sh\nhere={}\n{body}\n", cluster.bin.path().display())).unwrap();
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
        }
        cluster
    }

    /// What `squeue` says of a task's state.
    fn says(&self, state: &str) {
        std::fs::write(self.bin.path().join("queue"), state).unwrap();
    }

    fn calls(&self) -> Vec<String> {
        text(&self.bin.path().join("calls")).lines().map(String::from).collect()
    }
}

#[test]
fn the_script_has_what_slurm_needs() {
    let dir = workplace(TINY);
    let slurm = ["sweep", "slurm", "tiny.toml", "--quiet"];
    // No command of Slurm is needed.
    let arguments = [&slurm[..], &["--device=cuda"]].concat();
    let said = program::demand(command(&arguments, dir.path()).env("PATH", "/nowhere"), 0);
    assert_eq!(said.trim(), "runs/tiny/slurm/points.sbatch");
    let folder = dir.path().canonicalize().unwrap().join("runs/tiny");
    assert!(folder.join("slurm/log").is_dir(), "Slurm writes no log where there is no folder");
    let script = text(&folder.join("slurm/points.sbatch"));
    let lines: Vec<&str> = script.lines().collect();
    let starts = |start: &str| lines.iter().position(|line| line.starts_with(start));
    let directives: Vec<&str> = lines.iter().filter_map(|line| line.strip_prefix("#SBATCH ")).collect();
    for expected in [
        "--job-name=tiny",
        "--array=0-2",
        "--requeue",
        "--open-mode=append",
        "--signal=B:USR1@120",
        &format!("--output={}/slurm/log/%A_%a.out", folder.display()),
    ] {
        assert!(directives.contains(&expected), "{expected}: {directives:?}");
    }
    // Slurm reads no option behind the first command.
    assert!(starts("#SBATCH --signal").unwrap() < starts("points=(").unwrap());
    let run = format!("augnerf sweep run-point {} --device cuda \\", folder.display());
    assert!(lines.iter().any(|line| line.ends_with(&run)), "{script}");
}

/// Points that have ended are in no array, and a task keeps its point whatever numbers points get.
#[test]
fn the_script_names_the_points_that_are_left() {
    let dir = workplace(TINY);
    let dir = dir.path();
    let slurm = |further: &[&str]| demand(&[&["sweep", "slurm", "tiny.toml"], further].concat(), dir, 0);
    let named = || {
        let script = text(&dir.join("runs/tiny/slurm/points.sbatch"));
        let lines = script.lines().skip_while(|line| *line != "points=(").skip(1);
        lines.take_while(|line| *line != ")").map(|line| line.trim().to_string()).collect::<Vec<_>>()
    };
    assert_says(&slurm(&[]), &["3 of 3 points", "sbatch runs/tiny/slurm/points.sbatch", "sweep collect"]);
    let all: Vec<String> =
        points(dir).iter().map(|point| point.file_name().unwrap().to_str().unwrap().to_string()).collect();
    assert_eq!(named(), all);
    demand(&point("0"), dir, 0);
    demand(&point("1"), dir, 7);
    assert_says(&slurm(&[]), &["1 of 3 points"]);
    assert_eq!(named(), all[2..]);
    slurm(&["--retry-failed"]);
    assert_eq!(named(), all[1..]);
    demand(&point("2"), dir, 0);
    assert_says(&slurm(&[]), &["no script: of 3 points", "--retry-failed", "sweep collect"]);
    let other = TINY.replace("1e30", "2e30");
    std::fs::write(dir.join("tiny.toml"), other).unwrap();
    assert_says(&demand(&["sweep", "slurm", "tiny.toml"], dir, 2), &["another definition", "--extend"]);
}

#[test]
fn what_slurm_cannot_take_is_refused_in_a_sentence() {
    let dir = workplace(TINY);
    let submit =
        |further: &[&str], code| demand(&[&["sweep", "slurm", "tiny.toml"], further].concat(), dir.path(), code);
    assert_says(&submit(&["--out", "it's"], 2), &["quotes", "--out"]);
    // Every task would end with it. Whether a CUDA is there, this machine does not know.
    assert_says(&submit(&["--device", "cudaa"], 2), &["device cudaa", "cuda:N"]);
    submit(&["--device", "cuda:1"], 0);
    submit(&["--device", "gpu:1"], 0);
    let seconds = TINY.to_string()
        + "\n[[row]]\nname = \"equal\"\nset = { \"regularizer.kind\" = \"tv\" }\nbudget = { kind = \"seconds\", like = \"NeRF\" }\n";
    std::fs::write(dir.path().join("tiny.toml"), seconds).unwrap();
    assert_says(&submit(&["--name", "timed"], 2), &["budgets in seconds", "augnerf sweep run FILE --create"]);
}

/// The script as Slurm starts it: `task` of job 12, of which the queue says `state`.
fn task(cluster: &Cluster, dir: &Path, task: &str, state: &str) -> Command {
    cluster.says(state);
    let path = format!("{}:{}", cluster.bin.path().display(), std::env::var("PATH").unwrap());
    let mut bash = Command::new("bash");
    bash.arg("runs/tiny/slurm/points.sbatch").current_dir(dir).env("PATH", path);
    bash.env("SLURM_ARRAY_JOB_ID", "12").env("SLURM_ARRAY_TASK_ID", task);
    bash.env_remove("AUGNERF_LPIPS_WEIGHTS").env_remove("AUGNERF_DATA");
    bash
}

#[test]
fn the_script_puts_back_what_was_stopped_and_nothing_else() {
    let (dir, cluster) = (workplace(&long().replace("2000", "1000")), Cluster::new());
    let dir = dir.path();
    demand(&["sweep", "slurm", "tiny.toml", "--quiet"], dir, 0);
    let requeued = || cluster.calls().iter().filter(|call| *call == "scontrol requeue 12_0").count();
    let own = points(dir)[0].clone();
    // Preempted, cancelled by somebody, killed for memory, in turn; then left alone.
    for (turn, (how, state, code, put_back)) in
        [("-TERM", "RUNNING", 143, 1), ("-USR1", "COMPLETING", 143, 1), ("-KILL", "RUNNING", 137, 2)]
            .into_iter()
            .enumerate()
    {
        let before = std::fs::read_to_string(own.join("run/scalars.csv")).unwrap_or_default().lines().count();
        let child = task(&cluster, dir, "0", state).stderr(Stdio::piped()).spawn().unwrap();
        wait_for("steps", || {
            let text = std::fs::read_to_string(own.join("run/scalars.csv")).unwrap_or_default();
            own.join("claim.json").exists() && text.lines().count() > before.max(2)
        });
        match how {
            "-KILL" => {
                let pid = json(&own.join("claim.json"))["pid"].to_string();
                Command::new("kill").args([how, &pid]).status().unwrap();
            }
            _ => signal(&child, how),
        }
        let output = child.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{turn}: {said}");
        assert_eq!(requeued(), put_back, "{turn}: {said}");
    }
    program::demand(&mut task(&cluster, dir, "0", "RUNNING"), 0);
    assert!(own.join("result.json").exists());
    // What fails would fail again.
    let said = program::demand(&mut task(&cluster, dir, "1", "RUNNING"), 7);
    assert_says(&said, &["broken", "not a number"]);
    program::demand(&mut task(&cluster, dir, "9", "RUNNING"), 2);
    assert_eq!(requeued(), 2);
}
