//! Attacks on files and folders that broke the program once (tests/fixtures/hostile).

use std::fs;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::common::files::entries;
use crate::common::program::{refuse, succeed};
use crate::fuzz::memory::most_taken;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/hostile").join(name)
}

/// Tries to import a file; nothing may be left where the run would be.
fn import_is_refused(name: &str, words: &[&str]) {
    let dir = TempDir::new().unwrap();
    let (file, out) = (fixture(name), dir.path().join("run"));
    let small = ["--preset", "smoke", "--set", "data.width=12", "--set", "train.rays=16"];
    let import = ["import", file.to_str().unwrap(), "--out", out.to_str().unwrap()];
    refuse(&[&import[..], &small, &["--set", "perturb.injection_layer=1"]].concat(), 3, words);
    assert_eq!(entries(dir.path()), Vec::<PathBuf>::new(), "{name}");
}

#[test]
fn an_import_loses_no_layer() {
    import_is_refused("short_storage.tar", &["cannot be read", "pts_linears"]);
    import_is_refused("missing_storage.tar", &["cannot be read", "pts_linears"]);
    import_is_refused("coarse_5_fine_6_layers.tar", &["field.depth = 5", "fine network 6"]);
    import_is_refused("step_2_to_63.safetensors", &["its step is not an integer from 0 to 1000000000"]);
    import_is_refused("config_brackets.safetensors", &["its configuration"]);
}

/// A small finished run of the built-in scene.
fn trained(dir: &Path) -> PathBuf {
    let out = dir.join("run");
    let small = ["data.width=12", "field.width=16", "train.rays=32", "train.steps=4", "eval.pictures=1"];
    let mut arguments = vec!["train", "--preset", "smoke", "--quiet", "--out", out.to_str().unwrap()];
    small.iter().for_each(|setting| arguments.extend(["--set", setting]));
    succeed(&arguments);
    out
}

/// Whoever measures a run of somebody else writes into its folder alone.
#[cfg(unix)]
#[test]
fn links_in_a_run_lead_no_write_out_of_it() {
    use std::os::unix::fs::symlink;
    let dir = TempDir::new().unwrap();
    let run = trained(dir.path());
    let victim = dir.path().join("victim");
    let folder = dir.path().join("folder");
    fs::create_dir_all(folder.join("path")).unwrap();
    fs::write(folder.join("path/keep"), "keep").unwrap();
    let linked = |name: &str, to: &Path, commands: &[&[&str]]| {
        fs::write(&victim, "keep").unwrap();
        let (entry, aside) = (run.join(name), dir.path().join("aside"));
        let was_there = entry.symlink_metadata().is_ok();
        if was_there {
            fs::rename(&entry, &aside).unwrap();
        }
        symlink(to, &entry).unwrap();
        for command in commands {
            refuse(
                &[&command[..1], &[run.to_str().unwrap()], &command[1..]].concat(),
                4,
                &["is a symbolic link", name],
            );
        }
        assert_eq!(fs::read_to_string(&victim).unwrap(), "keep", "{name}");
        assert!(folder.join("path/keep").is_file(), "{name}");
        fs::remove_file(&entry).unwrap();
        if was_there {
            fs::rename(&aside, &entry).unwrap();
        }
    };
    for name in ["metrics.json", "metrics.csv", "depth_errors.gz", "run.lock", "timing.json"] {
        linked(name, &victim, &[&["eval"], &["eval", "--smoothness"], &["resume"]]);
    }
    linked("smoothness.csv", &victim, &[&["eval", "--smoothness"]]);
    linked("renders", &folder, &[&["eval"], &["render", "--frames", "2"]]);
    linked("checkpoints", &folder, &[&["resume"]]);
    // A picture among the renders is replaced, and what it led to stays.
    fs::write(&victim, "keep").unwrap();
    let picture = entries(&run.join("renders")).into_iter().find(|file| file.extension().is_some()).unwrap();
    fs::remove_file(&picture).unwrap();
    symlink(&victim, &picture).unwrap();
    succeed(&["resume", run.to_str().unwrap(), "--quiet"]);
    assert_eq!(fs::read_to_string(&victim).unwrap(), "keep");
}

/// A pipe in the place of a file is not waited for.
#[cfg(target_os = "linux")]
#[test]
fn pipes_in_a_run_are_not_waited_for() {
    let dir = TempDir::new().unwrap();
    let run = trained(dir.path());
    for name in ["depth_errors.gz", "metrics.json", "run.lock"] {
        let file = run.join(name);
        fs::remove_file(&file).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(&file).status().unwrap().success());
        for command in ["eval", "render", "export"] {
            let out = dir.path().join("a.safetensors");
            let file = [out.to_str().unwrap()];
            let last = if command == "export" { &file[..] } else { &[] };
            refuse(&[&[command, run.to_str().unwrap()], last].concat(), 4, &[name, "neither a file nor a folder"]);
        }
        fs::remove_file(&file).unwrap();
        fs::write(&file, "").unwrap();
    }
}

/// Settings that a crash of the machine emptied are not all defaults.
#[test]
fn an_emptied_configuration_is_an_error() {
    let dir = TempDir::new().unwrap();
    let run = trained(dir.path());
    fs::write(run.join("config.toml"), "\n").unwrap();
    for command in ["resume", "eval", "render"] {
        refuse(&[command, run.to_str().unwrap()], 5, &["config.toml is empty"]);
    }
}

/// 65 kB that unpack to 64 MiB of colour profile.
#[test]
fn a_colour_profile_takes_no_more_memory_than_a_picture() {
    let file = fixture("profile_64_mib.png");
    // The picture is read, with or without its profile, or refused.
    let (_, taken) = most_taken(|| augnerf::data::images::read(&file, (16, 16)).is_ok());
    assert!(taken < 40 << 20, "{taken} bytes");
}

#[test]
fn scores_do_not_replace_a_picture() {
    let dir = TempDir::new().unwrap();
    let run = trained(dir.path());
    let renders = run.join("renders");
    let out = dir.path().join("0.png");
    let arguments = ["score", renders.to_str().unwrap(), run.to_str().unwrap(), "--out", out.to_str().unwrap()];
    refuse(&arguments, 2, &["--out", "the name of an image"]);
}

/// A limit of file sizes ends in a sentence, not in a signal.
#[cfg(target_os = "linux")]
#[test]
fn a_limit_of_file_sizes_is_an_error() {
    let dir = TempDir::new().unwrap();
    let out = dir.path().join("run");
    let program = env!("CARGO_BIN_EXE_augnerf");
    let train =
        format!("ulimit -f 16; exec {program} train --preset smoke --set train.steps=4 --out {} -q", out.display());
    let ended = std::process::Command::new("sh").args(["-c", &train]).output().unwrap();
    assert_eq!(ended.status.code(), Some(4), "{}", String::from_utf8_lossy(&ended.stderr));
}
