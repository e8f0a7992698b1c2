//! What kills, damage, full disks and read-only ones do to runs, through the program.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::common::assert_says;
use crate::common::files::{FLEETING, assert_same_files, copy, entries, files, text};
use crate::common::program::{Place, demand, set, signalled, tiny_sweep, wait_for};

/// Settings of a run of a second, with a checkpoint every 10 steps of 30, all of which are kept.
const TINY: &str = "data.width=16 field.width=16 sampling.coarse=8 sampling.fine=8 train.rays=64 train.steps=30 \
    train.checkpoint_every=10 train.keep_checkpoints=3 eval.pictures=0";

fn train(out: &str, further: &str) -> String {
    format!("train --quiet --preset smoke --out {out}{}{}", set(TINY), set(further))
}

/// A folder with a run in it.
fn trained() -> Place {
    Place::trained(&set(TINY))
}

fn checkpoint(step: u64) -> String {
    format!("run/checkpoints/step_{step:09}")
}

/// One bit in the middle of a weight: any file reader would take it.
#[test]
fn a_flipped_bit_in_a_checkpoint_is_refused_and_resume_goes_back() {
    let place = trained();
    let [run, kept] = ["run", "kept"].map(|name| place.at(name));
    place.run("eval --quiet run", 0);
    copy(&run, &kept);
    for file in ["state.safetensors", "state.json", "SHA256SUMS"] {
        let path = place.at(&checkpoint(30)).join(file);
        let mut bytes = std::fs::read(&path).unwrap();
        // In a weight, a counter, and the sum of the weights.
        let at = if file == "SHA256SUMS" { 3 } else { bytes.len() - 9 };
        bytes[at] ^= 1;
        std::fs::write(path, bytes).unwrap();
        place.says("eval run", 5, &["step_000000030", "SHA256SUMS", "augnerf resume"]);
        let words = ["step_000000030 is damaged", "resumes from", "step_000000020"];
        assert_says(&place.run("resume run", 0), &words);
        assert_same_files(&kept, &run, &FLEETING);
    }
    // What a kill of an earlier version left: a folder half-deleted.
    std::fs::remove_file(place.at(&checkpoint(30)).join("state.json")).unwrap();
    place.write(&format!("{}/state.safetensors", checkpoint(20)), "half");
    let words = ["step_000000030 is damaged (state.json: it is missing)", "step_000000020", "step_000000010"];
    assert_says(&place.run("resume run", 0), &words);
    assert_same_files(&kept, &run, &FLEETING);
    // Nor is one without checksums whole, or one of a wrong step.
    std::fs::remove_file(place.at(&checkpoint(30)).join("SHA256SUMS")).unwrap();
    std::fs::rename(place.at(&checkpoint(10)), place.at(&checkpoint(90))).unwrap();
    let said = place.run("resume run", 0);
    assert_says(&said, &["step_000000090 is damaged (state.json: it belongs to step 10)"]);
    assert_says(&said, &["step_000000030 is damaged", "SHA256SUMS is missing", "step_000000020"]);
    for folder in entries(&place.at("run/checkpoints")) {
        // Some have lost theirs already.
        let _ = std::fs::remove_file(folder.join("state.json"));
    }
    let left = entries(&place.at("run/checkpoints")).len();
    place.says("resume run", 5, &["no checkpoint", "step_000000030", "from the first step"]);
    assert_eq!(entries(&place.at("run/checkpoints")).len(), left, "what is left of them stays");
}

/// Killed after its last checkpoint was written and before the one that it replaces was deleted.
#[test]
fn a_checkpoint_that_was_replaced_is_gone_when_a_run_ends() {
    let place = Place::new();
    place.run(&train("run", "train.keep_checkpoints=1"), 0);
    let [run, kept] = ["run", "kept"].map(|name| place.at(name));
    copy(&run, &kept);
    copy(&place.at(&checkpoint(30)), &place.at(&checkpoint(20)));
    place.run("resume --quiet run", 0);
    assert_same_files(&kept, &run, &FLEETING);
}

/// As `sha256sum -c` reads them.
#[test]
fn checksums_are_those_of_the_files() {
    let place = trained();
    let folder = place.at(&checkpoint(30));
    assert_eq!(text(&folder.join("SHA256SUMS")).lines().count(), 3);
    let Ok(output) = Command::new("sha256sum").args(["-c", "SHA256SUMS"]).current_dir(&folder).output() else { return };
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// A result that nobody gets is an error, of every command that prints one.
#[cfg(target_os = "linux")]
#[test]
#[ignore = "slow"]
fn a_full_standard_output_is_an_error() {
    let place = trained();
    place.write("tiny.toml", tiny_sweep(&[0], &["psnr"], "train.steps=2 eval.pictures=0", &[]));
    place.run("sweep run tiny.toml --out sweep --quiet", 0);
    for line in [
        "eval --smoothness run --lattice 4",
        "eval run",
        "sweep collect sweep",
        "sweep status sweep",
        "sweep plan tiny.toml --out sweep",
        "sweep run tiny.toml --out sweep",
        "data check",
        "data export-builtin scene --width 16",
        "train --preset smoke --print-config",
        "settings",
        "train --balance=1 --preset smoke --set data.width=16 --set train.rays=16",
        "bench --rays 8 --coarse 4 --fine 4 --width 8 --steps 1",
        "--help",
        "--version",
        "train --help",
    ] {
        let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
        let message = demand(place.command(line).stdout(full).stderr(Stdio::piped()), 4);
        assert_says(&message, &["standard output", "No space left"]);
        // A reader that has seen enough is none.
        let mut child = place.command(line).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        drop(child.stdout.take());
        let code = child.wait().unwrap().code();
        assert!(code == Some(0) || line.contains("export-builtin"), "{line}: {code:?}");
    }
}

/// Runs of a step that takes minutes: the first signal is heard and acts within it.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[test]
fn a_signal_acts_within_a_long_step() {
    let place = Place::new();
    for (signal, code) in [("-TERM", 143), ("-INT", 130), ("-HUP", 129)] {
        let long = "regularizer.kind=tv regularizer.points=full regularizer.lattice=200 train.steps=2";
        let mut command = place.command(&train(&format!("run{signal}"), long));
        let out = place.at(&format!("run{signal}"));
        heed_hangups(&mut command);
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        wait_for("a step", || {
            assert!(child.try_wait().unwrap().is_none(), "it ended before a step");
            out.join("scalars.csv").exists()
        });
        std::thread::sleep(Duration::from_millis(300));
        // As `timeout` does, which signals its child and then their group.
        Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap();
        let (ended, message) = signalled(child, signal);
        assert_eq!(ended, Some(code), "{message}");
        assert_eq!(entries(&out.join("checkpoints")).len(), 1, "{message}");
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
    let place = Place::new();
    let long = place.command(&train("run", "train.steps=4000 train.checkpoint_every=1000"));
    let mut command = Command::new("sh");
    command.args(["-c", "trap '' HUP; exec \"$@\"", "sh"]).arg(long.get_program()).args(long.get_args());
    command.current_dir(place.path()).stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = command.spawn().unwrap();
    wait_for("a step", || place.at("run/scalars.csv").exists());
    Command::new("kill").args(["-HUP", &child.id().to_string()]).status().unwrap();
    std::thread::sleep(Duration::from_millis(200));
    assert!(child.try_wait().unwrap().is_none(), "it was stopped");
    child.kill().unwrap();
    child.wait().unwrap();
}

/// A command of somebody who may read the folder but not write into it: of nobody, where this test is root's.
#[cfg(unix)]
fn as_reader(place: &Place, line: &str) -> Command {
    use std::os::unix::process::CommandExt;
    let mut command = place.command(line);
    if Command::new("id").arg("-u").output().unwrap().stdout == b"0\n" {
        command.uid(65534).gid(65534);
    }
    command
}

#[cfg(unix)]
#[test]
fn runs_that_cannot_be_written_are_measured_and_shown() {
    use std::os::unix::fs::PermissionsExt;
    let place = trained();
    std::fs::create_dir(place.at("elsewhere")).unwrap();
    let mode = |path: &Path, mode: u32| std::fs::set_permissions(path, PermissionsExt::from_mode(mode)).unwrap();
    mode(place.path(), 0o755);
    mode(&place.at("elsewhere"), 0o777);
    let run = place.at("run");
    let all = |mode: &str| assert!(Command::new("chmod").args(["-R", mode]).arg(&run).status().unwrap().success());
    all("a-w,a+rX");
    let before = files(&run, &[]);
    let said = |line: &str, code: i32| demand(&mut as_reader(&place, line), code);
    assert_says(&said("eval --smoothness run --lattice 4", 0), &["laplacian", "read-only", "smoothness.csv"]);
    assert_says(&said("eval run", 4), &["read-only", "--out"]);
    said("eval run --out elsewhere/metrics", 0);
    for name in ["metrics.json", "metrics.csv"] {
        assert_eq!(place.text(&format!("elsewhere/metrics/{name}")), place.text(&format!("run/{name}")));
    }
    for (line, out) in [("render run --what views", "render"), ("mesh run --resolution 8 --threshold 0.01", "mesh")] {
        assert_says(&said(line, 4), &["cannot write", "--out"]);
        said(&format!("{line} --out elsewhere/{out}"), 0);
        assert!(!entries(&place.at("elsewhere").join(out)).is_empty());
    }
    copy(&run, &place.at("twin"));
    said("compare run twin --out elsewhere/compare", 0);
    assert!(before == files(&run, &[]), "nothing was written into the run");
    all("u+w");
}
