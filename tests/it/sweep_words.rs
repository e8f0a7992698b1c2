//! What commands of sweeps say and how they end: exit codes, ranges of seeds, pruning, folders of somebody else.

use std::fs;

use crate::common::assert_says;
use crate::common::files::{entries, points_of, rows};
use crate::common::program::Place;
use crate::sweep_run::costs;
use augnerf::sweep::{Definition, expand};

const TINY: &str = r#"
title = "tiny"
preset = "smoke"
scenes = ["builtin"]
seeds = [0]
metrics = ["psnr"]
set = { "data.width" = 16, "field.width" = 16, "sampling.coarse" = 8, "sampling.fine" = 8, "train.rays" = 32, "train.steps" = 2, "eval.pictures" = 1 }
row = [{ name = "NeRF" }, { name = "TV, weak", set = { "regularizer.kind" = "tv", "regularizer.weight" = 1e-9 } }]
"#;

/// A folder with `sweeps/tiny.toml`.
fn workplace() -> Place {
    Place::with("sweeps/tiny.toml", TINY)
}

#[test]
fn results_of_nothing_do_not_hold() {
    let place = workplace();
    place.run("sweep run --create sweeps/tiny.toml --seeds 0-2,7", 0);
    place.run("sweep collect runs/tiny", 11);
    place.says("report runs/tiny", 2, &["runs/tiny: the folder of a sweep"]);
    let said = place.run("verify results/tiny", 10);
    assert_says(&said, &["is 'waiting', and no [[missing]]", "no point is done, so that they show no results"]);
    assert!(!said.contains("tables and figures from"), "{said}");
    place.says("sweep run --create sweeps/tiny.toml --seeds 3-1", 2, &["'3-1' is no range"]);
}

/// `report` makes the page that `collect` made where the runs are there, and does not replace it by less.
#[test]
fn a_report_of_results_is_the_page_of_collect() {
    let place = workplace();
    place.run("sweep run sweeps/tiny.toml --quiet", 0);
    let page = || place.text("results/tiny/report.html");
    let collected = page();
    assert!(collected.contains("id=\"views\""));
    place.run("report results/tiny", 0);
    assert!(collected == page(), "the same page");
    place.says("verify results/tiny", 0, &["holds"]);
    fs::rename(place.at("runs"), place.at("moved")).unwrap();
    place.says("report results/tiny", 4, &["would lack views", "--out FILE"]);
    assert!(collected == page(), "untouched");
    place.says("report results/tiny --out small.html", 0, &["no runs beside these results", "page: small.html"]);
    assert!(!place.text("small.html").contains("id=\"views\""));
}

/// Settings have the values that runs used, a point in several positions says so, and what all points share is in one place.
#[test]
fn points_say_what_was_used_and_what_they_share() {
    let place = workplace();
    let (head, _) = TINY.split_once("row = ").unwrap();
    let in_positions = r#"combine = "one-at-a-time"
row = [{ name = "NeRF" }, { name = "Aug-NeRF", axes = true, set = { method = "aug-nerf" } }]
axis = [{ name = "PGD steps", keys = ["perturb.t.steps"], values = [1, 3] }, { name = "layer", keys = ["perturb.injection_layer"], values = [1, 2] }]
"#;
    place.write("sweeps/tiny.toml", format!("{head}{in_positions}"));
    place.run("sweep run sweeps/tiny.toml --quiet", 0);
    let results = place.at("results/tiny");
    let csv = place.text("results/tiny/points.csv");
    let head: Vec<&str> = csv.lines().next().unwrap().split(',').collect();
    let first = ["id", "scene", "row", "axes", "axis.PGD_steps", "axis.layer"];
    assert_eq!((&head[..6], head.iter().any(|name| name.contains(' '))), (&first[..], false));
    let points = points_of(&results);
    let of = |row: &str, axes: &str| points.iter().find(|point| point["row"] == row && point["axes"] == axes).unwrap();
    let names = ["set.perturb.t.steps", "set.perturb.injection_layer", "perturb.t.epsilon", "position", "positions"];
    for (row, axes, cells) in [
        ("NeRF", "PGD steps = 1", ["", "", "", "1", "4"]),
        ("NeRF", "layer = 2", ["", "", "", "4", "4"]),
        ("Aug-NeRF", "PGD steps = 1", ["1", "2", "0.5", "1", "1"]),
        ("Aug-NeRF", "PGD steps = 3", ["3", "2", "0.5", "1", "1"]),
        ("Aug-NeRF", "layer = 1", ["3", "1", "0.5", "1", "1"]),
        ("Aug-NeRF", "layer = 2", ["3", "2", "0.5", "1", "1"]),
    ] {
        assert_eq!(names.map(|name| of(row, axes)[name].as_str()), cells, "{row} {axes}");
    }
    assert!(head.contains(&"set.method") && !head.contains(&"steps") && points[0]["steps"] == "2");
    place.run("verify", 0);
    let before = place.text("results/tiny/provenance.toml");
    let forged = before.replace("[constants]\n", "[constants]\nconfig_hash = \"habc\"\n");
    place.write("results/tiny/provenance.toml", forged);
    place.says("verify", 10, &["[constants] are not the fields that all points share"]);
}

/// A reworded title is refused at once, and says that it costs nothing.
#[test]
fn a_changed_definition_is_refused_before_scenes_are_loaded() {
    let place = workplace();
    place.run("sweep run --create sweeps/tiny.toml", 0);
    place.write("sweeps/tiny.toml", TINY.replace("title = \"tiny\"", "title = \"small\""));
    let words = ["differs in title", "--extend costs no training"];
    place.says("sweep run sweeps/tiny.toml", 2, &words);
    place.write("sweeps/tiny.toml", TINY.replace("\"train.rays\" = 32", "\"train.rays\" = 100000"));
    place.says("sweep run sweeps/tiny.toml", 2, &["differs in set.train.rays"]);
    place.says("sweep run sweeps/tiny.toml --extend", 2, &["train.rays"]);
}

#[test]
fn a_sweep_says_how_it_ended() {
    let place = workplace();
    place.run("sweep run --create sweeps/tiny.toml", 0);
    place.run("sweep run-point runs/tiny --index 0", 0);
    place.run("sweep run sweeps/tiny.toml", 0);
    let first = entries(&place.at("runs/tiny/points")).remove(0);
    fs::remove_file(first.join("result.json")).unwrap();
    fs::write(first.join("failed.json"), r#"{"reason":"no","exit_code":5}"#).unwrap();
    place.run("sweep run sweeps/tiny.toml", 7);
    place.says("sweep status runs/tiny", 7, &["row NeRF: ", " of 1 done", "row TV, weak: ", ", 1 failed"]);
    // A point is no run; its run is in it.
    for command in ["eval", "resume", "render"] {
        place.says(&format!("{command} {}", first.display()), 5, &["is a point of a sweep; its run is", "/run"]);
    }
}

/// A sweep's folder of somebody else leads no write out of it.
#[cfg(unix)]
#[test]
fn links_in_a_sweep_lead_no_write_out_of_it() {
    use std::os::unix::fs::symlink;
    let place = workplace();
    place.run("sweep run sweeps/tiny.toml --out own --quiet", 0);
    let victim = place.at("victim");
    place.write("victim/table.csv", "keep");
    let (points, own) = (place.at("own/points"), place.at("own"));
    let point = entries(&points).remove(0);
    let again = "sweep run sweeps/tiny.toml --out own --quiet --retry-failed";
    // Of a point whose run is to be looked at again.
    fs::remove_file(point.join("result.json")).unwrap();
    for (entry, command) in [
        (point.clone(), again),
        (point.join("run"), again),
        (points, again),
        (own.join("results"), again),
        (own.join("results"), "sweep collect own"),
    ] {
        let aside = place.at("aside");
        fs::rename(&entry, &aside).unwrap();
        symlink(&victim, &entry).unwrap();
        place.says(command, 4, &["is a symbolic link"]);
        fs::remove_file(&entry).unwrap();
        fs::rename(&aside, &entry).unwrap();
        assert_eq!(entries(&victim), [victim.join("table.csv")]);
        assert_eq!(place.text("victim/table.csv"), "keep");
    }
    place.run(again, 0);
}

#[test]
fn mistakes_in_sweep_files_are_answered_with_what_to_do() {
    let place = workplace();
    let mine = "extends = \"tab4_ablation.toml\"\n[[row]]\nname = \"My jitter\"\n";
    place.run("sweep new tab4_ablation.toml --from tab4_ablation", 0);
    place.write("mine.toml", mine);
    place.says("sweep plan mine.toml", 2, &["the paper has no row 'My jitter' in tab4", "add `ours = true`"]);
    let small = "sweep plan fig_strength_location --scenes builtin --preset smoke";
    place.says(small, 2, &["it must be 1 to 4", "fig_embedded` is for small networks"]);
    place.says("sweep run fern", 2, &["sweep file fern", "TOML", "`augnerf train --data fern`"]);
    // Names with spaces are quoted in commands, and - is standard output.
    place.says("sweep new 'my sweep.toml'", 0, &["augnerf sweep run 'my sweep.toml'"]);
    assert!(Definition::parse(&place.printed("sweep new -"), "-").is_ok());
    assert!(place.printed("sweep new - --from regularizers_chair").contains("+ distortion Reg."));
    place.says("sweep new - --json", 2, &["--json: - prints the sweep file itself"]);
    assert!(!place.at("-").exists());
}

/// Rows are refused together: those of wrong settings, and those that do not suit the scene. LPIPS is not the point.
#[test]
fn rows_that_cannot_run_are_named_together() {
    let place = workplace();
    let write = |text: String| place.write("sweeps/tiny.toml", text);
    let cases: [(&str, &[&str]); 3] = [
        (
            r#"{ name = "A", set = { "train.lr" = 1 } }, { name = "B", set = { "train.rays" = 20000 } },
               { name = "C", set = { "train.steps" = 7 } }, { name = "D", set = { "train.steps" = 7 } }"#,
            &[
                "rows that cannot run: A (builtin): its set: train.lr: unknown key 'train.lr'; did you mean 'train.learning_rate'?",
                "; D (builtin): rows 'C' and 'D' have the same configuration",
                "; B (builtin): train.rays = 20000",
            ],
        ),
        (
            r#"{ name = "A", set = { method = "tv" } }, { name = "B", preset = "fast", set = { method = "mip-nerf" } }"#,
            &[
                "A (builtin): its set: method: tv is a regularizer; use regularizer.kind=tv",
                "; B (builtin): field.encoding = \"hash\" is not that of method mip-nerf: integrated is for mip-nerf",
            ],
        ),
        // 40 views of 16 x 16 pixels, whose rays end 6 from the cameras.
        (
            r#"{ name = "A", set = { "train.rays" = 20000 } }, { name = "B", set = { "regularizer.kind" = "l1",
               "regularizer.domain" = [[90.0, 90.0, 90.0], [91.0, 91.0, 91.0]] } }"#,
            &["rows that cannot run: A (builtin): train.rays = 20000", "; B (builtin): regularizer.domain: the box"],
        ),
    ];
    let measured = TINY.replace("\"psnr\"", "\"psnr\", \"lpips_squeeze\"");
    for (rows, words) in cases {
        write(measured.replace("row = [", &format!("row = [{}, ", rows.replace("\n", ""))));
        for command in ["run --create", "plan", "run"] {
            let said = place.run(&format!("sweep {command} sweeps/tiny.toml"), 2);
            assert_says(&said, words);
            let absent = ["NeRF (", "LPIPS"];
            assert!(absent.iter().all(|word| !said.contains(word)) && !place.at("runs").exists(), "{said}");
        }
    }
    // A folder that is extended has one list, too.
    write(TINY.into());
    place.run("sweep run --create sweeps/tiny.toml", 0);
    write(TINY.replace("row = [", &format!("row = [{}, ", cases[0].0.replace("\n", ""))));
    place.says("sweep run --create sweeps/tiny.toml --extend", 2, cases[0].1);
    write(TINY.replace("field.width", "field.widht"));
    place.says("sweep run --create sweeps/tiny.toml", 2, &["no row can run: [set] field.widht: unknown key"]);
}

/// 40 views of 16 x 16 pixels are 10,240; two steps of 32 rays are 64.
#[test]
fn every_table_says_how_often_a_pixel_was_seen() {
    let place = workplace();
    let twice = r#"row = [{ name = "Twice", set = { "train.steps" = 4 } }, "#;
    place.write("sweeps/tiny.toml", TINY.replace("row = [", twice));
    let said = place.run("sweep run sweeps/tiny.toml", 0);
    let note =
        "each training pixel was seen 0.0063 times, 0.013 times in Twice (epochs: steps x rays of a step / training";
    let read = |name: &str| place.text(&format!("results/tiny/{name}"));
    assert_says(&said, &["checking 3 configurations of 3 points on builtin", note]);
    assert_says(&read("table.md"), &[&note.replace("each", "Each")]);
    assert_says(&read("table.tex"), &["each training pixel was seen 0.0063 times"]);
    assert_says(&read("report.html"), &["each training pixel seen less than once: ", "0.0063 to 0.013 times"]);
    let epochs: Vec<String> = rows(&read("points.csv")).iter().map(|row| row["epochs"].clone()).collect();
    assert_eq!(epochs, ["0.0125", "0.00625", "0.00625"]);
}

#[test]
fn a_large_sweep_is_summed_up() {
    let place = workplace();
    place.run("sweep run --create sweeps/tiny.toml --seeds 0-59", 0);
    let status = |more: &str| place.run(&format!("sweep status runs/tiny {more}"), 11);
    let waiting = |said: &str| said.lines().filter(|line| line.starts_with("waiting")).count();
    let said = status("");
    assert_says(&said, &["of 120 points, those that run or failed are listed; --all", "row NeRF: 0 of 60 done"]);
    assert_eq!((waiting(&said), waiting(&status("--all"))), (0, 120));
}

#[test]
fn status_says_why_the_last_worker_ended() {
    let place = workplace();
    place.run("sweep run --create sweeps/tiny.toml", 0);
    let status = || place.run("sweep status runs/tiny", 11);
    assert!(!status().contains("worker"));
    // A file where the first point's run belongs.
    let definition = Definition::read(&place.at("sweeps/tiny.toml")).unwrap();
    let id = &expand(&definition, None, &costs).unwrap()[0].id;
    let in_the_way = format!("runs/tiny/points/{id}/run");
    place.write(&in_the_way, "");
    place.run("sweep run sweeps/tiny.toml", 4);
    assert_says(&status(), &["the last worker ended: runs/tiny/points/", id]);
    // What a full disk leaves.
    place.write("runs/tiny/worker.txt", "");
    assert!(!status().contains("worker"));
    fs::remove_file(place.at(&in_the_way)).unwrap();
    place.run("sweep run sweeps/tiny.toml --quiet", 0);
    assert!(!place.run("sweep status runs/tiny", 0).contains("worker"));
}
