//! Finished sweeps looked at again: two sweeps in one table, results and their folders, shipped sweeps.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use crate::common::assert_says;
use crate::common::files::{ending, entries, files, rows, text};
use crate::common::program::Place;
use crate::sweep_run::costs;
use augnerf::report::PointResult;
use augnerf::sweep::{Claim, Definition, Point, SHIPPED, Sharing, SweepFolder, TEMPLATE, expand};

const BASE: &str = r#"
title = "Which one?"
preset = "smoke"
scenes = ["builtin"]
seeds = [0, 1, 2]
metrics = ["psnr", "ssim", "lpips_squeeze"]
baseline = "NeRF"

[[row]]
name = "NeRF"

[[row]]
name = "A, long"
set = { method = "aug-nerf" }

[[row]]
name = "B"
set = { "regularizer.kind" = "tv", "regularizer.weight" = 1e-5 }

[[row]]
name = "C"
set = { "regularizer.kind" = "l1", "regularizer.weight" = 1e-5 }
"#;

/// PSNR of a row and seed: rows differ by more than seeds do, and the seeds of all rows rise and fall together.
fn psnr(point: &Point) -> f64 {
    let row = match point.places[0].row.as_str() {
        "NeRF" => 20.0,
        "A, long" => 21.0,
        "B" => 20.2,
        _ => 19.0,
    };
    let seed = point.config.seed as f64;
    row + 0.3 * seed + 0.01 * (row * 7.0 + seed * 3.0).sin()
}

/// A sweep's folder whose points are all done, without any training.
fn finished(dir: &Path, name: &str, definition: &str, fields: &[(&str, &str)]) -> (PathBuf, Vec<Point>) {
    let path = dir.join("runs").join(name);
    let folder = SweepFolder::new(&path);
    let definition = Definition::parse(definition, name).unwrap();
    let points = expand(&definition, None, &costs).unwrap();
    std::fs::create_dir_all(path.join("points")).unwrap();
    folder.begin(&definition, &points, None).unwrap();
    let known = [
        ("protocol", "1"),
        ("code_revision", "abc"),
        ("scene", "builtin"),
        ("width", "16"),
        ("views_evaluated", "3"),
        ("split", "test"),
    ];
    let known = known.iter().filter(|(name, _)| fields.iter().all(|(other, _)| other != name));
    let protocol: Vec<(String, String)> =
        known.chain(fields).map(|(name, text)| (name.to_string(), text.to_string())).collect();
    for point in &points {
        let metrics = [("psnr", Some(psnr(point))), ("ssim", Some(0.5)), ("lpips_squeeze", None)];
        let metrics = metrics.map(|(name, value)| (name.to_string(), value)).to_vec();
        let result = PointResult { metrics, protocol: protocol.clone(), inactive_levels: vec![] };
        folder.point(&point.id).begin(point).unwrap();
        folder.point(&point.id).finish(&result).unwrap();
    }
    (path, points)
}

#[test]
fn a_table_of_several_sweeps_has_a_folder_of_its_own() {
    let place = Place::new();
    finished(place.path(), "one", BASE, &[]);
    finished(place.path(), "two", &BASE.replace("[0, 1, 2]", "[3]"), &[]);
    place.run("sweep collect runs/one", 0);
    let whole = place.text("results/one/table.csv");
    let notes = place.text("results/one/table.md");
    assert_says(&notes, &["lpips_squeeze: empty, no LPIPS weights were given", "--remeasure"]);

    let collect = |further: &str, code: i32| place.run(&format!("sweep collect {further}"), code);
    let merge = |out: &str, code: i32| collect(&format!("runs/one --merge runs/two --out {out}"), code);
    assert_says(&collect("runs/one --merge runs/two", 2), &["--out"]);
    assert_says(&merge("results/one", 4), &["complete tables", "--out"]);
    // Somebody's own figures, some of which have names of ours.
    place.write("paper/rows_overview.svg", "mine");
    assert_says(&merge("paper", 4), &["paper holds files that are not a view", "--out"]);
    assert_eq!(place.text("paper/rows_overview.svg"), "mine");
    merge("both", 0);
    merge("both", 0);
    // Of results alone, without the points, the same comes out; their own tables are left to `verify`.
    collect("results/one --merge runs/two --out kept", 0);
    // A file of points also tells the method that a row sets, which these points' protocols lack.
    let numbers = |file: &str| -> Vec<[String; 3]> {
        let of_row = |row: &HashMap<String, String>| ["row", "psnr_mean", "psnr_p_holm"].map(|name| row[name].clone());
        rows(&place.text(file)).iter().map(of_row).collect()
    };
    assert_eq!(numbers("kept/table.csv"), numbers("both/table.csv"));
    assert_eq!(numbers("kept/table.csv").len(), 4);
    assert!(place.text("both/view.toml").contains("points_sha256"));
    place.says(
        "sweep collect results/one",
        2,
        &["a results folder, not points", "--merge FOLDER --out DIR", "verify --update"],
    );
    // A point that several lines show counts once.
    let shared = format!("{}/results/paper/fig_embedded", env!("CARGO_MANIFEST_DIR"));
    assert_eq!(rows(&text(&Path::new(&shared).join("points.csv"))).len(), 117);
    place.says(&format!("sweep status {shared}"), 0, &["results, 99 done"]);
    // The sweep's own tables are what they were, and a view beside them does not disturb their check.
    assert_eq!(place.text("results/one/table.csv"), whole);
    merge("results/view", 0);
    place.says("verify results/view", 0, &["a view of sweeps"]);
}

/// Results are written over those of the same sweep, and over nothing else.
#[test]
fn results_replace_only_those_of_their_sweep() {
    let place = Place::new();
    let at = |path: &str| place.at(path);
    let collect = |further: &str, code: i32| place.run(&format!("sweep collect {further}"), code);
    finished(place.path(), "one", BASE, &[]);
    finished(place.path(), "two", &BASE.replace("seeds = [0, 1, 2]", "seeds = [3]"), &[]);
    collect("runs/one --out tables", 0);
    let before = files(&at("tables"), &[]);
    let said = collect("runs/two --out tables", 4);
    assert_says(&said, &["tables holds results of the sweep 'one', which those of 'two' would replace", "--out"]);
    // A figure of somebody's own with a name of ours.
    place.write("paper/curves_mine.svg", "mine");
    let said = collect("runs/one --out paper", 4);
    assert_says(&said, &["paper holds files that are not results of a sweep", "--out"]);
    assert_eq!(entries(&at("paper")), [at("paper/curves_mine.svg")]);
    assert_eq!(text(&at("paper/curves_mine.svg")), "mine");
    // A view takes the place of a view alone.
    collect("runs/one --merge runs/two --out view", 0);
    assert_says(&collect("runs/one --out view", 4), &["view holds files that are not results of a sweep"]);
    collect("runs/one --out tables", 0);
    assert!(files(&at("tables"), &[]) == before, "the same files with the same bytes");
    // Beside hidden files, and beside seconds of steps, which a sweep takes over.
    place.write("results/named/.gitkeep", "");
    place.write("results/named/step_seconds.json", "");
    collect("runs/one --name named", 0);
    collect("runs/one --name named", 0);
    // In the sweep's own folder its results may have any of its names.
    std::fs::rename(at("runs/two"), at("own")).unwrap();
    collect("own", 0);
    collect("own --name another", 0);
    assert_says(&text(&at("own/results/provenance.toml")), &["name = \"another\""]);
    // A sweep is not trained before.
    place.write("mine.toml", BASE);
    std::fs::rename(at("tables"), at("results/mine")).unwrap();
    place.says("sweep run --create mine.toml", 4, &["results/mine holds results of the sweep 'one'"]);
    assert!(!at("runs/mine").exists());
}

#[test]
fn two_sweeps_stand_in_one_table_where_they_agree() {
    let place = Place::new();
    let later = BASE
        .replace("[0, 1, 2]", "[3, 4]")
        .replace("\"tv\", \"regularizer.weight\" = 1e-5", "\"tv\", \"regularizer.weight\" = 1e-4");
    finished(place.path(), "monday", BASE, &[]);
    finished(place.path(), "tuesday", &later, &[]);
    let merge = "sweep collect runs/monday --merge runs/tuesday --out both";
    place.run(merge, 0);
    let table = rows(&place.text("both/table.csv"));
    let names: Vec<(&str, &str)> = table.iter().map(|row| (row["row"].as_str(), row["psnr_n"].as_str())).collect();
    let expected = [("NeRF", "5"), ("A, long", "5"), ("B", "3"), ("C", "5"), ("B (tuesday)", "2")];
    assert_eq!(names, expected, "seeds of equal settings join, other settings do not");
    let other = &table[4];
    assert_eq!((other["baseline"].as_str(), other["psnr_pairs"].as_str()), ("NeRF", "2"));
    assert!(place.text("both/table.md").contains("a view of monday and tuesday"));
    // What is left to do of any sweep decides the exit code.
    let later_points = expand(&Definition::parse(&later, "tuesday").unwrap(), None, &costs).unwrap();
    let of_b = later_points.iter().find(|point| point.places[0].row == "B").unwrap();
    let tuesday = SweepFolder::new(&place.at("runs/tuesday"));
    std::fs::remove_file(tuesday.point(&of_b.id).path().join("result.json")).unwrap();
    assert_says(&place.run(merge, 11), &["19 of 20 points are done", "1 are waiting"]);

    finished(place.path(), "wednesday", &later, &[("code_revision", "def"), ("width", "32")]);
    let refused = "sweep collect runs/monday --merge runs/wednesday --out third";
    place.says(refused, 9, &["width is `16` in NeRF", "`32`", "they differ in code_revision as well", "--force"]);
    place.run(&format!("{refused} --force"), 0);
    assert_says(
        &place.text("third/table.md"),
        &["NOT COMPARABLE", "B (wednesday) (differs from the scene's first row in width, code_revision)"],
    );
}

#[test]
fn a_new_sweep_file_runs_as_it_is_and_explains_every_key() {
    let place = Place::new();
    place.says("sweep new", 0, &["sweep.toml", "augnerf sweep plan sweep.toml"]);
    let file = place.at("sweep.toml");
    let definition = Definition::read(&file).unwrap();
    assert_eq!(expand(&definition, None, &costs).unwrap().len(), 8);
    place.says("sweep new", 4, &["sweep.toml exists already"]);
    // Every key of the page's tables has its line.
    let page = text(&Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/sweep-file.md"));
    let (schema, _) = page.split_once("## Published numbers").unwrap();
    let keys: Vec<&str> = schema.lines().filter_map(|line| line.strip_prefix("| `")?.split('`').next()).collect();
    assert!(keys.len() > 35, "{keys:?}");
    let explains = |key: &str| {
        let sections = [format!("[{key}]"), format!("[[{key}]]")];
        let assigns = |line: &str| line.contains(&format!(" {key} =")) || sections.contains(&line.trim().into());
        TEMPLATE.lines().any(|line| assigns(&format!(" {}", line.trim_start_matches("# "))))
    };
    keys.iter().for_each(|key| assert!(explains(key), "the new file does not explain `{key}`"));
}

#[test]
fn shipped_sweeps_are_written_with_what_they_extend() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("sweeps");
    let place = Place::new();
    place.run("sweep new mine.toml --from tab4_fern", 0);
    let mine = Definition::read(&place.at("mine.toml")).unwrap();
    assert_eq!(mine, Definition::read(&folder.join("paper/tab4_fern.toml")).unwrap());
    // The base is there already, as it is shipped.
    place.run("sweep new second.toml --from tab4_embedded", 0);
    place.write("tab4_ablation.toml", "changed");
    place.says("sweep new third.toml --from tab4_fern", 4, &["tab4_ablation.toml exists"]);
    place.says("sweep new x.toml --from nothing", 2, &["--from nothing", "smoke"]);
}

/// A bare name is the shipped sweep of that name, wherever one is; a path of an earlier time is told the present one.
#[test]
fn shipped_sweeps_are_read_by_name() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("sweeps");
    let files = ending(&folder, ".toml");
    assert_eq!(files.len(), SHIPPED.len());
    for file in files {
        let name = file.file_stem().unwrap();
        assert_eq!(Definition::read(Path::new(name)).unwrap(), Definition::read(&file).unwrap(), "{name:?}");
    }
    let place = Place::new();
    std::fs::create_dir(place.at("smoke")).unwrap();
    place.says("sweep run --create smoke", 0, &["runs/smoke"]);
    for old in ["sweeps/tab4_fern.toml", "tab4_fern.toml"] {
        let now = "the shipped sweep of this name is sweeps/paper/tab4_fern.toml";
        place.says(&format!("sweep plan {old}"), 2, &[old, now]);
    }
    place.says("sweep plan tab9", 2, &["tab9", "the name of a shipped one"]);
    // A file of one's own comes first.
    place.write("tab4_fern", "title = 3");
    place.says("sweep plan tab4_fern", 2, &["tab4_fern: ", "title"]);
}

#[test]
fn plans_without_data_say_so_and_points_that_begin_have_no_step() {
    let place = Place::new();
    let absent = BASE.replace("\"builtin\"", "\"orchids\"");
    place.write("absent.toml", &absent);
    let said = place.run("sweep plan absent.toml", 8);
    assert_says(&said, &["12 x no data", "orchids", "nothing measured", "--data-root"]);
    assert!(!said.contains("0 s in total"), "{said}");

    let (folder, points) = finished(place.path(), "one", BASE, &[]);
    let point = SweepFolder::new(&folder).point(&points[0].id);
    std::fs::remove_file(point.path().join("result.json")).unwrap();
    let claim = Claim::take(point.path(), Sharing::Locks).unwrap().unwrap();
    let said = place.run("sweep status runs/one", 11);
    assert!(said.contains("starting") && !said.contains("of 0"), "{said}");
    claim.progress.begin(0, 250);
    place.says("sweep status runs/one", 11, &["step 0 of 250"]);
    drop(claim);
}
