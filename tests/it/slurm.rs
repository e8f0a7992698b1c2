//! `sweep run-point`, and the script of `sweep slurm` without Slurm: two of its commands are stood in for by scripts that
//! write down how they were called. `slurm_jobs.rs` has the real one.

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::LazyLock;
use std::time::SystemTime;

use crate::common::assert_says;
use crate::common::files::{assert_same_files, entries, json, text};
use crate::common::program::{Place, demand, tiny_sweep, wait_for};

/// Three points of a second; the second one fails.
pub static TINY: LazyLock<String> = LazyLock::new(|| {
    let settings = "train.chunk=32 train.steps=30 train.checkpoint_every=10 eval.pictures=0";
    let calibrated = "method = \"aug-nerf\", \"perturb.attack\" = \"calibrated\"";
    let rows = [("broken", "\"train.learning_rate\" = 1e30"), ("Aug-NeRF", calibrated)];
    tiny_sweep(&[0], &["psnr"], settings, &rows)
});

/// The same with steps enough to be interrupted in.
fn long() -> String {
    let steps = TINY.replace("\"train.steps\" = 30", "\"train.steps\" = 2000");
    steps.replace("\"train.checkpoint_every\" = 10", "\"train.checkpoint_every\" = 50")
}

fn workplace(definition: &str) -> Place {
    Place::with("tiny.toml", definition)
}

fn point(index: u32) -> String {
    format!("sweep run-point runs/tiny --threads=1 --index {index}")
}

fn signal(child: &Child, signal: &str) {
    assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
}

/// The points' folders, in the order of their numbers.
pub fn points(place: &Place) -> Vec<PathBuf> {
    let folder = place.at("runs/tiny");
    let ids = json(&folder.join("points.json"))["points"].as_array().unwrap().clone();
    ids.iter().map(|point| folder.join("points").join(point["id"].as_str().unwrap())).collect()
}

fn in_training(point: &Path) -> bool {
    std::fs::read_to_string(point.join("run/scalars.csv")).is_ok_and(|text| text.lines().count() > 2)
}

#[test]
fn points_that_are_run_one_by_one_make_the_tables_of_a_sweep() {
    let (whole, place) = (workplace(&TINY), workplace(&TINY));
    whole.run("sweep run tiny.toml --quiet", 7);
    place.says("sweep run --create tiny.toml", 0, &["runs/tiny: 3 points", "0 to 2", "run-point"]);
    assert_eq!(entries(&place.at("runs/tiny/points")).len(), 0, "nothing was run");
    place.run(&point(2), 0);
    let name = points(&place)[0].file_name().unwrap().to_str().unwrap().to_string();
    place.says(&format!("sweep run-point runs/tiny --id {}", &name[..8]), 0, &["done: NeRF · builtin · seed 0"]);
    place.says(&point(1), 7, &["broken · builtin · seed 0 failed", "--retry-failed", "not a number"]);
    // What has ended is not done again.
    let is_end = |file: &PathBuf| file.ends_with("result.json") || file.ends_with("failed.json");
    let ends = || -> Vec<SystemTime> {
        let files = points(&place).into_iter().map(|point| entries(&point).into_iter().find(is_end).unwrap());
        files.map(|file| file.metadata().unwrap().modified().unwrap()).collect()
    };
    let ended = ends();
    place.says(&point(0), 0, &["was already done"]);
    place.run(&point(1), 7);
    assert_eq!(ends(), ended);
    place.run(&format!("{} --retry-failed", point(1)), 7);
    place.run("sweep collect runs/tiny", 7);
    assert_same_files(&whole.at("results/tiny"), &place.at("results/tiny"), &["timing.csv"]);
}

#[test]
fn a_point_that_is_not_there_is_refused() {
    let place = workplace(&TINY);
    place.says(&point(0), 5, &["runs/tiny", "points.json"]);
    place.run("sweep run --create tiny.toml", 0);
    place.says(&point(3), 2, &["--index 3", "3 points, choose 0 to 2"]);
    place.says("sweep run-point runs/tiny --id zz", 2, &["--id 'zz'", "sweep status"]);
    place.says("sweep run-point runs/tiny --id ''", 2, &["--id ''"]);
    place.run("sweep run-point runs/tiny", 2);
    place.run(&format!("{} --id 1", point(0)), 2);
    let away = place.run("sweep run --create tiny.toml --scenes orchids --out away", 0);
    assert_says(&away, &["away: 3 points"]);
    place.says("sweep run-point away --index 0", 8, &["no data here", "orchids", "AUGNERF_DATA"]);
}

/// As a scheduler sends them: to the script and to the program, several at once.
#[test]
fn signals_of_a_scheduler_stop_a_point_with_a_checkpoint_however_many_come() {
    let shorter = long().replace("2000", "1000");
    let (whole, place) = (workplace(&shorter), workplace(&shorter));
    for begun in [&whole, &place] {
        begun.run("sweep run --create tiny.toml --quiet", 0);
    }
    let own = points(&place)[0].clone();
    let child = place.command(&point(0)).stderr(Stdio::piped()).spawn().unwrap();
    wait_for("a step", || in_training(&own));
    for name in ["-USR1", "-TERM", "-USR1", "-TERM"] {
        signal(&child, name);
    }
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(143), "{said}");
    assert_says(&said, &["stopping with a checkpoint", "signal 15"]);
    assert!(!own.join("claim.json").exists() && !own.join("result.json").exists());
    place.run(&point(0), 0);
    whole.run(&point(0), 0);
    assert_eq!(json(&own.join("run/timing.json"))["sessions"], 2);
    assert_same_files(&points(&whole)[0], &own, &["run/timing.json", "run/run.lock"]);
}

#[test]
fn a_point_that_another_runner_works_on_is_left_to_it() {
    let place = workplace(&long());
    place.run("sweep run --create tiny.toml", 0);
    let own = points(&place)[0].clone();
    let mut child = place.command(&point(0)).stderr(Stdio::null()).spawn().unwrap();
    wait_for("a step", || in_training(&own));
    place.says(&point(0), 0, &["is skipped", &format!("process {}", child.id())]);
    assert!(child.try_wait().unwrap().is_none(), "the other one goes on");
    child.kill().unwrap();
    child.wait().unwrap();
}

/// Slurm's commands that the script calls, in a folder of their own; each call is written down.
fn cluster() -> Place {
    let bin = Place::with("calls", "");
    for (name, body) in [("squeue", "cat \"$here/queue\""), ("scontrol", "echo \"scontrol $*\" >> \"$here/calls\"")] {
        bin.write(name, format!("#!/bin/sh\nhere={}\n{body}\n", bin.path().display()));
        std::fs::set_permissions(bin.at(name), std::fs::Permissions::from_mode(0o755)).unwrap();
    }
    bin
}

#[test]
fn the_script_has_what_slurm_needs() {
    let place = workplace(&TINY);
    // No command of Slurm is needed.
    let mut slurm = place.command("sweep slurm tiny.toml --quiet --device=cuda");
    let said = demand(slurm.env("PATH", "/nowhere"), 0);
    assert_eq!(said.trim(), "runs/tiny/slurm/points.sbatch");
    let folder = place.path().canonicalize().unwrap().join("runs/tiny");
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
    let place = workplace(&TINY);
    let slurm = |further: &str| place.run(&format!("sweep slurm tiny.toml {further}"), 0);
    let named = || {
        let script = place.text("runs/tiny/slurm/points.sbatch");
        let lines = script.lines().skip_while(|line| *line != "points=(").skip(1);
        lines.take_while(|line| *line != ")").map(|line| line.trim().to_string()).collect::<Vec<_>>()
    };
    assert_says(&slurm(""), &["3 of 3 points", "sbatch runs/tiny/slurm/points.sbatch", "sweep collect"]);
    let all: Vec<String> =
        points(&place).iter().map(|point| point.file_name().unwrap().to_str().unwrap().to_string()).collect();
    assert_eq!(named(), all);
    place.run(&point(0), 0);
    place.run(&point(1), 7);
    assert_says(&slurm(""), &["1 of 3 points"]);
    assert_eq!(named(), all[2..]);
    slurm("--retry-failed");
    assert_eq!(named(), all[1..]);
    place.run(&point(2), 0);
    assert_says(&slurm(""), &["no script: of 3 points", "--retry-failed", "sweep collect"]);
    place.write("tiny.toml", TINY.replace("1e30", "2e30"));
    place.says("sweep slurm tiny.toml", 2, &["another definition", "--extend"]);
}

#[test]
fn what_slurm_cannot_take_is_refused_in_a_sentence() {
    let place = workplace(&TINY);
    let submit = |further: &str, code| place.run(&format!("sweep slurm tiny.toml {further}"), code);
    assert_says(&demand(place.command("sweep slurm tiny.toml --out").arg("it's"), 2), &["quotes", "--out"]);
    // Every task would end with it. Whether a CUDA is there, this machine does not know.
    assert_says(&submit("--device cudaa", 2), &["device cudaa", "cuda:N"]);
    submit("--device cuda:1", 0);
    submit("--device gpu:1", 0);
    let half = "--set field.precision=f16 --name half";
    assert_says(&submit(half, 2), &["field.precision", "--device gpu"]);
    submit(&format!("{half} --device gpu"), 0);
    let seconds = TINY.to_string()
        + "\n[[row]]\nname = \"equal\"\nset = { \"regularizer.kind\" = \"tv\" }\nbudget = { kind = \"seconds\", like = \"NeRF\" }\n";
    place.write("tiny.toml", seconds);
    assert_says(&submit("--name timed", 2), &["budgets in seconds", "augnerf sweep run FILE --create"]);
}

/// The script as Slurm starts it: `task` of job 12, of which the queue says `state`.
fn task(cluster: &Place, place: &Place, task: &str, state: &str) -> Command {
    cluster.write("queue", state);
    let path = format!("{}:{}", cluster.path().display(), std::env::var("PATH").unwrap());
    let mut bash = Command::new("bash");
    bash.arg("runs/tiny/slurm/points.sbatch").current_dir(place.path()).env("PATH", path);
    bash.env("SLURM_ARRAY_JOB_ID", "12").env("SLURM_ARRAY_TASK_ID", task);
    bash.env_remove("AUGNERF_LPIPS_WEIGHTS").env_remove("AUGNERF_DATA");
    bash
}

#[test]
fn the_script_puts_back_what_was_stopped_and_nothing_else() {
    let (place, cluster) = (workplace(&long().replace("2000", "1000")), cluster());
    place.run("sweep slurm tiny.toml --quiet", 0);
    let requeued = || cluster.text("calls").lines().filter(|call| *call == "scontrol requeue 12_0").count();
    let own = points(&place)[0].clone();
    // Preempted, cancelled by somebody, killed for memory, in turn; then left alone.
    let logged = || std::fs::read_to_string(own.join("run/scalars.csv")).unwrap_or_default().lines().count();
    for (how, state, code, put_back) in
        [("-TERM", "RUNNING", 143, 1), ("-USR1", "COMPLETING", 143, 1), ("-KILL", "RUNNING", 137, 2)]
    {
        let before = logged().max(2);
        let child = task(&cluster, &place, "0", state).stderr(Stdio::piped()).spawn().unwrap();
        wait_for("steps", || own.join("claim.json").exists() && logged() > before);
        match how {
            "-KILL" => {
                let pid = json(&own.join("claim.json"))["pid"].to_string();
                Command::new("kill").args([how, &pid]).status().unwrap();
            }
            _ => signal(&child, how),
        }
        let output = child.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!((output.status.code(), requeued()), (Some(code), put_back), "{how}: {said}");
    }
    demand(&mut task(&cluster, &place, "0", "RUNNING"), 0);
    assert!(own.join("result.json").exists());
    // What fails would fail again.
    let said = demand(&mut task(&cluster, &place, "1", "RUNNING"), 7);
    assert_says(&said, &["broken", "not a number"]);
    demand(&mut task(&cluster, &place, "9", "RUNNING"), 2);
    assert_eq!(requeued(), 2);
}
