//! `augnerf verify`: what is committed holds, and what is changed does not.

use std::path::{Path, PathBuf};

use crate::common::assert_says;
use crate::common::files::{assert_same_files, copy, points_of, rows, text};
use crate::common::program::{self, augnerf};
use sha2::{Digest, Sha256};
use tempfile::TempDir;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// Verifies in a folder, without anything of this machine, and returns everything said.
#[track_caller]
pub fn verify(dir: &Path, arguments: &[&str], code: i32) -> String {
    let mut command = augnerf(&[&["verify"], arguments].concat());
    program::demand(command.current_dir(dir).env_remove("AUGNERF_DATA").env_remove("AUGNERF_LPIPS_WEIGHTS"), code)
}

/// Where committed results of this name lie, from the repository's root.
fn place(name: &str) -> PathBuf {
    let groups = ["paper", "study", "baselines", "checks"].map(|group| Path::new("results").join(group).join(name));
    groups.into_iter().find(|place| Path::new(ROOT).join(place).exists()).unwrap_or_else(|| panic!("no {name}"))
}

/// A copy of committed results, to be changed.
pub fn results(name: &str) -> (TempDir, PathBuf) {
    let dir = TempDir::new().unwrap();
    let folder = dir.path().join(place(name));
    copy(&Path::new(ROOT).join(place(name)), &folder);
    (dir, folder)
}

/// Changes a file of results that hold, and demands that the change is found.
#[track_caller]
fn assert_found(dir: &Path, file: &Path, from: &str, to: &str, words: &[&str]) {
    let before = text(file);
    assert!(before.contains(from), "{}: {from}", file.display());
    std::fs::write(file, before.replacen(from, to, 1)).unwrap();
    assert_says(&verify(dir, &[], 10), words);
    std::fs::write(file, before).unwrap();
}

#[test]
fn what_is_changed_is_found() {
    let (dir, folder) = results("geometry");
    verify(dir.path(), &[], 0);
    let at = |name: &str| folder.join(name);
    assert!(!at("rows_builtin_psnr.svg").exists());
    verify(dir.path(), &["--update", "--all"], 0);
    let first = |column: &str| rows(&text(&at("points.csv")))[0][column].clone();
    // A number of a point, of a table, of its pictures.
    let psnr = first("psnr");
    let wrong = psnr[..psnr.len() - 1].to_string() + if psnr.ends_with('1') { "2" } else { "1" };
    assert_found(dir.path(), &at("points.csv"), &psnr, &wrong, &["WRONG", "table.csv, line 2"]);
    assert_found(dir.path(), &at("table.md"), "23.57", "23.58", &["table.md, line", "23.58", "23.57"]);
    assert_found(dir.path(), &at("rows_builtin_psnr.svg"), "NeRF", "NerF", &["rows_builtin_psnr.svg, line"]);
    // Files that nothing makes again: one that is kept, one that a commit has and somebody put there.
    assert_found(dir.path(), &at("mesh_density.csv"), "0", "1", &["SHA-256", "mesh_density.csv"]);
    std::fs::write(at("curves_builtin_psnr.svg"), "<svg/>").unwrap();
    assert_says(&verify(dir.path(), &[], 10), &["curves_builtin_psnr.svg: its SHA-256", "under [archived]"]);
    std::fs::remove_file(at("curves_builtin_psnr.svg")).unwrap();
    std::fs::write(at("rows_builtin_ssim.svg"), "old").unwrap();
    assert_says(&verify(dir.path(), &[], 10), &["rows_builtin_ssim.svg: the points do not make it"]);
}

/// Empties a column of `points.csv`.
fn empty(folder: &Path, column: &str) {
    let file = &folder.join("points.csv");
    let mut reader = csv::Reader::from_path(file).unwrap();
    let head = reader.headers().unwrap().clone();
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(&head).unwrap();
    for row in reader.records() {
        let row = row.unwrap();
        writer.write_record(head.iter().zip(&row).map(|(name, cell)| if name == column { "" } else { cell })).unwrap();
    }
    std::fs::write(file, writer.into_inner().unwrap()).unwrap();
}

/// A hash is no proof of what the points make.
#[test]
fn forged_tables_are_not_held_to_their_own_hash() {
    let (dir, folder) = results("geometry");
    let provenance = folder.join("provenance.toml");
    let before = text(&provenance);
    let pin = |name: &str| {
        let hash: String =
            Sha256::digest(std::fs::read(folder.join(name)).unwrap()).iter().map(|b| format!("{b:02x}")).collect();
        format!("\"{name}\" = \"{hash}\"\n")
    };
    let names = ["table.csv", "table.md"];
    for name in names {
        let file = folder.join(name);
        std::fs::write(&file, text(&file).replace("23.57", "33.57")).unwrap();
    }
    let pins: String = names.into_iter().map(pin).collect();
    std::fs::write(&provenance, before.replace("[pinned]\n", &format!("[pinned]\n{pins}"))).unwrap();
    let said = verify(dir.path(), &[], 10);
    assert_says(&said, &["table.csv, line"]);
    assert_says(&said, &["table.md: provenance.toml has its hash under [pinned], but the points make it"]);
    // Curves are held to theirs where it is said why their logs are gone.
    let (start, rest) = before.split_once("[archived]").unwrap();
    let missing =
        rest.split_once("[[missing]]").unwrap().1.replace("scalars.csv.gz, and so the training curves", "the logs");
    std::fs::write(folder.join("curves_builtin_psnr.svg"), "<svg/>").unwrap();
    let without =
        format!("{}{}\n[[missing]]{missing}", start.trim_end().to_string() + "\n", pin("curves_builtin_psnr.svg"));
    std::fs::write(&provenance, without).unwrap();
    assert_says(&verify(dir.path(), &["--update"], 10), &["curves_builtin_psnr.svg", "no [[missing]] says why"]);
    let rows = pin("table.md").replace("table.md", "rows_builtin_other.svg");
    std::fs::write(&provenance, before.replace("[pinned]\n", &format!("[pinned]\n{rows}"))).unwrap();
    assert_says(&verify(dir.path(), &[], 10), &["rows_builtin_other.svg", "the points do not make it"]);
}

#[test]
fn folders_that_nothing_checks_are_wrong() {
    let (dir, _) = results("geometry");
    let foo = dir.path().join("results/foo");
    std::fs::create_dir(&foo).unwrap();
    std::fs::write(foo.join("table.csv"), "scene,row,axes,psnr_mean\nfern,NeRF,,34.10\n").unwrap();
    assert_says(&verify(dir.path(), &[], 10), &["results/foo", "WRONG", "neither a sweep's"]);
    // A page beside what the program makes is no folder of pages; by itself it is.
    std::fs::write(foo.join("README.md"), "A page.\n").unwrap();
    assert_says(&verify(dir.path(), &[], 10), &["WRONG", "neither a sweep's"]);
    std::fs::remove_file(foo.join("table.csv")).unwrap();
    verify(dir.path(), &[], 0);
}

#[test]
fn update_writes_tables_from_points_alone() {
    let (dir, folder) = results("geometry");
    std::fs::write(folder.join("table.md"), "old").unwrap();
    std::fs::remove_file(folder.join("table.csv")).unwrap();
    std::fs::write(folder.join("rows_builtin_ssim.svg"), "old").unwrap();
    assert_says(&verify(dir.path(), &[], 10), &["table.csv: the points make it, and it is not there"]);
    let said = verify(dir.path(), &["--update"], 0);
    assert_says(&said, &["table.csv: written anew", "table.md: written anew", "rows_builtin_ssim.svg: deleted"]);
    assert_same_files(&folder, &Path::new(ROOT).join("results/checks/geometry"), &[]);
    // Figures are written anew where they are kept.
    let figure = folder.join("rows_builtin_psnr.svg");
    std::fs::write(&figure, "old").unwrap();
    assert_says(&verify(dir.path(), &["--update"], 0), &["rows_builtin_psnr.svg: written anew"]);
    assert!(text(&figure).contains("NeRF") && !folder.join("rows_builtin_depth_mae.svg").exists());
    // A figure that is kept has its caption beside it.
    std::fs::remove_file(folder.join("rows_builtin_psnr.txt")).unwrap();
    assert_says(&verify(dir.path(), &[], 10), &["rows_builtin_psnr.txt: the points make it"]);
    assert!(!folder.join("rows_builtin_depth_mae.txt").exists());
    verify(dir.path(), &["--update", "--all"], 0);
    assert!(folder.join("rows_builtin_depth_mae.svg").exists());
    assert_says(&verify(dir.path(), &["--all"], 2), &["--update"]);
}

/// What a folder does not keep is said in a line; what lies in its commit may be put back, and is held to its hash.
#[test]
fn what_is_not_kept_is_said() {
    let (dir, folder) = results("study_chair_few");
    let lines = |said: &str| said.lines().filter(|line| line.contains("not kept: ")).count();
    let said = verify(dir.path(), &[], 0);
    assert_eq!(lines(&said), 1, "{said}");
    assert_says(
        &said,
        &["figures, table.tex, which `--update --all` makes; scalars.csv.gz, which commit 980e3058 has"],
    );
    assert_says(&said, &["attack.csv: it has its hash under [pinned]"]);
    let attack = text(&folder.join("attack.csv"));
    verify(dir.path(), &["--update"], 0);
    assert_eq!(text(&folder.join("attack.csv")), attack, "its logs are not here");
    std::fs::write(folder.join("attack.csv"), attack.replacen(',', ";", 1)).unwrap();
    assert_says(&verify(dir.path(), &[], 10), &["attack.csv: its SHA-256 is", "under [pinned]"]);
    std::fs::write(folder.join("attack.csv"), attack).unwrap();
    std::fs::copy(Path::new(ROOT).join(place("smoke")).join("scalars.csv.gz"), folder.join("scalars.csv.gz")).unwrap();
    assert_says(&verify(dir.path(), &[], 10), &["scalars.csv.gz: its SHA-256", "under [archived]"]);
    std::fs::remove_file(folder.join("scalars.csv.gz")).unwrap();
    std::fs::write(folder.join("table.tex"), "old").unwrap();
    assert_says(&verify(dir.path(), &[], 10), &["table.tex, line 1"]);
    verify(dir.path(), &["--update", "--all"], 0);
    assert_says(&text(&folder.join("table.tex")), &["\\begin{table}"]);
}

/// Rows over the scenes of two committed sweeps: a scene counts once, and the files are made again.
#[test]
fn a_comparison_over_scenes_is_made_again() {
    let (dir, _) = results("precision");
    for name in ["precision_chair", "tab4_fern", "tab4_embedded"] {
        copy(&Path::new(ROOT).join(place(name)), &dir.path().join(place(name)));
    }
    let of = |names: [&str; 2], more: &[&str], code: i32| {
        let folders = names.map(|name| place(name).display().to_string());
        let mut arguments = vec!["sweep", "across"];
        arguments.extend(folders.iter().map(String::as_str));
        arguments.extend(["--unit", "scene", "--out", "results/over"]);
        let mut command = augnerf(&[&arguments[..], more].concat());
        program::demand(command.current_dir(dir.path()).env_remove("AUGNERF_DATA"), code)
    };
    let across = |more: &[&str], code: i32| of(["precision", "precision_chair"], more, code);
    assert_says(&across(&["--rows", "Nerf"], 2), &["'Nerf' is not a row"]);
    assert_says(&across(&["--rows", "Aug-NeRF", "--scenes", "ship"], 2), &["--scenes ship: the scenes are", "fern"]);
    assert_says(&across(&["--seeds", "7"], 2), &["--seeds 7: the seeds are", "0"]);
    assert_says(&across(&["--seeds", "0"], 0), &["of seeds 0 alone"]);
    assert_says(&across(&["--row", "Aug-NeRF"], 2), &["--row"]);
    assert_says(&across(&["--label", "precision=Foo"], 2), &["--label is for --unit sweep"]);
    assert_says(&of(["precision", "tab4_fern"], &[], 2), &["scene 'fern' is in sweep", "a scene counts once"]);
    assert_says(&of(["tab4_fern", "tab4_embedded"], &["--rows", "Aug-NeRF"], 9), &["row 'NeRF' has ", "by_scene"]);
    let said = across(&["--rows", "Aug-NeRF"], 0);
    assert_says(&said, &["Rows against NeRF over 3 scenes: psnr", "a scene counts once", "| fern |"]);
    let folder = dir.path().join("results/over");
    assert_says(&text(&folder.join("over_scenes.svg")), &["difference in PSNR (dB) to NeRF"]);
    assert_says(&text(&folder.join("over_scenes.txt")), &["Rows against NeRF over 3 scenes", "Faint dots are scenes"]);
    let scenes = rows(&text(&folder.join("scenes.csv")));
    let number = |row: &std::collections::HashMap<String, String>, column: &str| row[column].parse::<f64>().unwrap();
    for (scene, name) in ["builtin", "fern", "chair"].iter().zip(["precision", "precision", "precision_chair"]) {
        let table = rows(&text(&dir.path().join(place(name)).join("table.csv")));
        let mean = |row: &str| {
            let line = table.iter().find(|line| line["row"] == row && line["scene"] == *scene).unwrap();
            number(line, "psnr_mean")
        };
        let found = scenes.iter().find(|row| row["scene"] == *scene).unwrap();
        let difference = mean("Aug-NeRF") - mean("NeRF");
        assert!((number(found, "difference") - difference).abs() < 1e-9, "{scene}: {found:?}");
    }
    let over = rows(&text(&folder.join("over_scenes.csv")));
    let mean = scenes.iter().map(|row| number(row, "difference")).sum::<f64>() / 3.0;
    assert!((number(&over[0], "difference") - mean).abs() < 1e-12 && over[0]["scenes"] == "3", "{over:?}");
    assert_says(&verify(dir.path(), &["results/over"], 0), &["comparisons of 2 sweeps", "over_scenes.toml"]);
    // One folder, one comparison.
    let folders = ["precision", "precision_chair"].map(|name| place(name).display().to_string());
    let by_sweep = ["sweep", "across", &folders[0], &folders[1], "--row", "Aug-NeRF", "--out", "results/over"];
    let said = program::demand(augnerf(&by_sweep).current_dir(dir.path()), 4);
    assert_says(&said, &["another comparison (over_scenes.toml)"]);
    let csv = folder.join("scenes.csv");
    let before = text(&csv);
    std::fs::write(&csv, before.replace("fern", "Fern")).unwrap();
    assert_says(&verify(dir.path(), &["results/over"], 10), &["WRONG", "scenes.csv"]);
    assert_says(&verify(dir.path(), &["results/over", "--update"], 0), &["scenes.csv: written anew"]);
    assert_eq!(text(&csv), before);
}

/// One question to two committed sweeps: p values over the two, and files that are made again.
#[test]
fn a_comparison_across_sweeps_is_made_again() {
    let (dir, _) = results("few_views_chair");
    for name in ["geometry_chair", "mip_chair"] {
        copy(&Path::new(ROOT).join(place(name)), &dir.path().join(place(name)));
    }
    let across = |out: &str, row: &str, code: i32| {
        let folders =
            ["results/checks/geometry_chair", "results/baselines/mip_chair", "results/checks/few_views_chair"];
        let mut command = augnerf(&[&["sweep", "across"], &folders[..], &["--out", out, "--row", row]].concat());
        program::demand(command.current_dir(dir.path()).env_remove("AUGNERF_DATA"), code)
    };
    assert_says(
        &across("results/both", "Nerf", 2),
        &["sweep 'geometry_chair' has no row 'Nerf'", "its rows are 'NeRF', "],
    );
    assert_says(&across("results/both", "Aug-NeRF,NeRF + second clean pass", 2), &["has no row"]);
    assert_says(&across("results", "Aug-NeRF", 4), &["results holds other folders"]);
    assert_says(&across("results/both", "NeRF", 2), &["both 'NeRF'"]);
    let mut without = augnerf(&["sweep", "across", "results/checks/geometry_chair", "--out", "results/both"]);
    assert_says(
        &program::demand(without.current_dir(dir.path()), 2),
        &["--row names the row to compare in each sweep"],
    );
    // A table of somebody's own with a name of ours.
    let mine = dir.path().join("mine");
    std::fs::create_dir(&mine).unwrap();
    std::fs::write(mine.join("across.csv"), "mine").unwrap();
    assert_says(&across("mine", "Aug-NeRF", 4), &["mine holds files that are not a comparison of sweeps", "--out"]);
    assert_eq!(text(&mine.join("across.csv")), "mine");
    // Once more takes its own place.
    across("results/both", "Aug-NeRF", 0);
    let said = across("results/both", "Aug-NeRF", 0);
    assert_says(&said, &["Aug-NeRF against NeRF: psnr", "chair, 8 views", "files: results/both"]);
    let folder = dir.path().join("results/both");
    assert_says(
        &text(&folder.join("across.svg")),
        &["Aug-NeRF minus NeRF: difference in PSNR", "chair, 8 views", " width=\"17cm\""],
    );
    let blocks = rows(&text(&folder.join("across.csv")));
    let own = |name: &str, column: &str| {
        let table = rows(&text(&dir.path().join(place(name)).join("table.csv")));
        // A table of one seed has no p.
        table.iter().find(|row| row["row"] == "Aug-NeRF").unwrap().get(column).cloned().unwrap_or_default()
    };
    for block in &blocks {
        assert_eq!(block["difference"], own(&block["sweep"], "psnr_difference"), "{}", block["sweep"]);
        assert_eq!(block["p"], own(&block["sweep"], "psnr_p"), "{}", block["sweep"]);
    }
    // A sweep of one seed claims nothing and takes no part in the correction.
    let p = |row: usize, column: &str| blocks[row][column].parse::<f64>().unwrap();
    assert!(blocks[2]["p_holm"].is_empty() && blocks[2]["simultaneous_low"].is_empty());
    assert_eq!(p(0, "p_holm").min(p(1, "p_holm")), 2.0 * p(0, "p").min(p(1, "p")));
    assert_says(&verify(dir.path(), &["results/both"], 0), &["comparisons of 3 sweeps"]);
    let csv = folder.join("across.csv");
    let (before, difference) = (text(&csv), &blocks[1]["difference"]);
    std::fs::write(&csv, before.replace(difference, "0.5")).unwrap();
    assert_says(&verify(dir.path(), &["results/both"], 10), &["WRONG", "across.csv, line 3"]);
    assert_says(&verify(dir.path(), &["results/both", "--update"], 0), &["across.csv: written anew"]);
    assert_eq!(text(&csv), before);
    std::fs::write(folder.join("across.svg"), "<svg/>").unwrap();
    assert_says(&verify(dir.path(), &["results/both"], 10), &["WRONG", "across.svg"]);
    assert_says(&verify(dir.path(), &["results/both", "--update"], 0), &["across.svg: written anew"]);
    std::fs::remove_file(folder.join("across.svg")).unwrap();
    assert_says(&verify(dir.path(), &["results/both"], 0), &["not kept: 1 figures"]);
    // What sweeps are called is kept.
    let mut labelled = ["sweep", "across", "results/checks/geometry_chair", "results/baselines/mip_chair"].to_vec();
    labelled.extend(["--row", "Aug-NeRF", "--out", "results/both", "--label", "mip_chair=The chair = 200 pixels"]);
    program::demand(augnerf(&labelled).current_dir(dir.path()), 0);
    for (file, words) in
        [("svg", "The chair = 200 pixels"), ("md", "| The chair = 200 pixels |"), ("csv", "mip_chair,chair")]
    {
        assert_says(&text(&folder.join("across").with_extension(file)), &[words]);
    }
    assert_says(&verify(dir.path(), &["results/both"], 0), &["comparisons of 2 sweeps"]);
    *labelled.last_mut().unwrap() = "fern=x";
    assert_says(
        &program::demand(augnerf(&labelled).current_dir(dir.path()), 2),
        &["--label fern", "geometry_chair, mip_chair"],
    );
    // What names results elsewhere, or what is not there, does not hold.
    let asked = folder.join("across.toml");
    let named = text(&asked);
    std::fs::write(&asked, named.replace("\"mip_chair\"", "\"../mip_chair\"")).unwrap();
    assert_says(&verify(dir.path(), &["results/both"], 10), &["'../mip_chair' is not the name of a folder"]);
    std::fs::write(&asked, named).unwrap();
    std::fs::remove_dir_all(dir.path().join("results/baselines/mip_chair")).unwrap();
    assert_says(&verify(dir.path(), &["results/both"], 10), &["mip_chair"]);
    // Without what it asks it is files that nothing makes.
    std::fs::remove_file(&asked).unwrap();
    assert_says(&verify(dir.path(), &["results/both"], 3), &["holds no results"]);
}

#[test]
fn what_is_not_at_hand_is_said() {
    let (dir, _) = results("mip_fern");
    assert_says(&verify(dir.path(), &[], 0), &["not checked  scalars.csv.gz"]);
    assert_says(&verify(dir.path(), &["nowhere"], 3), &["nowhere"]);
    std::fs::create_dir(dir.path().join("empty")).unwrap();
    assert_says(&verify(dir.path(), &["empty"], 3), &["holds no results"]);
    std::fs::remove_file(dir.path().join("results/baselines/mip_fern/points.json")).unwrap();
    assert_says(&verify(dir.path(), &[], 10), &["has no points.json"]);
    assert_says(&verify(Path::new(ROOT), &["results/baselines/mip_fern", "--retrain", "1"], 2), &["git worktree add"]);
}

/// What the attack did comes out of the points' logs, and is held to them.
#[track_caller]
fn assert_attack(dir: &Path, folder: &Path) {
    let lines = rows(&text(&folder.join("attack.csv")));
    let [line] = &lines[..] else { panic!("{lines:?}") };
    let place = |column: &str| line[column].as_str();
    assert_eq!(["scene", "source", "row", "axes", "n"].map(place), ["builtin", "run", "Aug-NeRF", "", "2"]);
    assert_eq!(line.len(), 5 + 6 * 12);
    let points = points_of(folder);
    let logs = points.iter().filter(|point| point["row"] == "Aug-NeRF");
    let logs = logs.map(|point| rows(&text(&dir.join("runs/tiny/points").join(&point["id"]).join("run/scalars.csv"))));
    let logs: Vec<Vec<f64>> =
        logs.map(|log| log.iter().map(|row| row["shift.xyz"].parse().unwrap()).collect()).collect();
    assert_eq!(logs.iter().map(Vec::len).collect::<Vec<_>>(), [4, 4]);
    let is_mean_of = |column: &str, of: &dyn Fn(&[f64]) -> f64| {
        let (found, made): (f64, f64) = (line[column].parse().unwrap(), (of(&logs[0]) + of(&logs[1])) / 2.0);
        assert!((found - made).abs() <= 1e-12 * made.abs() && made > 0.0, "{column}: {found} {made}");
    };
    is_mean_of("shift.xyz", &|log| log.iter().sum::<f64>() / 4.0);
    is_mean_of("first.shift.xyz", &|log| log[0]);
    is_mean_of("last.shift.xyz", &|log| log[3]);
    let shift = &line["last.shift.xyz"];
    let other = shift[..shift.len() - 1].to_string() + if shift.ends_with('1') { "2" } else { "1" };
    assert_found(dir, &folder.join("attack.csv"), shift, &other, &["WRONG", "attack.csv, line 2"]);
}

/// A sweep of a second, collected, verified, trained again.
#[test]
fn a_collected_sweep_holds_and_trains_again() {
    let dir = TempDir::new().unwrap();
    let definition = r#"
title = "tiny"
preset = "smoke"
scenes = ["builtin"]
seeds = [0, 1]
metrics = ["psnr"]
baseline = "NeRF"
set = { "data.width" = 16, "field.width" = 16, "sampling.coarse" = 8, "sampling.fine" = 8, "train.rays" = 64, "train.steps" = 20, "train.log_every" = 5, "eval.pictures" = 1, "eval.mesh.resolution" = 16, "eval.mesh.reference" = "none", "eval.mesh.threshold" = 0.5 }
row = [{ name = "NeRF" }, { name = "equal", set = { "field.depth" = 3 }, budget = { kind = "seconds", like = "NeRF" } }, { name = "Aug-NeRF", set = { method = "aug-nerf" } }]
"#;
    std::fs::write(dir.path().join("tiny.toml"), definition).unwrap();
    program::demand(augnerf(&["sweep", "run", "tiny.toml", "--quiet"]).current_dir(dir.path()), 0);
    let folder = dir.path().join("results/tiny");
    let said = verify(dir.path(), &["--retrain", "2"], 0);
    assert_says(&said, &["tables and figures from 6 points", "trained again, every number to the last digit"]);
    assert!(folder.join("curves_builtin_psnr.svg").exists() && folder.join("scalars.csv.gz").exists());
    // A measurement that is empty is none that was left out.
    let points = folder.join("points.csv");
    let kept = text(&points);
    empty(&folder, "psnr");
    assert_says(&verify(dir.path(), &["--retrain", "2", "--update"], 10), &["psnr is '", "points.csv has ''"]);
    std::fs::write(&points, kept).unwrap();
    assert_says(&verify(dir.path(), &["--update"], 0), &["written anew"]);
    // A page with images of the runs cannot be made again: it is held to its hash.
    assert_says(&said, &["report.html: it has its hash under [pinned]"]);
    let points = points_of(&folder);
    assert!(points.iter().all(|row| row["mesh"].ends_with("not compared") && row["chamfer"].is_empty()), "{points:?}");
    assert_found(dir.path(), &folder.join("report.html"), "NeRF", "NerF", &["SHA-256"]);
    assert_attack(dir.path(), &folder);
    // Curves come from the logs that are kept.
    std::fs::remove_file(folder.join("scalars.csv.gz")).unwrap();
    assert_says(&verify(dir.path(), &[], 10), &["curves_builtin_psnr.svg: the points do not make it"]);
    assert_says(&verify(dir.path(), &[], 10), &["attack.csv: the points do not make it"]);
}
