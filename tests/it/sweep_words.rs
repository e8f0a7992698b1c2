//! What commands of sweeps say and how they end: estimates, exit codes, ranges of seeds, pruning, folders of somebody else.

use std::fs;
use std::time::Duration;

use crate::common::assert_says;
use crate::common::files::{entries, points_of};
use crate::common::program::{Place, augnerf, demand};
use crate::sweep_run::Costs;
use augnerf::runtime::Runtime;
use augnerf::sweep::{Definition, Point, Trainings, expand, plan_costs};

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
    let place = Place::new();
    fs::create_dir(place.at("sweeps")).unwrap();
    place.write("sweeps/tiny.toml", TINY);
    place
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
    let page = place.at("results/tiny/report.html");
    let collected = fs::read_to_string(&page).unwrap();
    assert!(collected.contains("id=\"views\""));
    place.run("report results/tiny", 0);
    assert!(collected == fs::read_to_string(&page).unwrap(), "the same page");
    place.says("verify results/tiny", 0, &["holds"]);
    fs::rename(place.at("runs"), place.at("moved")).unwrap();
    place.says("report results/tiny", 4, &["would lack views", "--out FILE"]);
    assert!(collected == fs::read_to_string(&page).unwrap(), "untouched");
    place.says("report results/tiny --out small.html", 0, &["no runs beside these results", "page: small.html"]);
    assert!(!fs::read_to_string(place.at("small.html")).unwrap().contains("id=\"views\""));
}

/// Settings have the values that runs used, a point in several positions says so, and what all points share is in one place.
#[test]
fn points_say_what_was_used_and_what_they_share() {
    let place = workplace();
    let (head, _) = TINY.split_once("row = ").unwrap();
    let rows = r#"combine = "one-at-a-time"
row = [{ name = "NeRF" }, { name = "Aug-NeRF", axes = true, set = { method = "aug-nerf" } }]
axis = [{ name = "PGD steps", keys = ["perturb.t.steps"], values = [1, 3] }, { name = "layer", keys = ["perturb.injection_layer"], values = [1, 2] }]
"#;
    place.write("sweeps/tiny.toml", format!("{head}{rows}"));
    place.run("sweep run sweeps/tiny.toml --quiet", 0);
    let results = place.at("results/tiny");
    let csv = fs::read_to_string(results.join("points.csv")).unwrap();
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
    let provenance = results.join("provenance.toml");
    let before = fs::read_to_string(&provenance).unwrap();
    fs::write(&provenance, before.replace("[constants]\n", "[constants]\nconfig_hash = \"habc\"\n")).unwrap();
    place.says("verify", 10, &["[constants] are not the fields that all points share"]);
}

/// A reworded title is refused at once, and says that it costs nothing.
#[test]
fn a_changed_definition_is_refused_before_scenes_are_loaded() {
    let place = workplace();
    place.run("sweep run --create sweeps/tiny.toml", 0);
    let file = place.at("sweeps/tiny.toml");
    fs::write(&file, TINY.replace("title = \"tiny\"", "title = \"small\"")).unwrap();
    place.says(
        "sweep run sweeps/tiny.toml",
        2,
        &["differs in title ('tiny' is now 'small')", "--extend costs no training"],
    );
    fs::write(&file, TINY.replace("\"train.rays\" = 32", "\"train.rays\" = 100000")).unwrap();
    place.says("sweep run sweeps/tiny.toml", 2, &["differs in set.train.rays"]);
    place.says("sweep run sweeps/tiny.toml --extend", 2, &["train.rays"]);
}

#[test]
fn a_sweep_says_how_long_it_takes_and_how_it_ended() {
    let place = workplace();
    place.run("sweep run --create sweeps/tiny.toml", 0);
    place.run("sweep run-point runs/tiny --index 0", 0);
    // Chosen rows are judged alone.
    place.run("sweep collect runs/tiny --rows NeRF --out nerf", 0);
    place.run("sweep collect runs/tiny --rows 'NeRF,TV, weak' --out both", 11);
    place.says("sweep collect runs/tiny --rows TV --out both", 2, &["the rows are 'NeRF', 'TV, weak'"]);
    place.says("sweep run sweeps/tiny.toml", 0, &["1 of 2 points are left: about ", "here, one after the other"]);
    fs::remove_file(entries(&place.at("runs/tiny/points"))[0].join("result.json")).unwrap();
    fs::write(entries(&place.at("runs/tiny/points"))[0].join("failed.json"), r#"{"reason":"no","exit_code":5}"#)
        .unwrap();
    place.run("sweep run sweeps/tiny.toml", 7);
    place.says("sweep status runs/tiny", 7, &["row NeRF: ", " of 1 done", "row TV, weak: ", ", 1 failed"]);
    // A point is no run; its run is in it.
    for command in ["eval", "resume", "render"] {
        let point = entries(&place.at("runs/tiny/points"))[0].display().to_string();
        place.says(&format!("{command} {point}"), 5, &["is a point of a sweep; its run is", "/run"]);
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
    fs::create_dir(&victim).unwrap();
    fs::write(victim.join("table.csv"), "keep").unwrap();
    let (points, own) = (place.at("own/points"), place.at("own"));
    let point = entries(&points).remove(0);
    let again = "sweep run sweeps/tiny.toml --out own --quiet --retry-failed";
    for (entry, commands) in [
        (point.clone(), &[again][..]),
        (point.join("run"), &[again]),
        (points.clone(), &[again]),
        (own.join("results"), &[again, "sweep collect own"]),
    ] {
        let aside = place.at("aside");
        fs::rename(&entry, &aside).unwrap();
        if entry == point.join("run") {
            fs::rename(point.join("result.json"), place.at("result.json")).unwrap();
        }
        symlink(&victim, &entry).unwrap();
        for command in commands {
            place.says(command, 4, &["is a symbolic link"]);
        }
        fs::remove_file(&entry).unwrap();
        fs::rename(&aside, &entry).unwrap();
        if entry == point.join("run") {
            fs::rename(place.at("result.json"), point.join("result.json")).unwrap();
        }
        assert_eq!(entries(&victim), [victim.join("table.csv")]);
        assert_eq!(fs::read_to_string(victim.join("table.csv")).unwrap(), "keep");
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
    // Names with spaces are quoted in commands, and - is standard output.
    place.says("sweep new 'my sweep.toml'", 0, &["augnerf sweep run 'my sweep.toml'"]);
    assert!(Definition::parse(&place.printed("sweep new -"), "-").is_ok());
    assert!(place.printed("sweep new - --from regularizers_chair").contains("+ distortion Reg."));
    place.says("sweep new - --json", 2, &["--json: - prints the sweep file itself"]);
    assert!(!place.at("-").exists());
}

/// When time is over, costs follow from the first shape's.
#[test]
fn a_plan_stops_by_the_clock() {
    let definition = Definition::parse(TINY, "tiny.toml").unwrap();
    let points = expand(&definition, None, &Costs).unwrap();
    let trainings = Trainings::new(Runtime::new("cpu", Some(1)).unwrap(), (Vec::new(), String::new()), false, &());
    let costs = |limit: Duration| {
        let mut found = Vec::new();
        let points: Vec<&Point> = points.iter().collect();
        let each = |group: augnerf::sweep::CostGroup| {
            found.push((group.measured, group.cost.seconds_per_step));
            Ok(())
        };
        plan_costs(&points, &trainings, limit, each).unwrap();
        found
    };
    let measured = |costs: &[(bool, f64)]| costs.iter().map(|cost| cost.0).collect::<Vec<_>>();
    assert_eq!(measured(&costs(Duration::MAX)), [true, true]);
    let stopped = costs(Duration::ZERO);
    assert_eq!(measured(&stopped), [true, false]);
    assert!(stopped.iter().all(|cost| cost.1 > 0.0) && stopped[0].1 != stopped[1].1, "{stopped:?}");
}

/// Rows are refused together: those of wrong settings, and those that do not suit the scene. LPIPS is not the point.
#[test]
fn rows_that_cannot_run_are_named_together() {
    let place = workplace();
    let file = place.at("sweeps/tiny.toml");
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
                "; B (builtin): preset fast sets field.encoding = \"hash\", which method mip-nerf cannot use; choose one of the presets smoke, cpu",
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
        fs::write(&file, measured.replace("row = [", &format!("row = [{}, ", rows.replace("\n", "")))).unwrap();
        for command in ["run --create", "plan", "run"] {
            let said = place.run(&format!("sweep {command} sweeps/tiny.toml"), 2);
            assert_says(&said, words);
            assert!(!said.contains("NeRF (") && !said.contains("LPIPS") && !place.at("runs").exists(), "{said}");
            assert!(!said.contains("timing some steps"), "{said}");
        }
    }
    // A folder that is extended has one list, too.
    fs::write(&file, TINY).unwrap();
    place.run("sweep run --create sweeps/tiny.toml", 0);
    fs::write(&file, TINY.replace("row = [", &format!("row = [{}, ", cases[0].0.replace("\n", "")))).unwrap();
    place.says("sweep run --create sweeps/tiny.toml --extend", 2, cases[0].1);
    fs::write(&file, TINY.replace("field.width", "field.widht")).unwrap();
    place.says("sweep run --create sweeps/tiny.toml", 2, &["no row can run: [set] field.widht: unknown key"]);
}

/// Two fields of 16 layers of 4,096 neurons have 2 GB of weights.
#[cfg(target_os = "linux")]
#[test]
fn a_check_makes_no_field() {
    let place = workplace();
    let file = place.at("sweeps/tiny.toml");
    let wide = r#"row = [{ name = "Wide", set = { "field.width" = 4096, "field.depth" = 16 } }, "#;
    fs::write(&file, TINY.replace("row = [", wide)).unwrap();
    let begin = "ulimit -v 1500000; exec \"$0\" sweep run --create sweeps/tiny.toml --threads 1";
    let mut command = std::process::Command::new("sh");
    command.args(["-c", begin, env!("CARGO_BIN_EXE_augnerf")]).current_dir(place.path());
    let said = demand(&mut command, 0);
    assert_says(&said, &["checking 3 configurations of 3 points on builtin", "runs/tiny: 3 points"]);
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
    let results = place.at("results/tiny");
    let read = |name: &str| fs::read_to_string(results.join(name)).unwrap();
    assert_says(&said, &["checking 3 configurations of 3 points on builtin", "timing some steps", note]);
    assert_says(&read("table.md"), &[&note.replace("each", "Each")]);
    assert_says(&read("table.tex"), &["each training pixel was seen 0.0063 times"]);
    assert_says(&read("report.html"), &["less than one epoch: each training pixel", "0.0063 to 0.013 times"]);
    let points = read("points.csv");
    let of_rows = |text: &str| -> Vec<String> {
        crate::common::files::rows(text).iter().map(|row| row["epochs"].clone()).collect()
    };
    assert_eq!(of_rows(&points), ["0.0125", "0.00625", "0.00625"]);
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
    let id = &expand(&definition, None, &Costs).unwrap()[0].id;
    let in_the_way = place.at("runs/tiny/points").join(id).join("run");
    fs::create_dir_all(in_the_way.parent().unwrap()).unwrap();
    fs::write(&in_the_way, "").unwrap();
    place.run("sweep run sweeps/tiny.toml", 4);
    assert_says(&status(), &["the last worker ended: runs/tiny/points/", id]);
    // What a full disk leaves.
    place.write("runs/tiny/worker.txt", "");
    assert!(!status().contains("worker"));
    fs::remove_file(in_the_way).unwrap();
    place.run("sweep run sweeps/tiny.toml --quiet", 0);
    assert!(!place.run("sweep status runs/tiny", 0).contains("worker"));
}

#[cfg(unix)]
#[test]
fn words_that_are_not_utf_8_are_named() {
    use std::os::unix::ffi::OsStrExt;
    let odd = std::ffi::OsStr::from_bytes(b"train.steps=\xff");
    let said = demand(augnerf(&["sweep", "plan", "smoke", "--set"]).arg(odd), 2);
    assert_says(&said, &[r#"not UTF-8: "train.steps=\xFF""#]);
}
