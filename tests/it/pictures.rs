//! `augnerf compare`, of a view and along a ray: what it chooses, measures, draws and refuses.

use std::sync::Arc;

use crate::common::files::{assert_same_files, files, json, rows, text};
use crate::common::program::{Place, set};
use crate::common::{assert_says, runtime, tiny_config, tiny_scene, trained};
use augnerf::base::Image;
use augnerf::base::rng::{Random, Stream};
use augnerf::compare::{Comparison, Profile, Profiles, RunView, Window, crop, most_different};
use augnerf::data::Scene;
use augnerf::metrics::{psnr_float, quantise};
use augnerf::run::{RenderedView, Viewer};
use augnerf::settings::{Config, Method, PixelOrigin, Resolved};
use augnerf::train::checkpoint::load_state;
use base64::Engine;
use tempfile::TempDir;

/// An image of 8-bit values that nobody has drawn.
fn noise(seed: u64, width: usize, height: usize) -> Image {
    let mut random = Random::new(seed, Stream::Search, 0);
    let pixels = (0..width * height * 3).map(|_| random.below(256) as f32 / 255.0).collect();
    Image { width, height, channels: 3, pixels }
}

/// The sum of squared differences over a window, in squares of 1/255.
fn squared_error(a: &Image, b: &Image, window: Window) -> i64 {
    let (a, b) = (crop(a, window), crop(b, window));
    let eight_bits = |value: f32| (value * 255.0).round() as i64;
    a.pixels.iter().zip(&b.pixels).map(|(&a, &b)| (eight_bits(a) - eight_bits(b)).pow(2)).sum()
}

/// Every window, looked into pixel by pixel.
fn slowly(rendered: &[&Image], truth: &Image, (width, height): (usize, usize)) -> Window {
    let places = (0..=truth.height - height).flat_map(|y| (0..=truth.width - width).map(move |x| (x, y)));
    let difference = |&window: &Window| {
        let errors: Vec<i64> = rendered.iter().map(|image| squared_error(image, truth, window)).collect();
        let best = if errors.len() > 1 { *errors.iter().min().unwrap() } else { 0 };
        errors.iter().max().unwrap() - best
    };
    let windows: Vec<Window> = places.map(|(x, y)| Window { x, y, width, height }).collect();
    let most = windows.iter().map(difference).max().unwrap();
    windows.into_iter().find(|window| difference(window) == most).unwrap()
}

#[test]
fn the_box_is_where_the_squared_errors_differ_most() {
    for (seed, (width, height), size) in
        [(1, (23, 17), (5, 4)), (2, (9, 9), (9, 9)), (3, (12, 8), (1, 1)), (4, (7, 16), (7, 2))]
    {
        let truth = noise(seed, width, height);
        let runs: Vec<Image> = (10..13).map(|run| noise(10 * seed + run, width, height)).collect();
        for count in 1..=3 {
            let rendered: Vec<&Image> = runs.iter().take(count).collect();
            assert_eq!(most_different(&rendered, &truth, size), slowly(&rendered, &truth, size), "{seed} {count}");
        }
        // Equal runs differ nowhere: the first place.
        let same = most_different(&[&runs[0], &runs[0]], &truth, size);
        assert_eq!((same.x, same.y), (0, 0));
    }
}

/// A trained run in memory.
struct Run {
    config: Resolved,
    scene: Scene,
    trainer: augnerf::train::Trainer,
}

impl Run {
    fn new(method: Method, steps: u64, change: impl FnOnce(&mut Config)) -> Run {
        let config = tiny_config(method, change);
        let trainer = trained(&config, steps);
        Run { config, scene: tiny_scene(), trainer }
    }

    fn viewer(&self) -> Viewer<'_> {
        Viewer { model: self.trainer.model().unwrap(), config: &self.config, scene: &self.scene, runtime: runtime() }
    }

    fn run_view(&self, label: &str) -> RunView {
        let folder = TempDir::new().unwrap();
        let state = load_state(&self.trainer.save(folder.path()).unwrap()).unwrap();
        RunView::new(label.into(), &self.viewer(), &state, "0").unwrap()
    }

    fn rendered(&self, label: &str) -> (RunView, RenderedView) {
        let contender = self.run_view(label);
        let rendered = self.viewer().render(&contender.view.camera).unwrap();
        (contender, rendered)
    }
}

fn pair() -> [Run; 2] {
    let other = |config: &mut Config| {
        (config.seed, config.train.collapse_steps, config.perturb.perturb_last) = (1, 3, true);
    };
    [Run::new(Method::Nerf, 30, |_| ()), Run::new(Method::AugNerf, 10, other)]
}

fn compared(runs: &[Run; 2], window: Option<Window>) -> Comparison {
    let [a, b] = [runs[0].rendered("first"), runs[1].rendered("second")];
    Comparison::new(vec![a, b], window, Some(6)).unwrap()
}

#[test]
fn a_comparison_repeats_byte_for_byte_and_its_numbers_are_those_of_the_box() {
    let runs = pair();
    let dir = TempDir::new().unwrap();
    let comparison = compared(&runs, None);
    comparison.write(dir.path()).unwrap();
    let written = files(dir.path(), &[]);
    let names: Vec<&str> = written.iter().map(|(name, _)| name.to_str().unwrap()).collect();
    assert_eq!(names, ["compare.json", "compare.svg"]);
    compared(&pair(), None).write(dir.path()).unwrap();
    assert!(written == files(dir.path(), &[]), "equal runs give other bytes");
    let report = json(&dir.path().join("compare.json"));
    let window = comparison.window();
    assert_eq!(report["box"]["x"], window.x);
    let truth = &runs[0].scene.test[0].image;
    let images: Vec<Image> = runs.iter().map(|run| run.rendered("r").1.image).collect();
    assert_eq!(window, slowly(&[&quantise(&images[0]), &quantise(&images[1])], &quantise(truth), (6, 6)));
    for (index, image) in images.iter().enumerate() {
        let rounded = [image, truth].map(quantise);
        let in_box = psnr_float(&crop(&rounded[0], window), &crop(&rounded[1], window)).unwrap();
        assert_eq!(report["runs"][index]["box"]["psnr"].as_f64(), in_box);
        assert_eq!(report["runs"][index]["view"]["psnr"].as_f64(), psnr_float(&rounded[0], &rounded[1]).unwrap());
    }
    let told = |name: &str| {
        let found = report["differences"].as_array().unwrap().iter().find(|difference| difference["name"] == name);
        found.map(|difference| difference["values"].clone())
    };
    assert_eq!(told("seed").unwrap(), serde_json::json!(["0", "1"]));
    assert_eq!(told("method").unwrap(), serde_json::json!(["nerf", "aug-nerf"]));
    assert!(told("lambda").is_some() && told("rays").is_none() && told("config_hash").is_none());
    // A setting that the protocol leaves out; one of the perturbed pass, on which a run without one has no opinion.
    assert!(told("train.collapse_steps").is_some() && told("perturb.perturb_last").is_none());
}

fn eight_bits(image: &Image) -> Vec<[u8; 3]> {
    augnerf::draw::quantise(&image.pixels).chunks(3).map(|p| [p[0], p[1], p[2]]).collect()
}

/// The images of a figure.
fn images_in(svg: &str) -> Vec<image::RgbImage> {
    let encoded = svg.split("data:image/png;base64,").skip(1).map(|rest| rest.split('"').next().unwrap());
    let decoded = encoded.map(|text| base64::engine::general_purpose::STANDARD.decode(text).unwrap());
    decoded.map(|png| image::load_from_memory(&png).unwrap().to_rgb8()).collect()
}

/// Each pixel of the renderings and of their maps is found in the figure, as it is.
#[test]
fn the_picture_shows_the_pixels_themselves() {
    let runs = pair();
    let dir = TempDir::new().unwrap();
    let asked = Window { x: 15, y: 15, width: 1, height: 1 };
    compared(&runs, Some(asked)).write(dir.path()).unwrap();
    let svg = text(&dir.path().join("compare.svg"));
    assert!(svg.contains(" width=\"17cm\""), "whatever the views");
    let images = images_in(&svg);
    let shown = |image: &Image| {
        let expected = eight_bits(image).concat();
        images.iter().any(|picture| picture.as_raw() == &expected)
    };
    let truth = &runs[0].scene.test[0].image;
    assert!(shown(truth), "truth");
    // One scale for all runs.
    let report = json(&dir.path().join("compare.json"));
    let end = |scale: &str, i: usize| report[scale][i].as_f64().unwrap() as f32;
    for run in &runs {
        let RenderedView { image, depth, acc } = run.rendered("r").1;
        assert!(shown(&image), "rendering");
        let errors = eight_bits(&image).into_iter().zip(eight_bits(truth)).flat_map(|(a, b)| {
            let sum: u32 = (0..3).map(|c| u32::from(a[c].abs_diff(b[c])).pow(2)).sum();
            augnerf::draw::scale_colour((sum as f32 / 3.0).sqrt() / 255.0 / end("error_colours", 1))
        });
        let errors = Image { pixels: errors.collect(), ..(**truth).clone() };
        assert!(shown(&errors), "error map");
        let (near, far) = (end("depth_colours", 0), end("depth_colours", 1));
        assert!(shown(&augnerf::draw::depth_colour(&depth, 16, 16, near, far, Some(&acc)).unwrap()), "depth map");
        let other = Image { pixels: image.pixels.iter().map(|value| 1.0 - value).collect(), ..image };
        assert!(!shown(&other), "another picture is not there");
    }
}

#[test]
fn runs_that_do_not_show_the_same_are_refused_in_words() {
    let run = Run::new(Method::Nerf, 0, |_| ());
    let first = run.run_view("first");
    first.check_alike(&run.run_view("same")).unwrap();
    let refused = |words: &str, change: &dyn Fn(&mut RunView)| {
        let mut other = run.run_view("other");
        change(&mut other);
        let error = other.check_alike(&first).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert_says(&error.to_string(), &[words, "other", "first"]);
    };
    refused("and fern in the second", &|run| run.protocol.set("scene", "fern".into()));
    refused("the resolution is 16 x 16 in the first and 32 x 16 in the second", &|run| run.view.camera.width = 32);
    refused("r_5", &|run| run.view.name = "r_5".into());
    refused("the background is ", &|run| run.protocol.set("background", "black".into()));
    refused("the camera", &|run| run.view.camera.pose[0][3] += 1e-3);
    refused("another (1 of 768 values)", &|run| Arc::make_mut(&mut run.view.image).pixels[7] += 0.5);
    refused("the photo's mask", &|run| run.view.mask = Some([true; 256].into()));
    // Pictures of runs with other ends of rays stand beside each other; densities along rays do not.
    let mut other = run.run_view("other");
    other.bounds.0 = 1.0;
    other.check_alike(&first).unwrap();
    assert_says(
        &other.check_same_interval(&first).unwrap_err().to_string(),
        &["other run from 1 to", "first from", "data.near"],
    );
}

const PIXEL: (usize, usize) = (7, 8);

fn profiled(run: &Run, label: &str) -> (RunView, Profile) {
    let contender = run.run_view(label);
    let profile = Profile::measure(&run.viewer(), &contender, PIXEL).unwrap();
    (contender, profile)
}

#[test]
fn a_profile_is_what_an_evaluation_sees() {
    for (method, change) in [(Method::Nerf, PixelOrigin::Corner), (Method::AugNerf, PixelOrigin::Centre)] {
        let run = Run::new(method, 40, |config| config.data.pixel_origin = Some(change));
        let (contender, profile) = profiled(&run, "run");
        let rendered = run.viewer().render(&contender.view.camera).unwrap();
        let fine = profile.fine.as_ref().unwrap();
        assert_eq!((profile.coarse.t.len(), fine.t.len(), profile.even.t.len()), (8, 16, 1024));
        let at = PIXEL.1 * 16 + PIXEL.0;
        for c in 0..3 {
            let shown = rendered.image.pixels[3 * at + c];
            assert!((profile.rgb[c] - shown).abs() < 1e-5, "{} {shown}", profile.rgb[c]);
            // White behind what the weights leave.
            let sum: f32 = fine.weights.iter().zip(&fine.rgb).map(|(weight, rgb)| weight * (rgb[c] - 1.0)).sum();
            assert!((1.0 + sum - shown).abs() < 1e-4, "{sum} {shown}");
        }
        assert!((profile.depth.unwrap() - rendered.depth[at]).abs() < 1e-3);
        for samples in [&profile.even, &profile.coarse, fine] {
            assert!(samples.t.windows(2).all(|pair| pair[0] <= pair[1]));
            let count = samples.t.len();
            for k in 0..count - 1 {
                // What is lost of the light over an interval is that sample's weight.
                let lost = samples.transmittance[k] - samples.transmittance[k + 1];
                assert!((lost - samples.weights[k]).abs() < 1e-4, "{k}: {lost} {}", samples.weights[k]);
            }
            assert_eq!(samples.transmittance[0], 1.0);
        }
    }
}

#[test]
fn a_coarse_model_alone_has_no_fine_samples() {
    let run = Run::new(Method::Nerf, 5, |config| config.sampling.fine = 0);
    let (contender, profile) = profiled(&run, "coarse");
    assert!(profile.fine.is_none() && profile.coarse.t.len() == 8);
    let dir = TempDir::new().unwrap();
    Profiles { runs: vec![(contender, profile)], pixel: PIXEL }.write(dir.path()).unwrap();
    let table = std::fs::read_to_string(dir.path().join("ray.csv")).unwrap();
    assert!(table.contains(",coarse,") && table.contains(",even,") && !table.contains(",fine,"));
}

#[test]
fn the_variation_along_a_ray_is_that_of_its_table() {
    let dir = TempDir::new().unwrap();
    let [a, b] = pair();
    let runs = vec![profiled(&a, "first"), profiled(&b, "second")];
    Profiles { runs, pixel: PIXEL }.write(dir.path()).unwrap();
    let report = json(&dir.path().join("ray.json"));
    let table = rows(&text(&dir.path().join("ray.csv")));
    for (index, run) in ["first", "second"].into_iter().enumerate() {
        let of_run = table.iter().filter(|row| row["run"] == run && row["samples"] == "even");
        let density: Vec<f64> = of_run.map(|row| row["density"].parse::<f32>().unwrap().into()).collect();
        assert_eq!(density.len(), 1024);
        let along: f64 = density.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum();
        let told = report["runs"][index]["density_variation"].as_f64().unwrap();
        assert!(along > 0.0 && (told - along).abs() < 1e-5 * along, "{told} {along}");
    }
}

#[test]
fn the_commands_leave_what_they_promise_and_refuse_what_they_cannot_show() {
    let place = Place::new();
    let small = "data.width=16 field.width=16 sampling.coarse=8 sampling.fine=8 train.rays=64 train.steps=20 \
        train.precrop_steps=0 eval.pictures=0";
    for (name, further) in
        [("a", "seed=0"), ("b", "seed=1"), ("wide", "data.width=20"), ("forward", "data.kind=builtin-forward")]
    {
        place.run(&format!("train --quiet --out {name}{}{}", set(small), set(further)), 0);
    }
    let report = || place.json("a/renders/compare/compare.json");
    place.run("compare -q a b --view r_3", 0);
    assert_eq!(report()["index"], 3);
    // An earlier comparison's files do not stay among the new ones.
    place.write("a/renders/compare/compare.old", "");
    place.run("compare -q a --zoom 1,2,3,4", 0);
    assert!(!place.at("a/renders/compare/compare.old").exists());
    assert_eq!(report()["box"], serde_json::json!({"x": 1, "y": 2, "width": 3, "height": 4}));
    place.run("compare -q a b --label NeRF --label 'another seed'", 0);
    let labels = [0, 1].map(|run| report()["runs"][run]["run"].clone());
    assert_eq!(labels, ["NeRF", "another seed"]);
    place.run("compare -q a b --ray 0,15 --out ray", 0);
    assert_eq!(place.json("ray/ray.json")["pixel"], serde_json::json!([0, 15]));
    place.run("compare -q a b --ray 0,15 --threads 1 --out again", 0);
    assert_same_files(&place.at("ray"), &place.at("again"), &[]);
    // A person is told what to open and what comes next.
    place.says("compare a b", 0, &["open: ", "compare/compare.", "next: augnerf compare a b --ray 8,8"]);
    for further in ["", "--ray 8,8"] {
        for (line, code, words) in [
            ("a wide", 2, &["a and wide do not match", "is 16 x 16 in the first and 20 x 20 in the second"][..]),
            ("a forward", 2, &["forward", "builtin-forward"]),
            ("a b --view r_99", 2, &["--view r_99", "0 to 7", "r_7"]),
            ("a b --view 8", 2, &["--view 8", "0 to 7"]),
            ("a a", 2, &["twice"]),
            ("a b --label NeRF", 2, &["--label", "1 labels for 2 runs"]),
            ("a b --label N --label N", 2, &["--label", "`N` occurs twice"]),
            ("nothing", 5, &["nothing", "missing"]),
            ("a b --out ray", 4, &["ray", "already holds files"]),
        ] {
            place.says(&format!("compare {line} {further}"), code, words);
        }
    }
    for (line, words) in [
        ("a b --zoom 10,0,8,8", &["--zoom", "8 x 8", "(10, 0)", "16 x 16"][..]),
        ("a b --zoom 10,0,8", &["--zoom 10,0,8", "width and height"]),
        ("a b --box-width 17", &["--box-width 17", "at most 16"]),
        ("a --ray 16,0", &["--ray 16,0", "0,0 to 15,15"]),
        ("a --ray 1", &["--ray 1", "column and row"]),
        ("a --ray 1,1 --zoom 0,0,8,8", &["--ray", "--zoom", "cannot be used"]),
    ] {
        place.says(&format!("compare {line}"), 2, words);
    }
    std::fs::remove_dir_all(place.at("b/checkpoints")).unwrap();
    place.says("compare a b", 5, &["no checkpoint", "augnerf resume"]);
    place.says("compare b --ray 8,8", 5, &["no checkpoint"]);
}
