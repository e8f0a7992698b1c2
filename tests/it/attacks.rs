//! Attacks on files and folders that broke the program once (tests/fixtures/hostile).

use std::fs;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::common::files::{entries, fixture};
use crate::common::program::{Place, set};

/// Tries to import a file; nothing may be left where the run would be.
fn import_is_refused(name: &str, words: &[&str]) {
    let place = Place::new();
    let small = set("data.width=12 train.rays=16 perturb.injection_layer=1");
    place.says(
        &format!("import {} --out run --preset smoke{small}", fixture(&format!("hostile/{name}")).display()),
        3,
        words,
    );
    assert_eq!(entries(place.path()), Vec::<PathBuf>::new(), "{name}");
}

#[test]
fn an_import_loses_no_layer() {
    import_is_refused("short_storage.tar", &["cannot be read", "pts_linears"]);
    import_is_refused("missing_storage.tar", &["cannot be read", "pts_linears"]);
    import_is_refused("coarse_5_fine_6_layers.tar", &["field.depth = 5", "fine network 6"]);
}

/// A folder with a small finished run of the built-in scene.
fn trained() -> Place {
    Place::trained(&set("data.width=12 field.width=16 train.rays=32 train.steps=4 eval.pictures=1"))
}

/// Whoever measures a run of somebody else writes into its folder alone.
#[cfg(unix)]
#[test]
fn links_in_a_run_lead_no_write_out_of_it() {
    use std::os::unix::fs::symlink;
    let place = trained();
    let [run, victim, folder] = ["run", "victim", "folder"].map(|name| place.at(name));
    fs::create_dir_all(folder.join("path")).unwrap();
    fs::write(folder.join("path/keep"), "keep").unwrap();
    let linked = |name: &str, to: &Path, lines: &[&str]| {
        fs::write(&victim, "keep").unwrap();
        let (entry, aside) = (run.join(name), place.at("aside"));
        let was_there = entry.symlink_metadata().is_ok();
        if was_there {
            fs::rename(&entry, &aside).unwrap();
        }
        symlink(to, &entry).unwrap();
        lines.iter().for_each(|line| place.says(line, 4, &["is a symbolic link", name]));
        assert_eq!(fs::read_to_string(&victim).unwrap(), "keep", "{name}");
        assert!(folder.join("path/keep").is_file(), "{name}");
        fs::remove_file(&entry).unwrap();
        if was_there {
            fs::rename(&aside, &entry).unwrap();
        }
    };
    for name in ["metrics.json", "metrics.csv", "depth_errors.gz", "run.lock", "timing.json"] {
        linked(name, &victim, &["eval run", "eval run --smoothness", "resume run"]);
    }
    linked("smoothness.csv", &victim, &["eval run --smoothness"]);
    linked("renders", &folder, &["eval run", "render run --frames 2"]);
    linked("checkpoints", &folder, &["resume run"]);
    // A picture among the renders is replaced, and what it led to stays.
    fs::write(&victim, "keep").unwrap();
    let picture = entries(&run.join("renders")).into_iter().find(|file| file.extension().is_some()).unwrap();
    fs::remove_file(&picture).unwrap();
    symlink(&victim, &picture).unwrap();
    place.run("resume run --quiet", 0);
    assert_eq!(fs::read_to_string(&victim).unwrap(), "keep");
}

/// A pipe in the place of a file is not waited for. Settings that a crash of the machine emptied are not all defaults. Scores
/// replace no picture.
#[cfg(target_os = "linux")]
#[test]
fn a_run_s_files_are_files_with_content() {
    let place = trained();
    for name in ["depth_errors.gz", "metrics.json", "run.lock"] {
        let file = place.at("run").join(name);
        fs::remove_file(&file).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(&file).status().unwrap().success());
        for line in ["eval run", "render run"] {
            place.says(line, 4, &[name, "neither a file nor a folder"]);
        }
        fs::remove_file(&file).unwrap();
        fs::write(&file, "").unwrap();
    }
    place.says("score run/renders run --out 0.png", 2, &["--out", "the name of an image"]);
    place.write("run/config.toml", "\n");
    for command in ["resume", "eval", "render"] {
        place.says(&format!("{command} run"), 5, &["config.toml is empty"]);
    }
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
