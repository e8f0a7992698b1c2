//! `augnerf compare --spread`: mean and standard deviation over the seeds of a row, and what is refused.

use std::path::Path;

use crate::common::files::{assert_same_files, files, json, points_of, rows, text};
use crate::common::program::{self, augnerf};
use crate::common::{assert_says, runtime, tiny_scene};
use augnerf::base::Image;
use augnerf::compare::ViewSpread;
use augnerf::data::View;
use augnerf::metrics::psnr;
use augnerf::run::{RenderedView, Trained};
use serde_json::Value;
use tempfile::TempDir;

/// The ball's view, on which a seed's image is the photo plus an offset of each channel.
fn rendered(view: &View, offsets: [f32; 3], depth: f32) -> RenderedView {
    let pixels = view.image.pixels.chunks_exact(3).flat_map(|p| [0, 1, 2].map(|c| p[c] + offsets[c])).collect();
    RenderedView { image: Image { pixels, ..*view.image }, depth: vec![depth; 256], acc: vec![1.0; 256] }
}

#[track_caller]
fn close(value: f64, expected: f64) {
    assert!((value - expected).abs() < 1e-6, "{value} is not {expected}");
}

/// Offsets -0.03 and 0.05 have the mean 0.01 and the standard deviation 0.08 / sqrt(2); 0 and 0.02 those of 0.01 and
/// 0.02 / sqrt(2).
#[test]
fn spread_and_error_are_root_mean_squares_over_channels() {
    let view = &tiny_scene().test[0];
    let seeds = [rendered(view, [-0.03, 0.0, 0.0], 2.0), rendered(view, [0.05, 0.02, 0.0], 5.0)];
    let found = ViewSpread::new(view, &seeds).unwrap();
    let spread = ((0.08f64.powi(2) + 0.02f64.powi(2)) / 2.0 / 3.0).sqrt();
    let error = (2.0 * 0.01f64.powi(2) / 3.0).sqrt();
    for pixel in 0..256 {
        close(found.spread[pixel].into(), spread);
        close(found.error[pixel].into(), error);
        close(found.depth[pixel].into(), 3.5);
        close(found.depth_spread[pixel].into(), 3.0 / 2.0f64.sqrt());
    }
    close(found.numbers.get("spread_rms").unwrap(), spread);
    close(found.numbers.get("error_rms").unwrap(), error);
    assert_eq!((found.numbers.get("within_1"), found.numbers.get("within_2")), (Some(1.0), Some(1.0)));
    let single = |seed: usize| psnr(&seeds[seed].image, &view.image).unwrap().unwrap();
    close(found.numbers.get("psnr_of_seeds").unwrap(), (single(0) + single(1)) / 2.0);
    assert!(found.numbers.get("psnr_of_mean").unwrap() > single(0));
}

/// Seeds that agree have no spread, whatever their error, and equal the photo or not.
#[test]
fn seeds_that_agree_have_no_spread() {
    let view = &tiny_scene().test[0];
    let alike = |offset: f32| ViewSpread::new(view, &[0, 1].map(|_| rendered(view, [offset; 3], f32::NAN))).unwrap();
    let off = alike(0.1);
    assert!(off.spread.iter().all(|spread| *spread == 0.0));
    assert!(off.depth.iter().chain(&off.depth_spread).all(|depth| depth.is_nan()), "no seed has a depth");
    assert_eq!((off.numbers.get("within_2"), off.numbers.get("spearman")), (Some(0.0), None));
    let exact = alike(0.0);
    assert_eq!((exact.numbers.get("psnr_of_mean"), exact.numbers.get("ause")), (None, None));
    assert_eq!((exact.numbers.get("error_rms"), exact.numbers.get("within_1")), (Some(0.0), Some(1.0)));
}

#[test]
fn masked_pixels_do_not_count() {
    let mut view = tiny_scene().test[0].clone();
    let mask: Vec<bool> = (0..256).map(|pixel| pixel < 100).collect();
    view.mask = Some(mask.into());
    let mut seeds = [rendered(&view, [0.1; 3], 2.0), rendered(&view, [0.3; 3], 2.0)];
    let before = ViewSpread::new(&view, &seeds).unwrap();
    assert_eq!(before.predicted.len(), 100);
    seeds[0].image.pixels[300..].fill(0.9);
    let after = ViewSpread::new(&view, &seeds).unwrap();
    assert_eq!((&before.numbers, &before.error), (&after.numbers, &after.error));
    close(before.numbers.get("error_rms").unwrap(), 0.2);
}

/// Runs of less than a second at 16 x 16: two rows, three seeds.
const TINY: &str = r#"
title = "tiny"
preset = "smoke"
scenes = ["builtin"]
seeds = [0, 1, 2]
metrics = ["psnr"]
baseline = "NeRF"
row = [{ name = "NeRF" }, { name = "TV, weak", set = { "regularizer.kind" = "tv" } }]

[set]
"data.width" = 16
"field.width" = 16
"sampling.coarse" = 8
"sampling.fine" = 8
"train.rays" = 64
"train.chunk" = 32
"train.steps" = 30
"eval.pictures" = 0
"regularizer.points_per_step" = 64
"#;

/// A folder in which a sweep was run.
struct Swept(TempDir);

impl Swept {
    fn new(definition: &str) -> Swept {
        let dir = TempDir::new().unwrap();
        std::fs::write(dir.path().join("tiny.toml"), definition).unwrap();
        let swept = Swept(dir);
        swept.demand(&["sweep", "run", "tiny.toml", "--quiet"], 0);
        swept
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    /// Runs there, demands an exit code, and returns everything printed.
    #[track_caller]
    fn demand(&self, arguments: &[&str], code: i32) -> String {
        program::demand(augnerf(arguments).current_dir(self.path()), code)
    }

    #[track_caller]
    fn refuse(&self, further: &[&str], code: i32, words: &[&str]) {
        let said = self.demand(&[&["compare", "--spread"], further].concat(), code);
        assert_says(&said, words);
        assert!(code != 2 || said.contains("Usage") || said.trim_end().lines().count() == 1, "{said}");
    }

    /// Runs and returns what `--json` prints under `spread`.
    fn spread(&self, further: &[&str]) -> Value {
        let printed = self.demand(&[&["compare", "runs/tiny", "--spread", "--json", "-q"], further].concat(), 0);
        serde_json::from_str::<Value>(&printed).unwrap()["spread"].clone()
    }

    /// The runs of a row, in the order of the seeds, with their PSNR.
    fn runs(&self, row: &str) -> Vec<(std::path::PathBuf, f64)> {
        let points = points_of(&self.path().join("results/tiny"));
        let own = points.into_iter().filter(|point| point["row"] == row);
        let folder = self.path().join("runs/tiny/points");
        own.map(|point| (folder.join(&point["id"]).join("run"), point["psnr"].parse().unwrap())).collect()
    }
}

/// PSNR and spread of a view, from the seeds' own renderings.
fn slowly(swept: &Swept, row: &str, view: usize) -> (f64, f64) {
    let opened: Vec<Trained> =
        swept.runs(row).iter().map(|(run, _)| Trained::open(run, None, runtime(), &()).unwrap()).collect();
    let truth = &opened[0].scene.test[view];
    let images: Vec<Image> = opened.iter().map(|seed| seed.viewer().render(&truth.camera).unwrap().image).collect();
    let (mut mean, mut variance) = ((*truth.image).clone(), 0.0);
    for (index, pixel) in mean.pixels.iter_mut().enumerate() {
        let values: Vec<f64> = images.iter().map(|image| f64::from(image.pixels[index])).collect();
        let centre = values.iter().sum::<f64>() / 3.0;
        *pixel = centre as f32;
        variance += values.iter().map(|value| (value - centre).powi(2)).sum::<f64>() / 2.0;
    }
    (psnr(&mean, &truth.image).unwrap().unwrap(), (variance / mean.pixels.len() as f64).sqrt())
}

#[test]
fn a_row_s_seeds_give_mean_spread_and_calibration() {
    let swept = Swept::new(TINY);
    let spread = swept.spread(&["--row", "NeRF", "--view", "r_3", "--out", "first"]);
    assert_eq!(spread, json(&swept.path().join("first/spread.json")));
    let names: Vec<String> =
        files(&swept.path().join("first"), &[]).iter().map(|(name, _)| name.display().to_string()).collect();
    let drawn = ["calibration.png", "calibration.svg", "spread.csv", "spread.json", "spread.png"];
    let plain = ["calibration.svg", "spread.csv", "spread.json", "spread.svg"];
    assert_eq!(names, if cfg!(feature = "png-figures") { drawn.to_vec() } else { plain.to_vec() });
    assert_eq!((&spread["row"], &spread["seeds"]), (&"NeRF".into(), &serde_json::json!([0, 1, 2])));
    assert_eq!((&spread["shown"]["view"], &spread["shown"]["index"]), (&"r_3".into(), &3.into()));
    assert_eq!((&spread["differences"], &spread["skipped_views"]), (&serde_json::json!([]), &serde_json::json!([])));

    // The single seeds' PSNR is that of the sweep's table.
    let number = |of: &Value, key: &str| of[key].as_f64().unwrap();
    let of_table: f64 = swept.runs("NeRF").iter().map(|(_, psnr)| psnr / 3.0).sum();
    close(number(&spread["mean"], "psnr_of_seeds"), of_table);
    let views = spread["views"].as_array().unwrap();
    assert_eq!(views.len(), 8);
    let (psnr, deviation) = slowly(&swept, "NeRF", 3);
    close(number(&views[3], "psnr_of_mean"), psnr);
    close(number(&views[3], "spread_rms"), deviation);
    for key in ["spearman", "ause", "ause_constant", "within_1", "within_2", "ssim_of_mean"] {
        let sum: f64 = views.iter().map(|view| number(view, key)).sum();
        close(number(&spread["mean"], key), sum / 8.0);
    }

    // Every pixel is in one bin.
    let bins = rows(&text(&swept.path().join("first/spread.csv")));
    let cell = |bin: &std::collections::HashMap<String, String>, name: &str| bin[name].parse::<f64>().unwrap();
    assert_eq!(bins.len(), 20);
    assert!(bins.iter().all(|bin| (102.0..=103.0).contains(&cell(bin, "pixels"))));
    assert!(bins.windows(2).all(|pair| cell(&pair[0], "spread_highest") <= cell(&pair[1], "spread_lowest")));
    for name in ["error_rms", "spread_rms"] {
        let squares: f64 = bins.iter().map(|bin| cell(bin, "pixels") * cell(bin, name).powi(2)).sum();
        let of_views: f64 = views.iter().map(|view| 256.0 * number(view, name).powi(2)).sum();
        close(squares / 2048.0, of_views / 2048.0);
    }
    assert_eq!(cell(&bins[0], "pixels") + bins[1..].iter().map(|bin| cell(bin, "pixels")).sum::<f64>(), 2048.0);

    // Equal bytes on one thread, and by the other name of the flag.
    swept.spread(&["--rows", "NeRF", "--view", "3", "--threads", "1", "--out", "second"]);
    assert_same_files(&swept.path().join("first"), &swept.path().join("second"), &[]);

    refusals(&swept);
}

/// What cannot be shown of the sweep, which it leaves damaged.
fn refusals(swept: &Swept) {
    let one_row = ["needs one row", "'NeRF', 'TV, weak'"];
    swept.refuse(&["runs/tiny"], 2, &[&one_row[..], &["none is named"]].concat());
    swept.refuse(&["runs/tiny", "--row", "NeRF,TV, weak"], 2, &[&one_row[..], &["2 are named"]].concat());
    swept.refuse(&["runs/tiny", "--row", "MipNeRF"], 2, &["--row: 'MipNeRF' is not a row", "'NeRF', 'TV, weak'"]);
    swept.refuse(&["runs/tiny", "--row", "NeRF", "--view", "8"], 2, &["--view 8", "row 'NeRF'", "0 to 7", "r_7"]);
    swept.refuse(&["runs/tiny", "--row", "NeRF", "--scene", "fern"], 2, &["--scene fern", "choose one of builtin"]);
    swept.refuse(&["runs/tiny", "--row", "NeRF", "--seed", "0"], 2, &["--spread", "--seed", "cannot be used"]);
    swept.refuse(&["runs/tiny", "--row", "NeRF", "--gif"], 2, &["--spread", "--gif", "cannot be used"]);
    swept.refuse(&["runs/tiny", "--row", "NeRF", "--out", "first"], 4, &["first", "already holds files"]);
    let runs = swept.runs("NeRF");
    let run = runs[0].0.to_str().unwrap();
    swept.refuse(&[run, "--row", "NeRF"], 2, &["the folder of one sweep, not", run, "runs/NAME"]);
    swept.refuse(&["runs/tiny", run], 2, &["the folder of one sweep, not 2 folders"]);

    std::fs::remove_dir_all(runs[1].0.join("checkpoints")).unwrap();
    let id = runs[1].0.parent().unwrap().file_name().unwrap().to_str().unwrap();
    let no_checkpoint = ["row 'NeRF': no checkpoint in", id, "`augnerf sweep run`"];
    swept.refuse(&["runs/tiny", "--row", "NeRF"], 5, &no_checkpoint);
    // A seed without a result is named and not included.
    std::fs::remove_file(runs[1].0.parent().unwrap().join("result.json")).unwrap();
    let said = swept.demand(&["compare", "runs/tiny", "--row", "NeRF", "--spread"], 0);
    assert_says(&said, &["not included: seeds 1", "8 held-out views of 2 seeds", "AUSE", "open: ", "renders/spread"]);
    std::fs::remove_file(runs[2].0.parent().unwrap().join("result.json")).unwrap();
    let too_few = ["row 'NeRF': 1 of its 3 seeds is finished", "at least two", "`augnerf sweep status runs/tiny`"];
    swept.refuse(&["runs/tiny", "--row", "NeRF"], 2, &too_few);
}

/// A sweep of one row whose seeds differ in a setting.
fn by_seed(further: &str) -> Swept {
    let row = "row = [{ name = \"NeRF\" }]\nby_seed = ";
    let lines =
        TINY.lines().map(|line| if line.starts_with("row =") { format!("{row}{further}") } else { line.into() });
    Swept::new(&lines.collect::<Vec<String>>().join("\n").replace("= 30", "= 4"))
}

/// Seed 0 holds out every second view, the others every fourth.
#[test]
fn only_views_that_all_seeds_hold_out_are_rendered_and_differences_are_named() {
    let swept = by_seed("{ \"data.holdout\" = [2, 4, 4], \"data.kind\" = [\"builtin-forward\"] }");
    let spread = swept.spread(&[]);
    let count = |key: &str| spread[key].as_array().unwrap().len();
    let held_out: Vec<usize> = swept.runs("NeRF").iter().map(|(run, _)| views_of(run)).collect();
    assert!(held_out[0] > held_out[1], "{held_out:?}");
    assert_eq!((count("views"), count("skipped_views")), (held_out[1], held_out[0] - held_out[1]));
    let named: Vec<&Value> =
        spread["differences"].as_array().unwrap().iter().map(|difference| &difference["name"]).collect();
    assert!(named.contains(&&"split".into()) && !named.contains(&&"seed".into()), "{named:?}");
    let said = swept.demand(&["compare", "runs/tiny", "--spread"], 0);
    assert_says(&said, &["the seeds also differ in", "split", "that not all seeds hold out"]);
}

fn views_of(run: &Path) -> usize {
    json(&run.join("metrics.json"))["views"].as_array().unwrap().len()
}

#[test]
fn seeds_without_a_common_view_are_refused() {
    let swept = by_seed("{ \"data.width\" = [16, 16, 20] }");
    swept.refuse(&["runs/tiny"], 2, &["seed 0 and seed 2 do not match", "the resolution is 16 x 16", "20 x 20"]);
    let swept = by_seed("{ \"data.holdout_offset\" = [0, 1, 2], \"data.kind\" = [\"builtin-forward\"] }");
    swept.refuse(&["runs/tiny"], 2, &["hold out no view in common (seed 0: ", "; seed 1: ", "data.holdout_offset"]);
}
