//! The program as a user meets it: runs, results, resumption, refusals.

use std::path::Path;
use std::process::Child;
use std::time::Duration;

use crate::common::assert_says;
use crate::common::files::{FLEETING, assert_same_files, copy, entries, rows};
use crate::common::program::{Place, demand, set, signalled, wait_for};
use augnerf::settings::REGULARIZERS;
use serde_json::{Value, json};

/// Settings of a run that takes a second: the embedded scene at 16 x 16.
const TINY: &str = "data.width=16 field.width=16 sampling.coarse=8 sampling.fine=8 train.rays=64 train.chunk=32 \
    train.steps=40";

fn tiny(out: &str, further: &str) -> String {
    tiny_of("smoke", out, further)
}

fn tiny_of(preset: &str, out: &str, further: &str) -> String {
    let logged = set("train.checkpoint_every=10 train.log_every=5 train.precrop_steps=3");
    format!("train --quiet --preset {preset} --out {out} {}{logged} {further}", set(TINY))
}

/// A folder with such a run, `run`.
fn trained() -> Place {
    Place::once(TINY, |place| drop(place.run(&tiny("run", ""), 0)))
}

#[track_caller]
fn assert_same(place: &Place, a: &str, b: &str) {
    assert_same_files(&place.at(a), &place.at(b), &FLEETING);
}

/// Waits until the run has written the checkpoint of `step`.
fn wait_for_checkpoint(run: &Path, step: u64, child: &mut Child) {
    let folder = run.join(format!("checkpoints/step_{step:09}"));
    wait_for(&format!("a checkpoint of step {step}"), || {
        assert!(child.try_wait().unwrap().is_none(), "the run ended before step {step}");
        folder.exists()
    });
}

#[test]
fn a_run_leaves_everything_it_promises() {
    let place = Place::new();
    place.run(&tiny("run", "--method aug-nerf"), 0);
    let files = "config.toml metrics.json metrics.csv scalars.csv timing.json renders/depth.json \
        checkpoints/step_000000040/state.safetensors renders/r_0_rgb.png renders/r_0_truth.png renders/r_0_depth.png \
        renders/r_0_depth16.png renders/r_0_beside.png";
    for file in files.split_whitespace() {
        assert!(place.at("run").join(file).is_file(), "{file}");
    }
    assert_eq!(entries(&place.at("run/checkpoints")).len(), 2, "the last two are kept");
    let metrics = place.json("run/metrics.json");
    assert!(metrics["mean"]["psnr"].as_f64().unwrap() > 3.0);
    assert!(metrics["mean"]["ssim"].is_number());
    assert!(metrics["mean"]["lpips_squeeze"].is_null(), "missing is empty, not 0");
    assert_eq!(metrics["views"].as_array().unwrap().len(), 8);
    let protocol = &metrics["protocol"];
    let named = ["dataset", "scene", "background", "attack", "levels"].map(|field| protocol[field].as_str().unwrap());
    assert_eq!(named, ["builtin-blender", "builtin", "white", "paper", "t xyz view feature rgb density"]);
    assert_eq!((&protocol["steps"], &protocol["seed"], &protocol["width"]), (&40.into(), &0.into(), &16.into()));
    assert_eq!(metrics["attack"].as_array().unwrap().len(), 6, "one summary a level");
    let scalars = place.text("run/scalars.csv");
    assert_eq!(scalars.lines().count(), 1 + 8);
    assert!(scalars.lines().next().unwrap().contains("gain.rgb,gain_over_random.rgb,share_at_bound.rgb,inactive.rgb"));
    // The resolved configuration reproduces the run.
    place.run("train --quiet --config run/config.toml --out again", 0);
    assert_same(&place, "run", "again");
}

#[test]
fn a_regularizer_of_weight_zero_leaves_the_bytes_of_plain_nerf() {
    let place = trained();
    let with = |out: &str, weights: &str| {
        let terms = "regularizer.kind=[\"tv\",\"laplacian\"] regularizer.points_per_step=512 regularizer.weight=";
        place.run(&tiny(out, &set(&format!("{terms}{weights}"))), 0);
    };
    with("zero", "[0,0]");
    assert_same(&place, "run", "zero");
    // One term off is as good as not named.
    with("one", "[1e-3,0]");
    let header = place.text("one/scalars.csv").lines().next().unwrap().to_string();
    assert!(header.contains("regularizer.tv") && !header.contains("laplacian"), "{header}");
    let metrics = place.text("one/metrics.json");
    assert!(metrics.contains(r#""regularizers": "tv 0.001""#) && metrics.contains("sampled 512 of 64^3"), "{metrics}");
    assert!(place.text("run/metrics.json").contains(r#""regularizers": null"#));
}

#[test]
fn smoothness_is_measured_on_one_lattice_for_all_runs() {
    let place = trained();
    place.run(&tiny("aug", "--method aug-nerf --set perturb.field=separate"), 0);
    for run in ["run", "aug"] {
        let table = place.printed(&format!("eval --smoothness --quiet --lattice 12 {run}"));
        let names = "run,field,lattice,domain,l1,tv,laplacian,largest_density,occupied";
        assert_eq!(table.lines().next(), Some(names));
        let rows = rows(&table);
        assert_eq!(rows.len(), 2, "{table}");
        for (row, field) in rows.iter().zip(["coarse", "fine"]) {
            assert_eq!([row["field"].as_str(), &row["lattice"]], [field, "12"]);
            let numbers = names.split(',').skip(4).map(|name| row[name].parse::<f64>().unwrap());
            assert!(numbers.into_iter().all(|number| number >= 0.0), "{row:?}");
        }
    }
    let kept = rows(&place.text("run/smoothness.csv")).remove(0);
    for column in ["lattice", "domain", "tv", "config_hash", "code_revision", "seed", "steps"] {
        assert!(kept.contains_key(column), "{column}: {kept:?}");
    }
    for (flags, words) in [
        ("--lattice 2", &["--lattice", "2", "4 to 1024"][..]),
        ("--bbox 1,2,3", &["--bbox", "six numbers"]),
        ("--bbox=1,1,1,0,0,0", &["--bbox", "corners"]),
        ("--bbox=90,90,90,91,91,91", &["--bbox", "outside", "90.000", "run from"]),
    ] {
        place.says(&format!("eval --smoothness run {flags}"), 2, words);
    }
    place.says("eval --smoothness .", 5, &["not a run folder"]);
}

#[test]
fn balance_prints_a_grid_of_weights() {
    let place = Place::new();
    let grid = "field.hash.levels=4 field.hash.log2_table=10 field.hash.interpolation=smoothstep";
    let small = set(&format!("{TINY} {grid} regularizer.points_per_step=256"));
    let table = place.printed(&format!("train --balance=3 --quiet --preset fast{small}"));
    let rows: Vec<Vec<&str>> = table.lines().skip(1).map(|line| line.split(',').collect()).collect();
    // The built-in scene has no triangulated points.
    assert_eq!(rows.len(), 5 * (REGULARIZERS.len() - 1), "five shares of each term: {table}");
    for row in rows {
        if row[6].is_empty() {
            assert_eq!(row[4].parse::<f64>(), Ok(0.0), "no weight without a gradient: {row:?}");
            continue;
        }
        let number = |i: usize| row[i].parse::<f64>().unwrap();
        let (photometric, term, share, weight) = (number(3), number(4), number(5), number(6));
        assert!((weight * term / photometric / share - 1.0).abs() < 0.02, "{row:?}");
    }
    place.says("train --balance --method aug-nerf", 2, &["aug-nerf", "plain NeRF"]);
}

/// Tables and the moments of entries that gradients have met go through checkpoints, too.
#[test]
fn killed_and_resumed_equals_not_having_stopped() {
    let network = set("train.steps=80 train.eval_every=40");
    let grid = set("field.hash.levels=4 field.hash.log2_table=10 train.steps=90 train.eval_every=30");
    killed_and_resumed("smoke", 20, &format!("--method aug-nerf --set field.precision=bf16{network}"));
    killed_and_resumed("smoke", 20, &format!("--method aug-mip-nerf{network}"));
    killed_and_resumed("fast", 20, &grid);
    killed_and_resumed("fast", 20, &format!("--method aug-nerf --set field.precision=bf16{grid}"));
}

/// A run that is killed once it has the checkpoint of `step`.
fn killed_and_resumed(preset: &str, step: u64, further: &str) {
    let place = Place::new();
    place.run(&tiny_of(preset, "straight", further), 0);
    let mut child = place.start(&tiny_of(preset, "killed", further));
    wait_for_checkpoint(&place.at("killed"), step, &mut child);
    child.kill().unwrap(); // SIGKILL
    child.wait().unwrap();
    assert!(!place.at("killed/metrics.json").exists(), "it was killed too late to test anything");
    place.run("resume --quiet --threads 1 killed", 0);
    assert_same(&place, "straight", "killed");
    // A finished run is only evaluated again.
    let words = ["has ended at step", "the last", "held-out views: PSNR", "augnerf train --from"];
    assert_says(&place.run("resume killed", 0), &words);
    assert_same(&place, "straight", "killed");
}

/// A checkpoint is written before a step that is followed by an evaluation, so that the evaluation can be cut short.
#[cfg(unix)]
#[test]
fn a_signal_during_an_evaluation_loses_nothing() {
    let place = Place::new();
    let settings = "train.steps=6 train.eval_every=3 train.checkpoint_every=0 train.log_every=1";
    let further = set(&format!("{settings} data.width=64 sampling.fine=96"));
    place.run(&tiny("straight", &further), 0);
    let mut child = place.start(&tiny("stopped", &further));
    wait_for_checkpoint(&place.at("stopped"), 2, &mut child);
    // Into step 3 or its evaluation, which takes far longer.
    std::thread::sleep(Duration::from_millis(20));
    let (ended, message) = signalled(child, "-TERM");
    assert_eq!(ended, Some(143), "{message}");
    assert!(message.contains("at step 2") && message.contains("augnerf resume"), "{message}");
    place.run("resume --quiet stopped", 0);
    assert_same(&place, "straight", "stopped");
}

#[test]
fn a_run_without_a_checkpoint_resumes_from_its_start() {
    let place = Place::new();
    place.run(&tiny("straight", "--set train.checkpoint_every=0"), 0);
    copy(&place.at("straight"), &place.at("killed"));
    // What a kill before the first checkpoint leaves: settings, logs, a half-written row and file.
    std::fs::remove_dir_all(place.at("killed/checkpoints")).unwrap();
    std::fs::remove_file(place.at("killed/metrics.json")).unwrap();
    let scalars = place.text("killed/scalars.csv");
    place.write("killed/scalars.csv", &scalars[..scalars.len() - 9]);
    place.write("killed/.augnerf-tmp-1-0-metrics.json", "half");
    place.says("eval killed", 5, &["augnerf resume"]);
    place.run("resume --quiet killed", 0);
    assert_same(&place, "straight", "killed");
}

#[cfg(unix)]
#[test]
fn a_reader_that_goes_away_does_not_stop_training() {
    let place = Place::new();
    let mut child = place.start(&tiny("run", "--set train.steps=10").replace("--quiet", ""));
    drop(child.stderr.take());
    assert_eq!(child.wait().unwrap().code(), Some(0));
    assert!(place.at("run/metrics.json").exists());
}

#[test]
fn no_arguments_train_the_embedded_scene_in_the_default_place() {
    let place = Place::new();
    let said = place.run("train --set train.steps=2 --set data.width=40 --set eval.train_views=2", 0);
    assert_says(&said, &["step 2/2", "loss", "PSNR", "rays/s", "ETA", "8 held-out views"]);
    // What comes next is named, and nothing that was not measured.
    let named = ["results: ", "image: ", "next: augnerf view ", "augnerf mesh ", "augnerf report "];
    assert_says(&said, &named.map(|what| format!("{what}runs/builtin-nerf-")).each_ref().map(String::as_str));
    assert_says(&said, &["/renders/r_0_beside.png"]);
    assert!(!said.contains("LPIPS"), "{said}");
    assert_eq!(entries(&place.at("runs")).len(), 1);
    // The preset that the kind of scene asks for.
    place.run("data export-builtin scene --width 16", 0);
    for (further, lines) in [
        ("", &["encoding = \"hash\"", "kind = \"builtin-blender\""][..]),
        ("--method mip-nerf", &["steps = 1200", "encoding = \"integrated\""]),
        ("--data scene", &["steps = 500000", "fine = 128", "downscale = 2", "kind = \"blender\""]),
    ] {
        assert_says(&place.printed(&format!("train --print-config --quiet {further}")), lines);
    }
}

#[test]
fn eval_and_render_read_a_run_back() {
    let place = trained();
    let trained = place.text("run/metrics.json");
    std::fs::remove_file(place.at("run/metrics.json")).unwrap();
    assert!(place.printed("eval --quiet run").lines().any(|line| line.starts_with("psnr ") && line.ends_with(" dB")));
    assert_eq!(place.text("run/metrics.json"), trained, "the checkpoint gives the numbers of the trained fields");
    place.run("render --quiet run --frames 3", 0);
    for file in ["rgb_002.png", "depth_002.png", "depth16_002.png", "rgb.gif", "depth.gif", "depth.json"] {
        assert!(place.at("run/renders/path").join(file).is_file(), "{file}");
    }
    place.run("render --quiet run --frames 2", 0);
    assert!(!place.at("run/renders/path/rgb_002.png").exists(), "frames of an earlier rendering are left");
    place.says("render run --out run", 4, &["already holds files"]);
    place.run("render --quiet run --what views", 0);
    let beside = image::open(place.at("run/renders/views/r_7_beside.png")).unwrap();
    // Three square views, four pixels apart.
    assert_eq!(beside.width(), 3 * beside.height() + 8);
    for ignored in ["--frames", "--fps"] {
        place.says(&format!("render run --what views {ignored} 2"), 2, &["--what views", ignored]);
    }
    // More frames than memory has room for.
    let camera = json!({"camera_to_world": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 4, 0, 0, 0, 1]});
    place.write("path.json", json!({"camera_path": vec![camera; 3000]}).to_string());
    let words = ["3000 frames of 16384 x 16384", "memory", "--frames", "--resolution"];
    place.says("render run --cameras path.json --resolution 16384x16384", 2, &words);
}

/// GIFs are always written. MP4s are ffmpeg's; without it, or if it fails, the rest is written and the reason is told.
#[test]
#[cfg(unix)]
fn ffmpeg_writes_videos_as_mp4() {
    use std::os::unix::fs::PermissionsExt;
    let place = trained();
    std::fs::create_dir(place.at("bin")).unwrap();
    let writes = "for last; do :; done; [ -f rgb_001.png ] && echo \"$@\" > \"$last\"";
    let fails = "for last; do :; done; echo half > \"$last\"; echo 'no such encoder' >&2; exit 1";
    for (script, expected) in [
        (None, "rgb.gif and depth.gif; to get MP4 as well, install ffmpeg"),
        (Some(writes), "depth.mp4, rgb.mp4, rgb.gif and depth.gif"),
        (Some(fails), "rgb.gif and depth.gif; no MP4: ffmpeg failed (no such encoder)"),
    ] {
        if let Some(script) = script {
            place.write("bin/ffmpeg", format!("#!/bin/sh\n{script}\n"));
            std::fs::set_permissions(place.at("bin/ffmpeg"), PermissionsExt::from_mode(0o755)).unwrap();
        }
        let mut render = place.command("render run --frames 3 --fps 12.5");
        let said = demand(render.env("PATH", place.at("bin")), 0);
        assert_says(&said, &[expected]);
        for name in ["rgb", "depth"] {
            let video = place.at("run/renders/path").join(name).with_extension("mp4");
            assert!(video.with_extension("gif").is_file());
            assert_eq!(video.exists(), script == Some(writes), "{name}: {said}");
            if script == Some(writes) {
                let arguments = std::fs::read_to_string(&video).unwrap();
                assert_says(&arguments, &["-framerate 12.5", &format!("-i {name}_%03d.png"), "yuv420p"]);
            }
        }
    }
}

#[test]
fn the_exported_scene_trains_like_any_other() {
    let place = Place::new();
    assert!(place.printed("data export-builtin scene --width 16").contains("mesh"));
    let said = place.printed("data check scene --set data.downscale=1");
    assert_says(&said, &["blender", "16 x 16", "2.0000 to 6.0000", "40 (", "8 ("]);
    place.run(&tiny("run", "--data scene --set data.width=0 --set data.downscale=1"), 0);
    let before = place.text("run/metrics.json");
    let protocol = &place.json("run/metrics.json")["protocol"];
    assert_eq!((&protocol["dataset"], &protocol["scene"]), (&"blender".into(), &"scene".into()));
    // A scene that has moved keeps its name and its numbers.
    std::fs::rename(place.at("scene"), place.at("elsewhere")).unwrap();
    place.says("eval run", 3, &["scene"]);
    place.run("eval --quiet run --data elsewhere", 0);
    assert_eq!(place.text("run/metrics.json"), before);
    place.run("resume --quiet run --data elsewhere", 0);
}

#[test]
fn wrong_settings_are_refused_with_exit_code_2() {
    let place = Place::new();
    for (flags, words) in [
        ("--set train.stepz=3", &["train.stepz", "train.steps"][..]),
        ("--set train.steps=many", &["train.steps", "many"]),
        ("--set train.steps", &["section.field=value"]),
        ("--preset papr", &["papr", "paper-llff"]),
        ("--method nerv", &["--method nerv", "aug-nerf"]),
        ("--method tv", &["tv is a regularizer", "--set regularizer.kind=tv"]),
        ("--device tpu", &["tpu", "cuda", "gpu:N"]),
        ("--preset smoke --set data.width=16 --set train.rays=100", &["train.rays", "100", "64"]),
        ("--config nowhere.toml", &["nowhere.toml"]),
        ("--no-such-flag", &["--no-such-flag"]),
        ("--set data.name=a/b", &["data.name", "a/b"]),
        ("--set data.spherify=true", &["data.spherify", "builtin-blender"]),
        ("--set data.holdout_offset=1", &["data.holdout_offset", "builtin-blender"]),
        ("--set data.train_views=0", &["data.train_views", "at least 1"]),
        ("--set 'data.train_views=[\"r_1\", \"r_1\"]'", &["data.train_views", "once"]),
        ("--set data.train_views=few", &["train_views", "a number and a rule such as"]),
        ("--set data.kind=builtin-forward --set data.holdout_offset=8", &["data.holdout_offset = 8", "0 to 7"]),
        ("--set data.kind=builtin-forward --set data.eval_split=val", &["data.eval_split", "data.validation"]),
        ("--set data.kind=builtin-forward --set data.validation=1", &["data.validation", "at least 2"]),
    ] {
        place.says(&format!("train {flags}"), 2, words);
    }
    if cfg!(not(feature = "gpu")) {
        place.says("train --device gpu:1", 2, &["--device gpu:1", "--features gpu"]);
    }
    for (text, words) in [
        ("[train]\nsteps = \n", &["mine.toml"][..]),
        ("[trian]\nsteps = 1\n", &["mine.toml", "trian.steps", "train.steps"]),
        ("[train]\nsteps = \"x\"\n", &["mine.toml", "line 2", "steps"]),
    ] {
        place.write("mine.toml", text);
        place.says("train --config mine.toml", 2, words);
    }

    for (settings, words) in [
        ("kind=tvv", &["regularizer.kind", "l1, tv, laplacian, distortion", "or sparse-depth"][..]),
        ("kind=tv weight=-1", &["regularizer.weight", "-1", "0 (off) or positive"]),
        ("kind=tv weight=nan", &["regularizer.weight", "positive"]),
        ("kind=tv weight=[1,2]", &["2 numbers", "1 term;"]),
        ("kind=[\"tv\",\"tv\"]", &["regularizer.kind", "tv", "once"]),
        ("lattice=100000", &["regularizer.lattice", "100000", "4 to 1024"]),
        ("lattice=8", &["regularizer.points_per_step", "4096", "1 to 512", "full"]),
        (
            "kind=tv points=full lattice=257",
            &["regularizer.lattice = 257", "at most 256", "regularizer.points = \"sampled\""],
        ),
        ("domain=[[1,1,1],[0,0,0]]", &["regularizer.domain", "corners"]),
        ("kind=tv domain=[[40,40,40],[41,41,41]]", &["outside of builtin", "run from", "regularizer.domain"]),
    ] {
        let settings = format!(" {settings}").replace(' ', " regularizer.");
        place.says(&tiny("run", &set(&settings)), 2, words);
        assert!(!place.at("run").exists());
    }
}

#[test]
fn output_in_the_way_is_refused_with_exit_code_4_before_training() {
    let place = trained();
    place.says(&tiny("run", ""), 4, &["run", "--overwrite", "resume"]);
    place.write("run/notes.txt", "mine");
    place.run(&tiny("run", "--set train.steps=2 --overwrite"), 0);
    assert_eq!(place.text("run/notes.txt"), "mine");
    // A stranger's folder.
    place.write("theirs/config.toml", "theirs");
    place.write("theirs/main.py", "theirs");
    for overwrite in ["", "--overwrite"] {
        place.says(&tiny("theirs", overwrite), 4, &["not a run folder"]);
    }
    assert_eq!(entries(&place.at("theirs")).len(), 2);
    place.write("file", "not a folder");
    place.says(&tiny("file/run", ""), 4, &["file"]);
    place.says("data export-builtin .", 4, &["empty"]);
}

#[test]
fn a_checkpoint_of_another_architecture_is_refused_with_exit_code_5() {
    let place = Place::new();
    place.run(&tiny("run", "--set train.steps=2"), 0);
    let config = place.text("run/config.toml");
    place.write("run/config.toml", config.replace("[field]\nwidth = 16", "[field]\nwidth = 32"));
    place.says("eval run", 5, &["state.safetensors", "trunk.0.weight", "[16", "[32", "architecture"]);
    place.says("resume run", 5, &["config.toml", "changed"]);
    // The same architecture under other settings is another run, too.
    place.write("run/config.toml", config.replace("pixel_origin = \"corner\"", "pixel_origin = \"centre\""));
    for command in ["eval", "render", "resume"] {
        place.says(&format!("{command} run"), 5, &["config.toml", "changed"]);
    }
    place.says("eval .", 5, &["config.toml"]);
    place.says("resume nothing", 5, &["nothing"]);
}

#[test]
fn non_finite_training_stops_with_exit_code_6_and_advice() {
    let place = Place::new();
    place.says(&tiny("run", "--set train.learning_rate=1e30"), 6, &["step", "train.learning_rate"]);
}

#[test]
fn corruptions_are_recorded_and_can_be_looked_at() {
    let place = Place::new();
    place.run(&tiny("run", "--set data.corruption.kind=shot-noise"), 0);
    let protocol = &place.json("run/metrics.json")["protocol"];
    assert_eq!(protocol["corruption"], "shot-noise 3 (12 photons)");
    let corrupt = "data corrupt new/copy --quiet --set data.width=16 --set data.corruption.kind=shot-noise";
    place.run(corrupt, 0);
    let note = place.json("new/copy/corruption.json");
    assert_eq!(note["corruption_hash"], protocol["corruption_hash"], "the copy is what was trained on");
    assert_eq!(note["data_hash"], protocol["data_hash"]);
    let views = place.text("new/copy/views.csv");
    assert_eq!(entries(&place.at("new/copy/views")).len(), views.lines().count() - 1, "a picture a view");
    assert!(place.at("new/copy/beside.png").is_file());
    assert!(views.lines().skip(1).all(|line| line.ends_with(",0.0,0.0")), "noise moves no camera");
    place.says(corrupt, 4, &["already holds files"]);
    place.run("data corrupt seen --quiet --config run/config.toml", 0);
    assert_eq!(place.text("seen/corruption.json"), place.text("new/copy/corruption.json"));
    place.says("data corrupt other", 2, &["data.corruption.kind", "gaussian-noise, shot-noise, pepper or poses"]);
    let severe = "data corrupt other --set data.corruption.kind=shot-noise --set data.corruption.severity=6";
    place.says(severe, 2, &["severity = 6", "1 to 5"]);
}

#[test]
fn bench_says_what_it_did() {
    let place = Place::new();
    let bench = |more: &str| format!("bench --rays 8 --coarse 8 --fine 8 --width 16 --steps 2 --threads 1 {more}");
    let ask = |more: &str| -> Value { serde_json::from_str(&place.printed(&bench(more))).unwrap() };
    let work = |said: &Value| said["multiply_adds_per_step"].as_f64().unwrap();
    let [nerf, aug, tv] = ["nerf", "aug-nerf", "tv"].map(|method| ask(&format!("--method {method}")));
    assert!(nerf["seconds_per_step"].as_f64().unwrap() > 0.0, "{nerf}");
    assert!(nerf["threads"] == 1 && nerf["method"] == "nerf", "{nerf}");
    // Three forward units clean; twice three in the search and three perturbed besides.
    let ratio = work(&aug) / work(&nerf);
    assert!((3.0..4.5).contains(&ratio) && work(&tv) > work(&nerf), "{nerf} {aug} {tv}");
    assert!(ask("--set field.core=plain")["multiply_adds_per_step"].is_null());
    place.says(&bench("--set field.width=32"), 2, &["field.width", "its own flag"]);
    for flag in ["--rays 0", "--coarse 1", "--width 1", "--width 9999999", "--steps 0"] {
        place.says(&format!("bench {flag}"), 2, &[flag, "give a whole number from"]);
    }
}

/// Built-in scenes by number, as a user names them: trained, resumed, compared with their own surface and no other.
#[test]
fn a_built_in_scene_has_a_number() {
    let place = Place::new();
    let scenes = [("a", "builtin:3"), ("b", "builtin:4"), ("c", "builtin-forward:3"), ("still", "builtin")];
    for (name, data) in scenes {
        place.run(&tiny(name, &format!("--data {data} --set train.steps=2")), 0);
    }
    let of = |name: &str, key: &str| place.json(&format!("{name}/metrics.json"))["protocol"][key].to_string();
    let hashes = scenes.map(|(name, _)| of(name, "data_hash"));
    assert!((0..4).all(|i| hashes[..i].iter().all(|other| *other != hashes[i])), "{hashes:?}");
    let names = ["a", "b", "still"].map(|name| of(name, "scene"));
    assert_eq!(names, ["\"builtin-3\"", "\"builtin-4\"", "\"builtin\""]);
    place.run("data export-builtin files --scene 3 --width 16", 0);
    assert_says(&place.printed("data check files --json"), &["blender"]);
    place.says(&tiny("d", "--data builtin:x"), 3, &["builtin:x", "no such folder"]);
}
