//! What kills, damage, full disks and read-only ones do to runs, through the program.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::common::assert_says;
use crate::common::files::{assert_same_files, entries, text};
use crate::common::program::{augnerf, demand, run, succeed, wait_for};
use tempfile::TempDir;

/// Of a run, what need not repeat: clocks, locks and event files.
const FLEETING: [&str; 2] = ["timing.json", "run.lock"];

/// Settings of a run of a second, with a checkpoint every 10 steps of 30, all of which are kept.
const TINY: [&str; 9] = [
    "data.width=16",
    "field.width=16",
    "sampling.coarse=8",
    "sampling.fine=8",
    "train.rays=64",
    "train.steps=30",
    "train.checkpoint_every=10",
    "train.keep_checkpoints=3",
    "eval.pictures=0",
];

fn arguments<'a>(out: &'a Path, further: &[&'a str]) -> Vec<&'a str> {
    let set = TINY.iter().chain(further).flat_map(|setting| ["--set", setting]);
    ["train", "--quiet", "--preset", "smoke", "--out", out.to_str().unwrap()].into_iter().chain(set).collect()
}

fn trained(dir: &TempDir) -> PathBuf {
    let out = dir.path().join("run");
    succeed(&arguments(&out, &[]));
    out
}

fn checkpoint(run: &Path, step: u64) -> PathBuf {
    run.join(format!("checkpoints/step_{step:09}"))
}

fn flip_a_bit(path: &Path, at: usize) {
    let mut bytes = std::fs::read(path).unwrap();
    bytes[at] ^= 1;
    std::fs::write(path, bytes).unwrap();
}

/// One bit in the middle of a weight: any file reader would take it.
#[test]
fn a_flipped_bit_in_a_checkpoint_is_refused_and_resume_goes_back() {
    let dir = TempDir::new().unwrap();
    let out = trained(&dir);
    let kept = dir.path().join("kept");
    succeed(&["eval", "--quiet", out.to_str().unwrap()]);
    copy(&out, &kept);
    for file in ["state.safetensors", "state.json", "SHA256SUMS"] {
        let path = checkpoint(&out, 30).join(file);
        let length = std::fs::metadata(&path).unwrap().len() as usize;
        // In a weight, a counter, and the sum of the weights.
        flip_a_bit(&path, if file == "SHA256SUMS" { 3 } else { length - 9 });
        let message = demand(&mut augnerf(&["eval", out.to_str().unwrap()]), 5);
        assert_says(&message, &["step_000000030", "SHA256SUMS", "augnerf resume"]);
        let message = demand(&mut augnerf(&["resume", out.to_str().unwrap()]), 0);
        assert_says(&message, &["step_000000030 is damaged", "resumes from", "step_000000020"]);
        assert_same_files(&kept, &out, &FLEETING);
    }
    // What a kill of an earlier version left: a folder half-deleted.
    std::fs::remove_file(checkpoint(&out, 30).join("state.json")).unwrap();
    std::fs::write(checkpoint(&out, 20).join("state.safetensors"), "half").unwrap();
    let message = demand(&mut augnerf(&["resume", out.to_str().unwrap()]), 0);
    assert_says(
        &message,
        &["step_000000030 is damaged (state.json: it is missing)", "step_000000020", "step_000000010"],
    );
    assert_same_files(&kept, &out, &FLEETING);
    for folder in entries(&out.join("checkpoints")) {
        std::fs::remove_file(folder.join("state.json")).unwrap();
    }
    let message = demand(&mut augnerf(&["resume", out.to_str().unwrap()]), 5);
    assert_says(&message, &["no checkpoint", "step_000000030", "from the first step"]);
    assert_eq!(entries(&out.join("checkpoints")).len(), 3, "what is left of them stays");
}

/// Killed after its last checkpoint was written and before the one that it replaces was deleted.
#[test]
fn a_checkpoint_that_was_replaced_is_gone_when_a_run_ends() {
    let dir = TempDir::new().unwrap();
    let (out, kept) = (dir.path().join("run"), dir.path().join("kept"));
    succeed(&arguments(&out, &["train.keep_checkpoints=1"]));
    copy(&out, &kept);
    copy(&checkpoint(&out, 30), &checkpoint(&out, 20));
    succeed(&["resume", "--quiet", out.to_str().unwrap()]);
    assert_same_files(&kept, &out, &FLEETING);
}

fn copy(from: &Path, to: &Path) {
    assert!(Command::new("cp").args(["-r".as_ref(), from.as_os_str(), to.as_os_str()]).status().unwrap().success());
}

/// Nor is one without checksums, or one of a wrong step.
#[test]
fn a_checkpoint_without_checksums_or_of_another_step_is_damaged() {
    let dir = TempDir::new().unwrap();
    let out = trained(&dir);
    std::fs::remove_file(checkpoint(&out, 30).join("SHA256SUMS")).unwrap();
    std::fs::rename(checkpoint(&out, 10), checkpoint(&out, 90)).unwrap();
    let message = demand(&mut augnerf(&["resume", out.to_str().unwrap()]), 0);
    assert_says(&message, &["step_000000090 is damaged (state.json: it belongs to step 10)"]);
    assert_says(&message, &["step_000000030 is damaged", "SHA256SUMS is missing", "step_000000020"]);
}

/// As `sha256sum -c` reads them.
#[test]
fn checksums_are_those_of_the_files() {
    let dir = TempDir::new().unwrap();
    let folder = checkpoint(&trained(&dir), 30);
    let lines = text(&folder.join("SHA256SUMS"));
    assert_eq!(lines.lines().count(), 3);
    let Ok(output) = Command::new("sha256sum").args(["-c", "SHA256SUMS"]).current_dir(&folder).output() else { return };
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn settings_that_toml_cannot_hold_are_refused_in_a_run_s_folder() {
    let dir = TempDir::new().unwrap();
    let out = trained(&dir);
    let config = out.join("config.toml");
    let before = text(&config);
    let line = before.lines().find(|line| line.starts_with("collapse_steps")).unwrap();
    std::fs::write(&config, before.replace(line, "collapse_steps = 18446744073709551615")).unwrap();
    for command in ["eval", "resume", "render", "mesh"] {
        let message = demand(&mut augnerf(&[command, out.to_str().unwrap()]), 2);
        assert_says(&message, &["collapse_steps", "18446744073709551615", "at most 2^63 - 1"]);
    }
}

/// A result that nobody gets is an error, of every command that prints one.
#[cfg(target_os = "linux")]
#[test]
#[ignore = "slow"]
fn a_full_standard_output_is_an_error() {
    let dir = TempDir::new().unwrap();
    let out = trained(&dir);
    let out = out.to_str().unwrap();
    let sweep = dir.path().join("tiny.toml");
    let rows = "title = \"t\"\npreset = \"smoke\"\nscenes = [\"builtin\"]\nseeds = [0]\n[[row]]\nname = \"NeRF\"\n";
    std::fs::write(&sweep, format!("{rows}[set]\n\"train.steps\" = 2\n\"data.width\" = 16\n\"train.rays\" = 16\n"))
        .unwrap();
    let sweep = sweep.to_str().unwrap();
    let folder = dir.path().join("sweep");
    let folder = folder.to_str().unwrap();
    succeed(&["sweep", "run", sweep, "--out", folder, "--quiet"]);
    let exported = dir.path().join("scene");
    let commands: Vec<Vec<&str>> = vec![
        vec!["eval", "--smoothness", out, "--lattice", "4"],
        vec!["eval", out],
        vec!["mesh", "builtin", "--chamfer", "builtin", "--points", "100"],
        vec!["sweep", "collect", folder],
        vec!["sweep", "status", folder],
        vec!["sweep", "plan", sweep, "--out", folder],
        vec!["sweep", "run", sweep, "--out", folder],
        vec!["data", "check"],
        vec!["data", "export-builtin", exported.to_str().unwrap(), "--width", "16"],
        vec!["train", "--preset", "smoke", "--print-config"],
        vec!["settings"],
        vec!["train", "--balance=1", "--preset", "smoke", "--set", "data.width=16", "--set", "train.rays=16"],
        vec!["bench", "--rays", "8", "--coarse", "4", "--fine", "4", "--width", "8", "--steps", "1"],
        vec!["--help"],
        vec!["--version"],
        vec!["train", "--help"],
    ];
    for arguments in commands {
        let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
        let message = demand(augnerf(&arguments).stdout(full).stderr(Stdio::piped()), 4);
        assert_says(&message, &["standard output", "No space left"]);
        // A reader that has seen enough is none.
        let mut child = augnerf(&arguments).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        drop(child.stdout.take());
        if arguments[1..].first() != Some(&"export-builtin") {
            assert_eq!(child.wait().unwrap().code(), Some(0), "{arguments:?}");
        } else {
            child.wait().unwrap();
        }
    }
}

/// Each waits for the one before it: none deletes what another writes.
#[test]
fn many_collect_one_sweep_at_once() {
    let dir = TempDir::new().unwrap();
    let (folder, definition) = (dir.path().join("sweep"), dir.path().join("tiny.toml"));
    let rows = "title = \"t\"\npreset = \"smoke\"\nscenes = [\"builtin\"]\nseeds = [0, 1]\n[[row]]\nname = \"NeRF\"\n";
    std::fs::write(
        &definition,
        format!("{rows}[set]\n\"train.steps\" = 2\n\"data.width\" = 16\n\"train.rays\" = 16\n"),
    )
    .unwrap();
    let (folder, definition) = (folder.to_str().unwrap(), definition.to_str().unwrap());
    succeed(&["sweep", "run", definition, "--out", folder, "--quiet"]);
    succeed(&["sweep", "collect", folder]);
    let results = Path::new(folder).join("results");
    let before = crate::common::files::files(&results, &[]);
    // What one that was killed left.
    std::fs::write(results.join(".augnerf-tmp-1-0-table.md"), "half").unwrap();
    let collect =
        || augnerf(&["sweep", "collect", folder]).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let running: Vec<_> = (0..30).map(|_| collect()).collect();
    for child in running {
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    assert!(crate::common::files::files(&results, &[]) == before, "the same files with the same bytes");
}

/// Runs of a step that takes minutes: the first signal is heard and acts within it.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[test]
fn a_signal_acts_within_a_long_step() {
    let dir = TempDir::new().unwrap();
    for (signal, code) in [("-TERM", 143), ("-INT", 130), ("-HUP", 129)] {
        let out = dir.path().join(signal);
        let long = ["regularizer.kind=tv", "regularizer.points=full", "regularizer.lattice=200", "train.steps=2"];
        let mut command = augnerf(&arguments(&out, &long));
        heed_hangups(&mut command);
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        wait_for("a step", || {
            assert!(child.try_wait().unwrap().is_none(), "it ended before a step");
            out.join("scalars.csv").is_file()
        });
        std::thread::sleep(Duration::from_millis(300));
        // As `timeout` does, which signals its child and then their group.
        for _ in 0..2 {
            Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap();
        }
        let output = child.wait_with_output().unwrap();
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{message}");
        assert_eq!(std::fs::read_dir(out.join("checkpoints")).unwrap().count(), 1, "{message}");
        // It left the step, and did not wait for its end.
        assert_says(&message, &["stopping with a checkpoint", "at step 0", "augnerf resume"]);
    }
}

/// Takes back what `nohup` asks for, under which these tests may run.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn heed_hangups(command: &mut Command) {
    use std::os::unix::process::CommandExt;
    // SAFETY: `signal` may be called between fork and exec, and with these arguments changes this process alone.
    unsafe {
        command.pre_exec(|| match libc::signal(libc::SIGHUP, libc::SIG_DFL) {
            libc::SIG_ERR => Err(std::io::Error::last_os_error()),
            _ => Ok(()),
        });
    }
}

/// `nohup` asks that a hangup be ignored.
#[cfg(target_os = "linux")]
#[test]
fn a_hangup_that_is_ignored_stays_so() {
    let dir = TempDir::new().unwrap();
    let out = dir.path().join("run");
    let program = env!("CARGO_BIN_EXE_augnerf");
    let set = ["train.steps=4000", "train.checkpoint_every=1000"];
    let mut command = Command::new("sh");
    command.args(["-c", "trap '' HUP; exec \"$@\"", "sh", program]).args(arguments(&out, &set));
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    wait_for("a step", || out.join("scalars.csv").exists());
    Command::new("kill").args(["-HUP", &child.id().to_string()]).status().unwrap();
    std::thread::sleep(Duration::from_millis(200));
    assert!(child.try_wait().unwrap().is_none(), "it was stopped");
    child.kill().unwrap();
    child.wait().unwrap();
}

/// A whole lattice of 1024 cells a side in each step would take hours, and says so.
#[test]
fn a_step_that_would_take_hours_is_refused() {
    let network = ["field.width=512", "field.depth=8"];
    let full = [&["regularizer.kind=tv", "regularizer.points=full", "regularizer.lattice=1024"], &network[..]].concat();
    let dir = TempDir::new().unwrap();
    let message = demand(&mut augnerf(&arguments(&dir.path().join("run"), &full)), 2);
    assert_says(&message, &["regularizer.lattice = 1024", "s per step here", "10 minutes", "sampled"]);
}

/// The program as somebody who may read the folder but not write into it.
#[cfg(unix)]
fn as_reader(arguments: &[&str]) -> Command {
    use std::os::unix::process::CommandExt;
    let mut command = augnerf(arguments);
    if nobody_is_needed() {
        command.uid(65534).gid(65534);
    }
    command
}

/// Whether this test can write everywhere, as root can.
#[cfg(unix)]
fn nobody_is_needed() -> bool {
    let output = Command::new("id").arg("-u").output().unwrap();
    output.stdout == b"0\n"
}

#[cfg(unix)]
#[test]
fn runs_that_cannot_be_written_are_measured_and_shown() {
    use std::os::unix::fs::PermissionsExt;
    let dir = TempDir::new().unwrap();
    let (out, elsewhere) = (trained(&dir), dir.path().join("elsewhere"));
    std::fs::create_dir(&elsewhere).unwrap();
    let mode = |path: &Path, mode: u32| std::fs::set_permissions(path, PermissionsExt::from_mode(mode)).unwrap();
    mode(dir.path(), 0o755);
    mode(&elsewhere, 0o777);
    let all = |file: &str| assert!(Command::new("chmod").args(["-R", file]).arg(&out).status().unwrap().success());
    all("a-w,a+rX");
    let run = out.to_str().unwrap();
    let place = |name: &str| elsewhere.join(name).to_str().unwrap().to_string();
    let before = crate::common::files::files(&out, &[]);
    let message = demand(&mut as_reader(&["eval", "--smoothness", run, "--lattice", "4"]), 0);
    assert_says(&message, &["laplacian", "read-only", "smoothness.csv"]);
    let message = demand(&mut as_reader(&["eval", run]), 4);
    assert_says(&message, &["read-only", "--out"]);
    demand(&mut as_reader(&["eval", run, "--out", &place("metrics")]), 0);
    for name in ["metrics.json", "metrics.csv"] {
        assert_eq!(text(&elsewhere.join("metrics").join(name)), text(&out.join(name)));
    }
    for (command, further) in
        [("render", vec!["--what", "views"]), ("mesh", vec!["--resolution", "8", "--threshold", "0.01"])]
    {
        let arguments = [vec![command, run], further].concat();
        let message = demand(&mut as_reader(&arguments), 4);
        assert_says(&message, &["cannot write", "--out"]);
        let made = place(command);
        demand(&mut as_reader(&[arguments, vec!["--out", &made]].concat()), 0);
        assert!(!entries(Path::new(&made)).is_empty());
    }
    let (twin, compared) = (dir.path().join("twin"), place("compare"));
    copy(&out, &twin);
    all("a-w");
    demand(&mut as_reader(&["compare", run, twin.to_str().unwrap(), "--out", &compared]), 0);
    assert!(before == crate::common::files::files(&out, &[]), "nothing was written into the run");
    all("u+w");
}

/// Of commands that write a folder beside the run, too.
#[test]
fn leftovers_of_killed_commands_go_at_the_next_start() {
    let dir = TempDir::new().unwrap();
    let out = trained(&dir);
    let checkpoints = out.join("checkpoints");
    for leftover in [
        dir.path().join(".augnerf-tmp-pictures.x0"),
        checkpoints.join(".augnerf-tmp-step_000000010.x1"),
        out.join("renders/.augnerf-tmp-path.x2"),
    ] {
        std::fs::create_dir(&leftover).unwrap();
        std::fs::write(leftover.join("file"), "half").unwrap();
    }
    let pictures = dir.path().join("pictures");
    let run_folder = out.to_str().unwrap();
    assert!(run(&["render", run_folder, "--what", "views", "--out", pictures.to_str().unwrap()]).status.success());
    assert_eq!(entries(dir.path()), [pictures, out.clone()]);
    assert_eq!(entries(&checkpoints).len(), 3);
    assert!(entries(&out.join("renders")).is_empty());
}

/// A shell with job control keeps the terminal for itself while a program is in the background: no bar is drawn over what is
/// typed there.
#[cfg(unix)]
#[test]
fn a_program_in_the_background_draws_no_bars() {
    if Command::new("script").arg("--version").output().is_err() {
        eprintln!("left out: no script (util-linux) is here to make a terminal");
        return;
    }
    let dir = TempDir::new().unwrap();
    let said = |name: &str, after: &str| {
        let out = dir.path().join(name);
        let small = "--preset smoke --set train.steps=40 --set data.width=16 --set field.width=16 --set train.rays=64";
        let shell = format!("set -m; {} train {small} --out {} {after}", env!("CARGO_BIN_EXE_augnerf"), out.display());
        let mut script = Command::new("script");
        script.args(["-qec", &shell, "/dev/null"]).env("SHELL", "/bin/sh").env("TERM", "xterm").current_dir(dir.path());
        let said = demand(&mut script, 0);
        assert_says(&said, &["held-out views: PSNR"]);
        said.matches("rays/s").count()
    };
    assert_eq!((said("foreground", "") > 0, said("background", "& wait")), (true, 0));
}
