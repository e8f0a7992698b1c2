//! `augnerf verify`: what is committed holds, and what is changed does not.

use std::path::{Path, PathBuf};

use crate::common::assert_says;
use crate::common::files::{Cells, assert_same_files, copy, number, points_of, rows, text};
use crate::common::program::{Place, augnerf, demand, tiny_sweep};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// Where committed results of this name lie, from the repository's root.
fn committed(name: &str) -> String {
    let groups = ["paper", "study", "baselines", "checks"].map(|group| format!("results/{group}/{name}"));
    groups.into_iter().find(|place| Path::new(ROOT).join(place).exists()).unwrap_or_else(|| panic!("no {name}"))
}

/// The committed table of that sweep.
fn table_of(name: &str) -> Vec<Cells> {
    rows(&text(&Path::new(ROOT).join(committed(name)).join("table.csv")))
}

/// A copy of committed results, to be changed.
pub fn results(name: &str) -> (Place, PathBuf) {
    let place = Place::new();
    let folder = add(&place, name);
    (place, folder)
}

/// Copies committed results into a folder, where they lie as in the repository.
fn add(place: &Place, name: &str) -> PathBuf {
    let folder = place.at(&committed(name));
    copy(&Path::new(ROOT).join(committed(name)), &folder);
    folder
}

/// Changes a file of results that hold, and demands that the change is found.
#[track_caller]
fn assert_found(place: &Place, file: &Path, from: &str, to: &str, words: &[&str]) {
    let before = text(file);
    assert!(before.contains(from), "{}: {from}", file.display());
    std::fs::write(file, before.replacen(from, to, 1)).unwrap();
    place.says("verify", 10, words);
    std::fs::write(file, before).unwrap();
}

#[test]
fn what_is_changed_is_found() {
    let (place, folder) = results("geometry");
    place.run("verify", 0);
    let at = |name: &str| folder.join(name);
    assert!(!at("rows_builtin_psnr.svg").exists());
    place.run("verify --update --all", 0);
    let first = |column: &str| rows(&text(&at("points.csv")))[0][column].clone();
    // A number of a point, of a table, of its pictures.
    let psnr = first("psnr");
    assert_found(&place, &at("points.csv"), &psnr, &forged(&psnr), &["WRONG", "table.csv, line 2"]);
    assert_found(&place, &at("table.md"), "23.57", "23.58", &["table.md, line", "23.58", "23.57"]);
    assert_found(&place, &at("rows_builtin_psnr.svg"), "NeRF", "NerF", &["rows_builtin_psnr.svg, line"]);
    // Files that nothing makes again: one that is kept, one that a commit has and somebody put there.
    assert_found(&place, &at("mesh_density.csv"), "0", "1", &["SHA-256", "mesh_density.csv"]);
    std::fs::write(at("curves_builtin_psnr.svg"), "<svg/>").unwrap();
    place.says("verify", 10, &["curves_builtin_psnr.svg: its SHA-256", "under [archived]"]);
    std::fs::remove_file(at("curves_builtin_psnr.svg")).unwrap();
    std::fs::write(at("rows_builtin_ssim.svg"), "old").unwrap();
    place.says("verify", 10, &["rows_builtin_ssim.svg: the points do not make it"]);
}

/// Changes a file of a comparison, and demands that the change is found and the file made again.
#[track_caller]
fn assert_made_again(place: &Place, file: &str, from: &str, to: &str) {
    let (folder, name) = file.rsplit_once('/').unwrap();
    let before = place.text(file);
    place.write(file, before.replace(from, to));
    place.says(&format!("verify {folder}"), 10, &["WRONG", name]);
    place.says(&format!("verify {folder} --update"), 0, &[&format!("{name}: written anew")]);
    assert_eq!(place.text(file), before);
}

/// A number with another last digit.
fn forged(number: &str) -> String {
    let digit = if number.ends_with('1') { "2" } else { "1" };
    number[..number.len() - 1].to_string() + digit
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
    let (place, folder) = results("geometry");
    let provenance = folder.join("provenance.toml");
    let before = text(&provenance);
    let pin = |name: &str| {
        let hash = augnerf::train::sha256(&std::fs::read(folder.join(name)).unwrap());
        format!("\"{name}\" = \"{hash}\"\n")
    };
    let names = ["table.csv", "table.md"];
    for name in names {
        let file = folder.join(name);
        std::fs::write(&file, text(&file).replace("23.57", "33.57")).unwrap();
    }
    let pins: String = names.into_iter().map(pin).collect();
    std::fs::write(&provenance, before.replace("[pinned]\n", &format!("[pinned]\n{pins}"))).unwrap();
    let made = "table.md: provenance.toml has its hash under [pinned], but the points make it";
    place.says("verify", 10, &["table.csv, line", made]);
    // Curves are held to theirs where it is said why their logs are gone.
    let (start, rest) = before.split_once("[archived]").unwrap();
    let (_, missing) = rest.split_once("[[missing]]").unwrap();
    let missing = missing.replace("scalars.csv.gz, and so the training curves", "the logs");
    std::fs::write(folder.join("curves_builtin_psnr.svg"), "<svg/>").unwrap();
    let curves = pin("curves_builtin_psnr.svg");
    std::fs::write(&provenance, format!("{}\n{curves}\n[[missing]]{missing}", start.trim_end())).unwrap();
    place.says("verify --update", 10, &["curves_builtin_psnr.svg", "no [[missing]] says why"]);
    let rows = pin("table.md").replace("table.md", "rows_builtin_other.svg");
    std::fs::write(&provenance, before.replace("[pinned]\n", &format!("[pinned]\n{rows}"))).unwrap();
    place.says("verify", 10, &["rows_builtin_other.svg", "the points do not make it"]);
}

#[test]
fn folders_that_nothing_checks_are_wrong() {
    let (place, _) = results("geometry");
    place.write("results/foo/table.csv", "scene,row,axes,psnr_mean\nfern,NeRF,,34.10\n");
    place.says("verify", 10, &["results/foo", "WRONG", "neither a sweep's"]);
    // A page beside what the program makes is no folder of pages; by itself it is.
    place.write("results/foo/README.md", "A page.\n");
    place.says("verify", 10, &["WRONG", "neither a sweep's"]);
    std::fs::remove_file(place.at("results/foo/table.csv")).unwrap();
    place.run("verify", 0);
}

#[test]
fn update_writes_tables_from_points_alone() {
    let (place, folder) = results("geometry");
    std::fs::write(folder.join("table.md"), "old").unwrap();
    std::fs::remove_file(folder.join("table.csv")).unwrap();
    std::fs::write(folder.join("rows_builtin_ssim.svg"), "old").unwrap();
    place.says("verify", 10, &["table.csv: the points make it, and it is not there"]);
    let done = ["table.csv: written anew", "table.md: written anew", "rows_builtin_ssim.svg: deleted"];
    place.says("verify --update", 0, &done);
    assert_same_files(&folder, &Path::new(ROOT).join("results/checks/geometry"), &[]);
    // Figures are written anew where they are kept.
    let figure = folder.join("rows_builtin_psnr.svg");
    std::fs::write(&figure, "old").unwrap();
    place.says("verify --update", 0, &["rows_builtin_psnr.svg: written anew"]);
    assert!(text(&figure).contains("NeRF") && !folder.join("rows_builtin_depth_mae.svg").exists());
    // A figure that is kept has its caption beside it.
    std::fs::remove_file(folder.join("rows_builtin_psnr.txt")).unwrap();
    place.says("verify", 10, &["rows_builtin_psnr.txt: the points make it"]);
    assert!(!folder.join("rows_builtin_depth_mae.txt").exists());
    place.run("verify --update --all", 0);
    assert!(folder.join("rows_builtin_depth_mae.svg").exists());
    place.says("verify --all", 2, &["--update"]);
}

/// What a folder does not keep is said in a line; what lies in its commit may be put back, and is held to its hash.
#[test]
fn what_is_not_kept_is_said() {
    let (place, folder) = results("study_chair_few");
    let lines = |said: &str| said.lines().filter(|line| line.contains("not kept: ")).count();
    let said = place.run("verify", 0);
    assert_eq!(lines(&said), 1, "{said}");
    let kept = "figures, table.tex, which `--update --all` makes; scalars.csv.gz, which commit 980e3058 has";
    assert_says(&said, &[kept, "attack.csv: its hash is that under [pinned]"]);
    let attack = text(&folder.join("attack.csv"));
    place.run("verify --update", 0);
    assert_eq!(text(&folder.join("attack.csv")), attack, "its logs are not here");
    std::fs::write(folder.join("attack.csv"), attack.replacen(',', ";", 1)).unwrap();
    place.says("verify", 10, &["attack.csv: its SHA-256 is", "under [pinned]"]);
    std::fs::write(folder.join("attack.csv"), attack).unwrap();
    let other = Path::new(ROOT).join(committed("smoke")).join("scalars.csv.gz");
    std::fs::copy(other, folder.join("scalars.csv.gz")).unwrap();
    place.says("verify", 10, &["scalars.csv.gz: its SHA-256", "under [archived]"]);
    std::fs::remove_file(folder.join("scalars.csv.gz")).unwrap();
    std::fs::write(folder.join("table.tex"), "old").unwrap();
    place.says("verify", 10, &["table.tex, line 1"]);
    place.run("verify --update --all", 0);
    assert_says(&text(&folder.join("table.tex")), &["\\begin{table}"]);
}

/// Rows over the scenes of two committed sweeps: a scene counts once, and the files are made again.
#[test]
fn a_comparison_over_scenes_is_made_again() {
    let (place, _) = results("precision");
    for name in ["precision_chair", "tab4_fern", "tab4_embedded"] {
        add(&place, name);
    }
    let of = |names: [&str; 2], more: &str, code: i32| {
        let folders = names.map(committed).join(" ");
        place.run(&format!("sweep across {folders} --unit scene --out results/over {more}"), code)
    };
    let across = |more: &str, code: i32| of(["precision", "precision_chair"], more, code);
    assert_says(&across("--rows Nerf", 2), &["'Nerf' is not a row"]);
    assert_says(&across("--rows Aug-NeRF --scenes ship", 2), &["--scenes ship: the scenes are", "fern"]);
    assert_says(&across("--seeds 7", 2), &["--seeds 7: the seeds are", "0"]);
    assert_says(&across("--seeds 0", 0), &["of seeds 0 alone"]);
    assert_says(&across("--row Aug-NeRF", 2), &["--row"]);
    assert_says(&across("--label precision=Foo", 2), &["--label is for --unit sweep"]);
    assert_says(&of(["precision", "tab4_fern"], "", 2), &["scene 'fern' is in sweep", "a scene counts once"]);
    assert_says(&of(["tab4_fern", "tab4_embedded"], "--rows Aug-NeRF", 9), &["row 'NeRF' has ", "by_scene"]);
    let said = across("--rows Aug-NeRF", 0);
    assert_says(&said, &["Rows against NeRF over 3 scenes: psnr", "a scene counts once", "| fern |"]);
    let folder = place.at("results/over");
    assert_says(&text(&folder.join("over_scenes.svg")), &["difference in PSNR (dB) to NeRF"]);
    assert_says(&text(&folder.join("over_scenes.txt")), &["Rows against NeRF over 3 scenes", "Faint dots are scenes"]);
    let scenes = rows(&text(&folder.join("scenes.csv")));
    for (scene, name) in [("builtin", "precision"), ("fern", "precision"), ("chair", "precision_chair")] {
        let table = table_of(name);
        let of = |row: &str| table.iter().find(|line| line["row"] == row && line["scene"] == scene).unwrap();
        let mean = |row: &str| number(of(row), "psnr_mean");
        let found = scenes.iter().find(|row| row["scene"] == scene).unwrap();
        let difference = mean("Aug-NeRF") - mean("NeRF");
        assert!((number(found, "difference") - difference).abs() < 1e-9, "{scene}: {found:?}");
    }
    let over = rows(&text(&folder.join("over_scenes.csv")));
    let mean = scenes.iter().map(|row| number(row, "difference")).sum::<f64>() / 3.0;
    assert!((number(&over[0], "difference") - mean).abs() < 1e-12 && over[0]["scenes"] == "3", "{over:?}");
    place.says("verify results/over", 0, &["comparisons of 2 sweeps", "over_scenes.toml"]);
    // One folder, one comparison.
    let folders = ["precision", "precision_chair"].map(committed).join(" ");
    let by_sweep = format!("sweep across {folders} --row Aug-NeRF --out results/over");
    place.says(&by_sweep, 4, &["another comparison (over_scenes.toml)"]);
    assert_made_again(&place, "results/over/scenes.csv", "fern", "Fern");
}

/// One question to two committed sweeps: p values over the two, and files that are made again.
#[test]
fn a_comparison_across_sweeps_is_made_again() {
    let (place, _) = results("few_views_chair");
    for name in ["geometry_chair", "mip_chair"] {
        add(&place, name);
    }
    let pair = "sweep across results/checks/geometry_chair results/baselines/mip_chair";
    let across = |out: &str, row: &str, code: i32| {
        place.run(&format!("{pair} results/checks/few_views_chair --out {out} --row '{row}'"), code)
    };
    let said = across("results/both", "Nerf", 2);
    assert_says(&said, &["sweep 'geometry_chair' has no row 'Nerf'", "its rows are 'NeRF', "]);
    assert_says(&across("results", "Aug-NeRF", 4), &["results holds other folders"]);
    assert_says(&across("results/both", "NeRF", 2), &["both 'NeRF'"]);
    place.says(&format!("{pair} --out results/both"), 2, &["--row names the row to compare in each sweep"]);
    // A table of somebody's own with a name of ours.
    place.write("mine/across.csv", "mine");
    assert_says(&across("mine", "Aug-NeRF", 4), &["mine holds files that are not a comparison of sweeps", "--out"]);
    assert_eq!(place.text("mine/across.csv"), "mine");
    // Once more takes its own place.
    across("results/both", "Aug-NeRF", 0);
    let said = across("results/both", "Aug-NeRF", 0);
    assert_says(&said, &["Aug-NeRF against NeRF: psnr", "chair, 8 views", "files: results/both"]);
    let folder = place.at("results/both");
    let words = ["Aug-NeRF minus NeRF: difference in PSNR", "chair, 8 views", " width=\"17cm\""];
    assert_says(&text(&folder.join("across.svg")), &words);
    let blocks = rows(&text(&folder.join("across.csv")));
    for block in &blocks {
        let table = table_of(&block["sweep"]);
        let own = table.iter().find(|row| row["row"] == "Aug-NeRF").unwrap();
        // A table of one seed has no p.
        let p = own.get("psnr_p").cloned().unwrap_or_default();
        assert_eq!([&block["difference"], &block["p"]], [&own["psnr_difference"], &p], "{}", block["sweep"]);
    }
    // A sweep of one seed claims nothing and takes no part in the correction.
    let p = |row: usize, column: &str| blocks[row][column].parse::<f64>().unwrap();
    assert!(blocks[2]["p_holm"].is_empty() && blocks[2]["simultaneous_low"].is_empty());
    assert_eq!(p(0, "p_holm").min(p(1, "p_holm")), 2.0 * p(0, "p").min(p(1, "p")));
    place.says("verify results/both", 0, &["comparisons of 3 sweeps"]);
    assert_made_again(&place, "results/both/across.csv", &blocks[1]["difference"], "0.5");
    std::fs::remove_file(folder.join("across.svg")).unwrap();
    place.says("verify results/both", 0, &["not kept: 1 figures"]);
    // What sweeps are called is kept.
    let labelled = |label: &str| format!("{pair} --row Aug-NeRF --out results/both --label '{label}'");
    place.run(&labelled("mip_chair=The chair = 200 pixels"), 0);
    assert_says(&text(&folder.join("across.svg")), &["The chair = 200 pixels"]);
    assert_says(&text(&folder.join("across.md")), &["| The chair = 200 pixels |"]);
    place.says("verify results/both", 0, &["comparisons of 2 sweeps"]);
    place.says(&labelled("fern=x"), 2, &["--label fern", "geometry_chair, mip_chair"]);
    // What names results elsewhere, or what is not there, does not hold.
    let asked = folder.join("across.toml");
    let named = text(&asked);
    std::fs::write(&asked, named.replace("\"mip_chair\"", "\"../mip_chair\"")).unwrap();
    place.says("verify results/both", 10, &["'../mip_chair' is not the name of a folder"]);
    std::fs::write(&asked, named).unwrap();
    std::fs::remove_dir_all(place.at("results/baselines/mip_chair")).unwrap();
    place.says("verify results/both", 10, &["mip_chair"]);
    // Without what it asks it is files that nothing makes.
    std::fs::remove_file(&asked).unwrap();
    place.says("verify results/both", 3, &["holds no results"]);
}

#[test]
fn what_is_not_at_hand_is_said() {
    let (place, _) = results("mip_fern");
    place.says("verify", 0, &["not checked  scalars.csv.gz"]);
    place.says("verify nowhere", 3, &["nowhere"]);
    std::fs::create_dir(place.at("empty")).unwrap();
    place.says("verify empty", 3, &["holds no results"]);
    std::fs::remove_file(place.at("results/baselines/mip_fern/points.json")).unwrap();
    place.says("verify", 10, &["has no points.json"]);
    let mut here = augnerf(&["verify", "results/baselines/mip_fern", "--retrain", "1"]);
    assert_says(&demand(here.current_dir(ROOT), 2), &["git worktree add"]);
}

/// What the attack did comes out of the points' logs, and is held to them.
#[track_caller]
fn assert_attack(place: &Place, folder: &Path) {
    let lines = rows(&text(&folder.join("attack.csv")));
    let [line] = &lines[..] else { panic!("{lines:?}") };
    let cell = |column: &str| line[column].as_str();
    assert_eq!(["scene", "source", "row", "axes", "n"].map(cell), ["builtin", "run", "Aug-NeRF", "", "2"]);
    assert_eq!(line.len(), 5 + 6 * 12);
    let points = points_of(folder);
    let logs = points.iter().filter(|point| point["row"] == "Aug-NeRF");
    let logs = logs.map(|point| rows(&place.text(&format!("runs/tiny/points/{}/run/scalars.csv", point["id"]))));
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
    assert_found(place, &folder.join("attack.csv"), shift, &forged(shift), &["WRONG", "attack.csv, line 2"]);
}

/// A sweep of a second, collected, verified, trained again.
#[test]
fn a_collected_sweep_holds_and_trains_again() {
    let place = Place::new();
    let settings = "train.steps=20 train.log_every=5 eval.pictures=1 eval.mesh.resolution=16 eval.mesh.threshold=0.5 \
        eval.mesh.reference=\"none\"";
    let rows = [("Aug-NeRF", "method = \"aug-nerf\""), ("equal", "\"field.depth\" = 3")];
    let budget = "budget = { kind = \"seconds\", like = \"NeRF\" }\n";
    place.write("tiny.toml", tiny_sweep(&[0, 1], &["psnr"], settings, &rows) + budget);
    place.run("sweep run tiny.toml --quiet", 0);
    let folder = place.at("results/tiny");
    let said = place.run("verify --retrain 2", 0);
    assert_says(&said, &["tables and figures from 6 points", "trained again, every number to the last digit"]);
    assert!(folder.join("curves_builtin_psnr.svg").exists() && folder.join("scalars.csv.gz").exists());
    // A measurement that is empty is none that was left out.
    let points = folder.join("points.csv");
    let kept = text(&points);
    empty(&folder, "psnr");
    place.says("verify --retrain 2 --update", 10, &["psnr is '", "points.csv has ''"]);
    std::fs::write(&points, kept).unwrap();
    place.says("verify --update", 0, &["written anew"]);
    // A page with images of the runs cannot be made again: it is held to its hash.
    assert_says(&said, &["report.html: its hash is that under [pinned]"]);
    let points = points_of(&folder);
    assert!(points.iter().all(|row| row["mesh"].ends_with("not compared") && row["chamfer"].is_empty()), "{points:?}");
    assert_found(&place, &folder.join("report.html"), "NeRF", "NerF", &["SHA-256"]);
    assert_attack(&place, &folder);
    // Curves come from the logs that are kept.
    std::fs::remove_file(folder.join("scalars.csv.gz")).unwrap();
    place.says("verify", 10, &["curves_builtin_psnr.svg: the points do not make it"]);
    place.says("verify", 10, &["attack.csv: the points do not make it"]);
}
