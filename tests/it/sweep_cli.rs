//! `augnerf sweep` as a user meets it: killed, shared, failing, resumed, collected.

use std::sync::LazyLock;

use crate::common::assert_says;
use crate::common::files::{entries, files, json, newest, points_of, rows, text};
use crate::common::program::{Place, set, tiny_sweep};
use augnerf::run::DepthErrors;

/// Runs of about a second: two methods, two seeds, the embedded scene at 16 x 16.
static TINY: LazyLock<String> = LazyLock::new(|| {
    let settings = "train.chunk=32 train.steps=60 train.checkpoint_every=10 eval.pictures=0";
    let calibrated = "method = \"aug-nerf\", \"perturb.attack\" = \"calibrated\"";
    tiny_sweep(&[0, 1], &["psnr", "ssim", "tv"], settings, &[("Aug-NeRF", calibrated)])
});

/// A working folder with a sweep file in it.
fn workplace(definition: &str) -> Place {
    Place::with("tiny.toml", definition)
}

/// The sweep file with one seed and so many steps.
fn short(steps: usize) -> String {
    TINY.replace("seeds = [0, 1]", "seeds = [0]").replace("= 60", &format!("= {steps}"))
}

/// Methods with and without fields beside one another: each trains, and its cells of what it has not stay empty.
#[test]
fn a_table_has_rows_of_every_method() {
    let small = "set = { \"srn.width\" = 8, \"nv.resolution\" = 8, \"nv.divide\" = 16, \"nv.warp_resolution\" = 4, \"llff.planes\" = 8, \
                 \"llff.window\" = 16, \"llff.crop\" = 8, method = ";
    let methods = ["srn", "nv", "llff"];
    let further = methods.map(|method| format!("\n[[row]]\nname = \"{method}\"\n{small}\"{method}\" }}\n"));
    let place = workplace(&(short(4) + &further.concat()));
    place.run("sweep run tiny.toml --quiet", 0);
    let points = points_of(&place.at("results/tiny"));
    let of = |row: &str| points.iter().find(|point| point["row"] == row).unwrap();
    for method in methods {
        let point = of(method);
        assert!(point["psnr"].parse::<f64>().unwrap() > 3.0, "{point:?}");
        assert!(!point[method].is_empty() && point["field_width"].is_empty() && point["tv"].is_empty(), "{point:?}");
    }
    assert!(!of("NeRF")["tv"].is_empty() && of("NeRF")["srn"].is_empty());
}

/// Of a capture the box is what its cameras look at, in a table as in a measurement of the same run.
#[test]
fn smoothness_of_a_point_is_that_of_measure() {
    let of_capture = short(4).replace("\"builtin\"", "\"ring\"");
    let place = workplace(&of_capture.replace("[set]", "[set]\n\"data.kind\" = \"transforms\""));
    place.run("data export-builtin ring --width 16", 0);
    place.run("sweep run tiny.toml --data-root . --quiet", 0);
    let point = points_of(&place.at("results/tiny")).remove(0);
    let run = place.at("runs/tiny/points").join(&point["id"]).join("run");
    place.run(&format!("eval --smoothness --quiet {}", run.display()), 0);
    let measured = rows(&text(&run.join("smoothness.csv"))).pop().unwrap();
    let number = |cell: &str| cell.parse::<f64>().unwrap();
    for metric in ["l1", "tv", "laplacian", "largest_density", "occupied"] {
        assert_eq!(number(&point[metric]), number(&measured[metric]), "{metric}");
    }
    assert_eq!(point["smoothness_domain"], measured["domain"]);
    assert_ne!(measured["domain"], "[[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]");
}

/// A sweep reads its scenes in a way of its own: its noise must be that of a training with the same seed.
#[test]
fn corrupted_points_see_what_a_training_would() {
    let noise = "\n[set]\n\"data.corruption.kind\" = \"shot-noise\"";
    let short = TINY.replace("\n[set]", noise).replace("\"train.steps\" = 60", "\"train.steps\" = 2");
    let place = workplace(&short);
    place.run("sweep run tiny.toml --quiet", 0);
    let points = points_of(&place.at("results/tiny"));
    assert_eq!(points.len(), 4);
    assert_says(&place.text("results/tiny/table.md"), &["corruption shot-noise 3"]);
    for row in &points {
        let seed = &row["seed"];
        let copy = format!("{}-{seed}", row["id"]);
        let set = set(&format!("data.width=16 data.corruption.kind=shot-noise seed={seed}"));
        place.run(&format!("data corrupt {copy} --quiet{set}"), 0);
        let note = place.json(&format!("{copy}/corruption.json"));
        assert_eq!(note["corruption_hash"], row["corruption_hash"]);
        assert_eq!(note["data_hash"], row["data_hash"]);
    }
}

#[test]
fn failures_are_listed_and_the_rest_is_done() {
    let broken = "[[row]]\nname = \"broken\"\nset = { \"train.learning_rate\" = 1e30 }\n";
    let place = workplace(&format!("{}\n{broken}", *TINY));
    let words = ["2 of 6 points failed", "4 are done", "--retry-failed", "broken · builtin · seed 1", "not a number"];
    place.says("sweep run tiny.toml --quiet", 7, &words);
    place.says("sweep status runs/tiny", 7, &["failed", "not a number", "4 done"]);
    place.run("sweep collect runs/tiny", 7);
    place.says("sweep status results/tiny", 7, &["results, 4 done, 2 failed"]);
    let points = points_of(&place.at("results/tiny"));
    let failed: Vec<_> = points.iter().filter(|row| row["status"] == "failed").collect();
    assert_eq!(failed.len(), 2, "{points:?}");
    for row in failed {
        assert!(row["reason"].contains("not a number"), "{row:?}");
        for metric in ["psnr", "ssim", "tv", "config_hash"] {
            assert_eq!(row[metric], "", "missing is empty: {row:?}");
        }
    }
}

#[test]
fn a_scene_that_is_missing_and_a_definition_that_changed_are_said() {
    let place = workplace(&TINY);
    let quick = |further: &str, code: i32| {
        place.run(&format!("sweep run tiny.toml --set train.steps=5 --seeds 0 --quiet {further}"), code)
    };
    let message = quick("--scenes builtin,orchids", 8);
    let words = ["2 of 4 points have no data", "2 are done", "orchids", "AUGNERF_DATA"];
    assert_says(&message, &words);
    // A worker was killed at a point whose scene has gone since.
    let away = points_of(&place.at("results/tiny")).into_iter().find(|row| row["status"] == "no data").unwrap();
    let own = place.at("runs/tiny/points").join(away["id"].trim_start_matches('h'));
    std::fs::create_dir_all(&own).unwrap();
    let note = r#"{ "host": "a", "pid": 1, "step": 2, "steps": 5, "seconds": 1.0, "first": 0 }"#;
    std::fs::write(own.join("claim.json"), note).unwrap();
    place.says("sweep status runs/tiny", 8, &["2 no data"]);
    std::fs::write(own.join("failed.json"), r#"{ "reason": "a device was lost", "exit_code": 1 }"#).unwrap();
    let words = ["1 x no data", "3 x already done or failed"];
    place.says("sweep plan tiny.toml --set train.steps=5 --seeds 0 --scenes builtin,orchids", 8, &words);
    let zero = "--set sampling.spacing=disparity --set data.near=0 --name zero";
    assert_says(&quick(zero, 2), &["rays that start beyond 0", "set data.near"]);
    // Without any scene there is no table.
    let message = quick("--scenes orchids,ferns --name gone", 8);
    assert_says(&message, &["4 of 4 points have no data", "scenes are missing: ferns, orchids", "--data-root"]);
    place.run("sweep collect runs/gone", 8);
    assert!(!place.at("results/gone").exists() && !message.contains("tables: "), "{message}");
    let words = ["another definition", "differs in scenes", "2 of the old ones are gone", "--extend", "--name"];
    assert_says(&quick("", 2), &words);
    quick("--extend", 0);
    place.says("sweep plan tiny.toml --seeds 0", 0, &["2 points", "s/step", "in total"]);
    place.run("sweep run nothing.toml", 2);
    place.run("sweep status nothing", 5);
}

/// Rows that were trained by different programs are not put side by side; the points are all there.
#[test]
fn rows_of_two_revisions_are_refused_and_what_became_of_points_is_still_said() {
    let place = workplace(&TINY);
    place.run("sweep run tiny.toml --quiet --set train.steps=5", 0);
    let result = newest(&place.at("runs/tiny/points")).join("result.json");
    let value = json(&result);
    let fields = value["protocol"].as_array().unwrap();
    let revision = fields.iter().find(|field| field[0] == "code_revision").unwrap()[1].as_str().unwrap();
    std::fs::write(&result, text(&result).replace(revision, "another")).unwrap();
    place.says("sweep run tiny.toml --quiet --set train.steps=5", 9, &["code_revision", "another", "--force"]);
    let results = place.at("results/tiny");
    assert!(results.join("points.csv").is_file());
    assert!(!results.join("table.csv").exists() && !results.join("rows_builtin_psnr.svg").exists(), "no stale table");
    place.run("sweep collect runs/tiny --force", 0);
    assert!(text(&results.join("table.md")).contains("code_revision"));
}

/// "60 steps" above results of 5 would be a false title. What the folder keeps makes the same files again.
#[test]
fn titles_say_what_the_command_line_changed() {
    let place = workplace(&TINY.replace("\"tiny\"", "\"tiny, 60 steps\""));
    let run = |further: &str| {
        place.run(&format!("sweep run tiny.toml --quiet --seeds 0 {further}"), 0);
        files(&place.at("results/tiny"), &[])
    };
    let results = place.at("results/tiny");
    let titled = ["table.md", "table.tex", "rows_builtin_psnr.txt", "curves_builtin_psnr.txt"];
    // The same as the file says, and no title of another.
    let plain = run("--set train.steps=60 --preset smoke");
    titled.iter().for_each(|name| assert!(!text(&results.join(name)).contains("(with"), "{name}"));
    assert_eq!(run(""), plain);
    let changed = run("--set train.steps=45 --set seed=0 --extend");
    for name in titled {
        let text = text(&results.join(name));
        // Figures have it in the caption, so that no title is long.
        let is_figure = name.ends_with(".txt");
        assert_eq!(text.contains("tiny, 60 steps (with seed = 0, train.steps = 45)"), !is_figure, "{name}: {text}");
        assert_eq!(text.contains("All rows: seed = 0, train.steps = 45."), is_figure, "{name}: {text}");
    }
    place.run("sweep collect runs/tiny", 0);
    assert_eq!(files(&results, &[]), changed);
    place.run("verify", 0);
}

/// A run that cannot be read is hours of training: it is said, not begun again over what is there.
#[test]
fn a_point_without_its_settings_fails_and_keeps_its_checkpoints() {
    let place = workplace(&TINY);
    let run = "sweep run tiny.toml --quiet --seeds 0 --set train.steps=5";
    place.run(run, 0);
    let point = entries(&place.at("runs/tiny/points")).remove(0);
    for file in ["result.json", "run/config.toml"] {
        std::fs::remove_file(point.join(file)).unwrap();
    }
    place.says(run, 7, &["config.toml"]);
    assert_eq!(entries(&point.join("run/checkpoints")).len(), 1, "nothing is deleted");
    // One that was killed before its first file is begun.
    std::fs::remove_dir_all(point.join("run/checkpoints")).unwrap();
    place.run(&format!("{run} --retry-failed"), 0);
}

/// Depth errors are compared over the pixels that all rows show; what each evaluation keeps gives its own numbers again.
#[test]
fn rows_are_compared_over_their_common_pixels() {
    let metrics = r#"metrics = ["depth_mae", "depth_left_out", "depth_mae_common", "depth_left_out_common"]"#;
    let definition = short(150).replace(r#"metrics = ["psnr", "ssim", "tv"]"#, metrics);
    let place = workplace(&definition.replace("\"data.width\" = 16", "\"data.width\" = 24"));
    place.run("sweep run tiny.toml --quiet", 0);
    let points = points_of(&place.at("results/tiny"));
    let number = |row: usize, name: &str| points[row][name].parse::<f64>().unwrap();
    let common = number(0, "depth_left_out_common");
    assert_eq!(common, number(1, "depth_left_out_common"), "one mask for both rows");
    for (row, point) in points.iter().enumerate() {
        assert!(number(row, "depth_left_out") <= common);
        let run = place.at("runs/tiny/points").join(&point["id"]).join("run");
        let errors = DepthErrors::read(&run.join("depth_errors.gz")).unwrap().unwrap();
        let mean = |view: &Vec<f32>| {
            let solid = view.iter().filter(|error| error.is_finite());
            solid.clone().map(|error| f64::from(error.abs())).sum::<f64>() / solid.count() as f64
        };
        let own = errors.views.iter().map(mean).sum::<f64>() / errors.views.len() as f64;
        assert!((own - number(row, "depth_mae")).abs() < 1e-6 * own, "{own} {}", point["depth_mae"]);
    }
    assert!(number(0, "depth_mae_common") > 0.0 && place.text("results/tiny/table.md").contains("depth_mae_common"));

    // A run of an earlier version keeps no errors: nothing is common until it is measured again.
    let first = place.at("runs/tiny/points").join(&points[0]["id"]).join("run/depth_errors.gz");
    let kept = std::fs::read(&first).unwrap();
    std::fs::remove_file(&first).unwrap();
    place.run("sweep collect runs/tiny", 0);
    let without = rows(&place.text("results/tiny/table.csv"));
    assert!(without.iter().all(|row| !row.contains_key("depth_mae_common_mean") && !row["depth_mae_mean"].is_empty()));
    // A run that cannot be measured again is no success, however often it is tried, and keeps its result and its run.
    let remeasure = "sweep run tiny.toml --quiet --remeasure";
    let config = first.with_file_name("config.toml");
    let settings = text(&config);
    std::fs::write(&config, settings.replacen("seed = 0", "seed = 9", 1)).unwrap();
    for line in [remeasure, remeasure, &format!("{remeasure} --retry-failed")] {
        let words = ["1 of 2 points could not be measured again", "--remeasure", "a run of other settings"];
        place.says(line, 7, &words);
    }
    place.run("sweep status runs/tiny", 0);
    std::fs::write(&config, settings).unwrap();
    place.run(remeasure, 0);
    assert_eq!(std::fs::read(&first).unwrap(), kept);
    assert_eq!(points_of(&place.at("results/tiny")), points);
}

/// The first scene's file is damaged: its points fail, and those of the other are trained.
#[test]
fn a_scene_that_cannot_be_read_loses_no_other() {
    let place = workplace(&short(2).replace("[\"builtin\"]", "[\"broken\", \"builtin\"]"));
    place.write("broken/transforms.json", "{");
    place.says("sweep run tiny.toml --data-root .", 7, &["scene broken cannot be read", "broken/transforms.json"]);
    let points = points_of(&place.at("results/tiny"));
    let mut ends: Vec<[&str; 2]> =
        points.iter().map(|row| ["scene", "status"].map(|name| row[name].as_str())).collect();
    ends.sort();
    assert_eq!(ends, [["broken", "failed"], ["broken", "failed"], ["builtin", "done"], ["builtin", "done"]]);
}
