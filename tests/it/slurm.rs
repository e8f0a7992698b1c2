//! `sweep run-point`, `submit`, `cancel` and the scripts that they make, without Slurm: its commands are stood in for by
//! scripts that write down how they were called. `slurm_jobs.rs` has the real one.

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
    let said = demand(&["sweep", "begin", "tiny.toml"], dir, 0);
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
    let said = demand(&[&point("0")[..], &["--max-deaths", "3"]].concat(), dir, 0);
    assert_says(&said, &["was already done", "--max-deaths does nothing"]);
    assert!(!demand(&["sweep", "run-point", "--help"], dir, 0).contains("max-deaths"));
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
    demand(&["sweep", "begin", "tiny.toml"], dir.path(), 0);
    assert_says(&demand(&point("3"), dir.path(), 2), &["--index 3", "3 points, choose 0 to 2"]);
    let by = |id| ["sweep", "run-point", "runs/tiny", "--id", id];
    assert_says(&demand(&by("zz"), dir.path(), 2), &["--id 'zz'", "sweep status"]);
    assert_says(&demand(&by(""), dir.path(), 2), &["--id ''"]);
    demand(&["sweep", "run-point", "runs/tiny"], dir.path(), 2);
    demand(&[&point("0")[..], &["--id", "1"]].concat(), dir.path(), 2);
    let away = demand(&["sweep", "begin", "tiny.toml", "--scenes", "orchids", "--out", "away"], dir.path(), 0);
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
        demand(&[&["sweep", "begin", "tiny.toml"][..], &first].concat(), dir, 0);
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
    assert_same_files(&points(whole.path())[0], &own, &["run/timing.json", "run/run.lock", "run/tensorboard"]);
}

#[test]
fn a_point_that_another_runner_works_on_is_left_to_it() {
    let dir = workplace(&long());
    demand(&["sweep", "begin", "tiny.toml"], dir.path(), 0);
    let own = points(dir.path())[0].clone();
    let mut child = command(&point("0"), dir.path()).stderr(Stdio::null()).spawn().unwrap();
    wait_for("a step", || in_training(&own));
    let said = demand(&point("0"), dir.path(), 0);
    assert_says(&said, &["is skipped", &format!("process {}", child.id())]);
    assert!(child.try_wait().unwrap().is_none(), "the other one goes on");
    child.kill().unwrap();
    child.wait().unwrap();
}

/// What Slurm's commands say, in a folder of its own; each call is written down.
struct Cluster {
    bin: TempDir,
}

impl Cluster {
    /// `squeue` says what is in `queue`, `sbatch` numbers jobs from 12 on.
    fn new() -> Cluster {
        let cluster = Cluster { bin: TempDir::new().unwrap() };
        std::fs::write(cluster.bin.path().join("queue"), "").unwrap();
        std::fs::write(cluster.bin.path().join("calls"), "").unwrap();
        cluster.stand_in("sbatch", "n=$(grep -c ^sbatch \"$here/calls\"); echo \"welcome\"; echo $((11 + n))");
        cluster.stand_in("squeue", "cat \"$here/queue\"");
        cluster.stand_in("scancel", "true");
        cluster.stand_in("scontrol", "true");
        cluster
    }

    fn stand_in(&self, name: &str, body: &str) {
        let path = self.bin.path().join(name);
        let text =
            format!("#!/bin/sh\nhere={}\necho \"{name} $*\" >> \"$here/calls\"\n{body}\n", self.bin.path().display());
        std::fs::write(&path, text).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    }

    fn queue(&self, lines: &str) {
        std::fs::write(self.bin.path().join("queue"), lines).unwrap();
    }

    /// What was called since the last time, but for questions.
    fn calls(&self) -> Vec<String> {
        let path = self.bin.path().join("calls");
        let calls = text(&path);
        calls.lines().filter(|call| !call.starts_with("squeue")).map(String::from).collect()
    }

    fn path(&self) -> String {
        format!("{}:{}", self.bin.path().display(), std::env::var("PATH").unwrap())
    }

    #[track_caller]
    fn demand(&self, arguments: &[&str], dir: &Path, code: i32) -> String {
        program::demand(command(arguments, dir).env("PATH", self.path()), code)
    }
}

#[test]
fn a_dry_run_prints_the_script_and_writes_nothing() {
    let dir = workplace(TINY);
    let submit = ["sweep", "submit", "tiny.toml", "--dry-run", "--quiet"];
    let asked = ["--partition=gpu", "--time=12:00:00", "--mem=8G", "--cpus=4", "--gres=gpu:1", "--array-limit=2"];
    let further = ["--device=cuda", "--sbatch=--account=lab", "--sbatch", "--qos=low"];
    // No command of Slurm is needed, and none is called.
    let arguments = [&submit[..], &asked, &further].concat();
    let said = program::demand(command(&arguments, dir.path()).env("PATH", "/nowhere"), 0);
    let folder = dir.path().canonicalize().unwrap().join("runs/tiny");
    let lines: Vec<&str> = said.lines().collect();
    let starts = |start: &str| lines.iter().position(|line| line.starts_with(start));
    let directives: Vec<&str> = lines.iter().filter_map(|line| line.strip_prefix("#SBATCH ")).collect();
    let (array, tables) = directives.split_at(directives.iter().position(|line| line.ends_with("-tables")).unwrap());
    for expected in [
        "--job-name=tiny",
        "--array=0-2%2",
        "--partition=gpu",
        "--time=12:00:00",
        "--mem=8G",
        "--cpus-per-task=4",
        "--gres=gpu:1",
        "--account=lab",
        "--qos=low",
        "--requeue",
        "--open-mode=append",
        "--signal=B:USR1@120",
    ] {
        assert!(array.contains(&expected), "{expected}: {array:?}");
    }
    assert!(array.contains(&format!("--output={}/slurm/log/%A_%a.out", folder.display()).as_str()), "{array:?}");
    for expected in ["--partition=gpu", "--account=lab", "--mem=8G"] {
        assert!(tables.contains(&expected), "{expected}: {tables:?}");
    }
    assert!(!tables.iter().any(|line| line.contains("gres") || line.contains("array")), "{tables:?}");
    // Slurm reads no option behind the first command.
    assert!(starts("#SBATCH --signal").unwrap() < starts("trap ").unwrap());
    let run = format!("augnerf sweep run-point {} --device cuda \\", folder.display());
    assert!(lines.iter().any(|line| line.ends_with(&run)), "{said}");
    let collect = format!(
        "augnerf sweep collect {} --results {}",
        folder.display(),
        dir.path().canonicalize().unwrap().join("results/tiny").display()
    );
    assert!(lines.iter().any(|line| line.ends_with(&collect)), "{said}");
    assert!(lines.last().unwrap().contains("3 of 3 points: 0-2"), "{said}");
    assert_eq!(entries(dir.path()).len(), 1, "only the sweep's file");
}

#[test]
fn what_slurm_cannot_take_is_refused_in_a_sentence() {
    let dir = workplace(TINY);
    let submit = |further: &[&str], code| {
        demand(&[&["sweep", "submit", "tiny.toml", "--dry-run"], further].concat(), dir.path(), code)
    };
    assert_says(&submit(&["--time", "soon"], 2), &["--time soon", "HOURS:MINUTES:SECONDS"]);
    assert_says(&submit(&["--time", "00:05:00"], 2), &["--time 00:05:00", "at least 10 minutes"]);
    assert_says(&submit(&["--partition", "a b"], 2), &["--partition", "spaces or line breaks"]);
    assert_says(&submit(&["--mem", "8G\n#SBATCH --begin=now"], 2), &["--mem", "line breaks"]);
    assert_says(&submit(&["--sbatch", "account=lab"], 2), &["--sbatch account=lab", "--sbatch=--account=lab"]);
    assert_says(&submit(&["--out", "it's"], 2), &["quotes", "--out"]);
    assert_says(&submit(&["--scheduler", "pbs"], 2), &["pbs", "slurm"]);
    // Every task would end with it. Whether a CUDA is there, this machine does not know.
    assert_says(&submit(&["--device", "cudaa"], 2), &["device cudaa", "cuda:N"]);
    assert_says(&submit(&["--device", "cuda:1"], 0), &["--device cuda:1"]);
    assert_says(&submit(&["--device", "gpu:1"], 0), &["--device gpu:1"]);
    let seconds = TINY.to_string()
        + "\n[[row]]\nname = \"equal\"\nset = { \"regularizer.kind\" = \"tv\" }\nbudget = { kind = \"seconds\", like = \"NeRF\" }\n";
    std::fs::write(dir.path().join("tiny.toml"), seconds).unwrap();
    assert_says(&submit(&[], 2), &["budgets in seconds", "augnerf sweep begin"]);
}

#[test]
fn without_sbatch_or_with_its_refusal_the_user_is_told_what_to_do() {
    let dir = workplace(TINY);
    let submit = ["sweep", "submit", "tiny.toml", "--quiet"];
    let said = program::demand(command(&submit, dir.path()).env("PATH", "/nowhere"), 2);
    assert_says(&said, &["cannot find `sbatch`", "login node", "augnerf sweep run-point"]);
    assert!(!dir.path().join("runs").exists(), "refused before anything is written");
    let cluster = Cluster::new();
    cluster.stand_in("sbatch", "echo 'sbatch: error: invalid partition specified: nowhere' >&2; exit 1");
    let said = cluster.demand(&submit, dir.path(), 2);
    assert_says(&said, &["sbatch rejected", "points.sbatch: invalid partition specified: nowhere"]);
    cluster.stand_in("sbatch", "echo Submitted");
    assert_says(&cluster.demand(&submit, dir.path(), 2), &["named no job", "Submitted"]);
    // The points are in the queue, what collects them is not.
    cluster.stand_in("sbatch", "case $* in *afterany*) echo 'sbatch: error: too many jobs' >&2; exit 1;; esac; echo 5");
    let said = cluster.demand(&submit, dir.path(), 2);
    assert_says(&said, &["job 5", "the job that collects was not", "too many jobs", "sweep collect"]);
    assert_eq!(json(&dir.path().join("runs/tiny/slurm/jobs.json"))["jobs"][0]["points"], "5");
    // Another sweep's folder.
    std::fs::write(dir.path().join("tiny.toml"), TINY.replace("1e30", "2e30")).unwrap();
    for further in [&[][..], &["--dry-run"]] {
        let said = cluster.demand(&[&submit[..], further].concat(), dir.path(), 2);
        assert_says(&said, &["another definition", "--extend"]);
    }
}

#[test]
fn submitted_points_are_seen_in_the_queue_and_not_submitted_twice() {
    let (dir, cluster) = (workplace(TINY), Cluster::new());
    let dir = dir.path();
    let submit = ["sweep", "submit", "tiny.toml"];
    demand(&["sweep", "begin", "tiny.toml"], dir, 0);
    demand(&point("0"), dir, 0);
    let said = cluster.demand(&[&submit[..], &["--array-limit", "1"]].concat(), dir, 0);
    assert_says(&said, &["2 of 3 points (1 done): 1-2", "job 12", "job 13", "results/tiny", "sweep status"]);
    assert!(said.ends_with("\n12\n"), "the number alone is printed: {said}");
    let folder = dir.canonicalize().unwrap().join("runs/tiny/slurm");
    let expected = [
        format!("sbatch --parsable {}", "runs/tiny/slurm/points.sbatch"),
        format!("sbatch --parsable --dependency=afterany:12 {}", "runs/tiny/slurm/tables.sbatch"),
    ];
    assert_eq!(cluster.calls(), expected);
    assert!(text(&folder.join("points.sbatch")).contains("#SBATCH --array=1-2%1\n"));

    cluster.queue("12|1|RUNNING|None\n12|2|PENDING|JobArrayTaskLimit\n13|N/A|PENDING|Dependency\n");
    let status = cluster.demand(&["sweep", "status", "runs/tiny"], dir, 11);
    let line = |word: &str| status.lines().find(|line| line.contains(word)).unwrap_or_else(|| panic!("{status}"));
    assert!(line("Aug-NeRF").ends_with("job 12_2 PENDING (JobArrayTaskLimit)"), "{status}");
    assert!(line("broken").ends_with("job 12_1 RUNNING") && line("done  ").contains("dB"), "{status}");
    assert_says(&status, &["tables: job 13 PENDING (Dependency)"]);
    let said = cluster.demand(&submit, dir, 0);
    assert_says(&said, &["nothing to submit", "1 done, 2 in the queue already"]);
    assert_eq!(cluster.calls().len(), 2, "nothing was submitted");
    let said = cluster.demand(&[&submit[..], &["--dry-run"]].concat(), dir, 0);
    assert!(said.contains("nothing to submit") && !said.contains("--array="), "{said}");
    let answer = |code: &str| -> serde_json::Value {
        serde_json::from_str(code.lines().find(|line| line.starts_with('{')).unwrap())
            .unwrap_or_else(|_| panic!("{code}"))
    };
    let status = answer(&cluster.demand(&["sweep", "status", "runs/tiny", "--json"], dir, 11));
    assert_eq!(status["tables"][0], "job 13 PENDING (Dependency)");
    assert!(status["queue_error"].is_null());
    // Running tasks know their points by numbers, which a row in front would give to others.
    let head = TINY.replacen("[[row]]", "[[row]]\nname = \"wide\"\nset = { \"field.width\" = 32 }\n\n[[row]]", 1);
    std::fs::write(dir.join("tiny.toml"), head).unwrap();
    let said = cluster.demand(&[&submit[..], &["--extend"]].concat(), dir, 2);
    assert_says(&said, &["tasks 1, 2", "sweep cancel"]);
    // Behind them it moves nothing.
    let last = "\n[[row]]\nname = \"wide\"\nset = { \"field.width\" = 32 }\n";
    std::fs::write(dir.join("tiny.toml"), TINY.to_string() + last).unwrap();
    let said = cluster.demand(&[&submit[..], &["--extend", "--dry-run"]].concat(), dir, 0);
    assert_says(&said, &["1 of 4 points", ": 3"]);
    std::fs::write(dir.join("tiny.toml"), TINY).unwrap();

    cluster.stand_in("scancel", "[ $1 != 13 ] || { echo 'Access denied' >&2; exit 1; }");
    let said = cluster.demand(&["sweep", "cancel", "runs/tiny"], dir, 2);
    assert_says(&said, &["scancel rejected job 13: Access denied"]);
    assert_eq!(cluster.calls()[2..], ["scancel 13", "scancel 12"], "one refusal keeps no other job in the queue");
    cluster.stand_in("scancel", "true");
    let said = cluster.demand(&["sweep", "cancel", "runs/tiny"], dir, 0);
    assert_says(&said, &["1 points of job 12 RUNNING", "1 points of job 12 PENDING", "1 tables of job 13"]);
    assert_eq!(cluster.calls()[4..], ["scancel 13", "scancel 12"]);
    cluster.queue("");
    assert_says(&cluster.demand(&["sweep", "cancel", "runs/tiny"], dir, 0), &["runs/tiny: nothing in the queue"]);
    // Without an answer, files still say how far the points are.
    cluster.stand_in("squeue", "echo 'slurm_load_jobs error: Unable to contact slurm controller' >&2; exit 1");
    let status = cluster.demand(&["sweep", "status", "runs/tiny"], dir, 11);
    assert_says(&status, &["queue not shown", "Unable to contact", "1 done, 2 waiting"]);
    let status = answer(&cluster.demand(&["sweep", "status", "runs/tiny", "--json"], dir, 11));
    assert!(status["queue_error"].as_str().unwrap().contains("Unable to contact"), "{status}");
    cluster.stand_in("squeue", "echo 'slurm_load_jobs error: Invalid job id specified' >&2; exit 1");
    let status = cluster.demand(&["sweep", "status", "runs/tiny"], dir, 11);
    assert_says(&status, &["2 waiting points are not in the queue", "augnerf sweep submit"]);
    assert!(!status.contains("not shown"), "{status}");
    std::fs::write(folder.join("jobs.json"), r#"{"jobs": [{"points": "1 --user=root", "tables": null}]}"#).unwrap();
    assert_says(
        &cluster.demand(&["sweep", "cancel", "runs/tiny"], dir, 5),
        &["jobs.json", "is not the number of a job"],
    );
}

/// The script as Slurm starts it: `task` of job 12, of which the queue says `state`.
fn task(cluster: &Cluster, dir: &Path, task: &str, state: &str) -> Command {
    cluster.queue(state);
    let mut bash = Command::new("bash");
    bash.arg("runs/tiny/slurm/points.sbatch").current_dir(dir).env("PATH", cluster.path());
    bash.env("SLURM_ARRAY_JOB_ID", "12").env("SLURM_ARRAY_TASK_ID", task);
    bash.env_remove("AUGNERF_LPIPS_WEIGHTS").env_remove("AUGNERF_DATA");
    bash
}

#[test]
fn the_script_puts_back_what_was_stopped_and_nothing_else() {
    let (dir, cluster) = (workplace(&long().replace("2000", "1000")), Cluster::new());
    let dir = dir.path();
    cluster.demand(&["sweep", "submit", "tiny.toml", "--quiet"], dir, 0);
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
