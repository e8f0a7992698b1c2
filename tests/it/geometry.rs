//! Meshes, their comparison, and depth, as a user meets them.

use crate::common::files::{newest, points_of, seal};
use crate::common::program::{Place, set, tiny_sweep};
use augnerf::data::npy::{Array, read_array};
use augnerf::mesh::{Reference, chamfer, read_mesh, sample};

/// A folder with a run of a second or two on the embedded scene at 24 x 24.
fn trained(further: &str) -> Place {
    let small = "data.width=24 field.width=32 sampling.coarse=16 sampling.fine=16 train.rays=128 train.steps=150 \
        train.precrop_steps=5 eval.pictures=0";
    Place::trained(&format!("{} {further}", set(small)))
}

#[test]
fn a_run_is_drawn_compared_and_drawn_again_alike() {
    let place = trained("");
    let draw = "mesh run --quiet --resolution 48 --threshold 1.5 --cap --format ply,obj";
    place.run(&format!("{draw} --density"), 0);
    let report = place.json("run/mesh/mesh.json");
    assert_eq!(report["closed"], true, "a capped level set is closed: {report}");
    assert!(report["area"].as_f64().unwrap() > 0.1 && report["volume"].as_f64().unwrap() > 0.0);
    assert_eq!(report["protocol"]["dataset"], "builtin-blender");
    assert_eq!(report["box"], serde_json::json!([[-1.2, -1.2, -1.2], [1.2, 1.2, 1.2]]));

    // The volume is the density that the report speaks of.
    let Array { shape, values } = read_array(&place.at("run/mesh/density.npy")).unwrap();
    assert_eq!(shape, [48, 48, 48]);
    let largest = values.iter().copied().fold(0.0, f64::max);
    assert!((report["density"]["largest"].as_f64().unwrap() - largest).abs() < 1e-6 * largest);
    let inside = values.iter().filter(|&&value| value >= 1.5).count() as f64 / values.len() as f64;
    assert_eq!(report["density"]["inside"], inside);

    // Both files hold one mesh, at 0 from itself.
    let [ply, obj] = ["ply", "obj"].map(|format| place.at(&format!("run/mesh/mesh.{format}")));
    let first = std::fs::read(&ply).unwrap();
    let [a, b] = [&ply, &obj].map(|file| sample(&read_mesh(file).unwrap(), 5000, 0).unwrap());
    assert!(chamfer(&a, &b, 0.001).unwrap().chamfer < 1e-5);

    // The same bytes again; the earlier files are replaced as a whole.
    place.run("mesh run --quiet --resolution 48 --threshold 1.5 --cap --threads 1", 0);
    assert_eq!(std::fs::read(&ply).unwrap(), first);
    assert!(!obj.exists() && !place.at("run/mesh/density.npy").exists());
    place.run(&format!("{draw} --largest"), 0);
    let largest = place.json("run/mesh/mesh.json");
    assert_eq!(largest["components"], report["components"]);
    let (left, all) = (largest["area"].as_f64().unwrap(), report["area"].as_f64().unwrap());
    assert!(if largest["components"] == 1 { left == all } else { left < all }, "{left} of {all}");
}

#[test]
fn what_cannot_be_drawn_is_refused_with_what_could() {
    let place = trained("");
    for (flags, words) in [
        ("--resolution 24 --threshold 1e6", &["1000000", "runs from 0", "choose a threshold between"][..]),
        (
            "--resolution 24 --memory 0.001",
            &["resolution 24 outgrows 0.001 MiB", "a lower resolution or allow more memory"],
        ),
        (
            "--resolution 24 --threshold 0.5 --memory 0.2",
            &["outgrows", "of 24 planes", "triangles", "lower resolution"],
        ),
        ("--resolution 24 --threshold=-1", &["--threshold", "positive"]),
        ("--resolution 24 --bbox 1,1,1,0,0,0", &["--bbox", "corners"]),
        ("--resolution 24 --bbox 8,8,8,9,9,9", &["outside of"]),
        ("--resolution 4", &["resolution"]),
        ("--out R.OBJ", &["--out R.OBJ", "name a folder"]),
        ("--resolution 0", &["8 to 1024"]),
    ] {
        place.says(&format!("mesh run {flags}"), 2, words);
    }
    place.says("render run --out film.mp4", 2, &["--out film.mp4", "name a folder"]);
    place.says("mesh none", 5, &["missing"]);
    assert!(!place.at("run/mesh").exists(), "a refusal leaves nothing");
    // The threshold that a refusal names works.
    let draw =
        |value: &str| format!("mesh run --quiet --bbox=-1.2,-1.2,-1.2,1.2,1.2,1.2 --resolution 32 --threshold {value}");
    let message = place.run(&draw("1e6"), 2);
    let (_, rest) = message.rsplit_once("such as ").unwrap_or_else(|| panic!("{message}"));
    place.run(&draw(rest.split([' ', ',']).next().unwrap()), 0);
    assert!(place.json("run/mesh/mesh.json")["faces"].as_u64().unwrap() > 0);
}

#[test]
fn broken_weights_are_named() {
    let place = trained("");
    let checkpoint = newest(&place.at("run/checkpoints"));
    let file = checkpoint.join("state.safetensors");
    let mut tensors = candle_core::safetensors::load(&file, &candle_core::Device::Cpu).unwrap();
    let bias = tensors.get_mut("fine.density.bias").unwrap();
    *bias = (bias.clone() * f64::NAN).unwrap();
    candle_core::safetensors::save(&tensors, &file).unwrap();
    // Broken by training, not on the disk.
    seal(&checkpoint);
    place.says("mesh run --resolution 16", 6, &["the density at", "is NaN", "weights are broken"]);
}

#[test]
fn an_evaluation_measures_depth_and_where_asked_the_surface() {
    ["nerf", "mip-nerf"].into_iter().for_each(measures_depth_and_surface);
}

fn measures_depth_and_surface(method: &str) {
    // MipNeRF's own rate is still warming up within so few steps.
    let settings = "eval.mesh.resolution=32 eval.mesh.threshold=1.5 eval.mesh.points=5000 train.schedule=exponential \
        train.steps=400";
    let place = trained(&format!("--method {method}{}", set(settings)));
    let metrics = place.json("run/metrics.json");
    let mean = &metrics["mean"];
    for name in ["depth_mae", "depth_rmse", "depth_roughness", "depth_roughness_truth", "normal_roughness", "chamfer"] {
        assert!(mean[name].as_f64().unwrap() > 0.0, "{name}: {mean}");
    }
    assert!(mean["depth_mae"].as_f64() <= mean["depth_rmse"].as_f64());
    assert!((0.0..=1.0).contains(&mean["depth_left_out"].as_f64().unwrap()));
    assert!((0.0..=1.0).contains(&mean["f_score"].as_f64().unwrap()));
    let words = metrics["protocol"]["mesh"].as_str().unwrap();
    assert!(words.contains("32^3") && words.contains("builtin") && words.contains("5000 points"), "{words}");
    let table = place.text("run/metrics.csv");
    assert!(table.lines().next().unwrap().contains("depth_mae,depth_rmse,depth_left_out"), "{table}");
    // Once more from the checkpoint.
    place.run("eval run --quiet", 0);
    assert_eq!(place.json("run/metrics.json"), metrics);
    // And by hand, from the files.
    place.run("mesh run --quiet --resolution 32 --threshold 1.5", 0);
    let variance = place.json("run/mesh/mesh.json")["variance"][2].as_f64();
    assert_eq!(variance.is_some(), method == "mip-nerf");
    assert!(variance.is_none_or(|found| (found / ((2.4f64 / 32.0).powi(2) / 12.0) - 1.0).abs() < 1e-12));
    let mesh = sample(&read_mesh(&place.at("run/mesh/mesh.ply")).unwrap(), 5000, 0).unwrap();
    let compared = chamfer(&mesh, &Reference::builtin(None).sample(5000, 0).unwrap(), 0.02).unwrap();
    assert!((compared.chamfer - mean["chamfer"].as_f64().unwrap()).abs() < 1e-6);
    assert!((compared.f_score - mean["f_score"].as_f64().unwrap()).abs() < 1e-3);
}

#[test]
fn without_a_reference_mesh_no_training_begins() {
    let place = Place::new();
    place.write("line.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n");
    place.write("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    place.write("bare.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n");
    let forward = "data.kind=builtin-forward";
    let beyond = format!("{forward} eval.mesh.box=[[-1,-1,-1],[1,1,1.5]] eval.mesh.reference=a.obj");
    for (settings, code, words) in [
        (forward, 2, ["eval.mesh.reference", "needs a reference mesh"]),
        ("eval.mesh.reference=/nowhere/a.ply", 3, ["/nowhere/a.ply", ""]),
        ("eval.mesh.reference=line.obj", 3, ["line.obj", "no area"]),
        ("eval.mesh.reference=bare.obj", 3, ["bare.obj", "no faces"]),
        ("eval.mesh.box=[[8,8,8],[9,9,9]]", 2, ["eval.mesh.box", "outside of"]),
        (&beyond, 2, ["eval.mesh.box", "1.5"]),
        ("eval.mesh.threshold=0", 2, ["eval.mesh.threshold", ""]),
        ("eval.mesh.resolution=2000", 2, ["eval.mesh.resolution", "1024"]),
    ] {
        let small = set("eval.mesh.resolution=32 data.width=24 train.rays=64");
        place.says(&format!("train --quiet --out run{small}{}", set(settings)), code, &words);
    }
    assert!(!place.at("run").exists());
}

#[test]
fn a_scene_in_ndc_has_its_mesh_and_depth_in_scene_units() {
    let place = trained(&set("data.kind=builtin-forward"));
    let mean = &place.json("run/metrics.json")["mean"];
    // Depths of the forward scene are between 1 and 4 units: an error in NDC would be under 1, in wrong units far
    // above.
    assert!((1e-3..2.0).contains(&mean["depth_mae"].as_f64().unwrap()), "{mean}");
    place.run("mesh run --quiet --resolution 32 --threshold 1 --cap --format obj", 0);
    let report = place.json("run/mesh/mesh.json");
    assert_eq!((&report["box_units"], &report["closed"]), (&"NDC".into(), &true.into()));
    assert!(report["volume"].as_f64().unwrap() > 0.0, "the map from NDC turns triangles over");
    let text = place.text("run/mesh/mesh.obj");
    let depths =
        text.lines().filter(|line| line.starts_with("v ")).map(|line| line.split(' ').nth(3).unwrap().parse().unwrap());
    assert!(depths.clone().count() > 10 && depths.into_iter().all(|z: f64| z < -1.0), "beyond the near plane");
}

#[test]
fn a_sweep_has_columns_of_geometry_and_says_what_they_need() {
    let place = Place::new();
    let sweep = |name: &str, surface: &str| {
        let metrics = ["psnr", "chamfer", "f_score", "depth_mae", "normal_roughness"];
        let definition = tiny_sweep(&[0], &metrics, &format!("train.steps=40 eval.pictures=0 {surface}"), &[]);
        place.write(&format!("{name}.toml"), definition.replace("\"data.width\" = 16", "\"data.width\" = 24"));
        format!("sweep run {name}.toml --out {name} --quiet")
    };
    place.says(&sweep("bare", ""), 2, &["NeRF", "chamfer", "eval.mesh.resolution"]);
    // A density that none of these densities reaches: no surface, so no number.
    let none = sweep("none", "eval.mesh.resolution=16 eval.mesh.threshold=1e6");
    place.run(&none, 0);
    // What stays missing is looked for once a run, not for ever.
    place.run(&format!("{none} --remeasure"), 0);
    place.run(&sweep("some", "eval.mesh.resolution=16 eval.mesh.threshold=0.01 eval.mesh.points=2000"), 0);
    for (name, there) in [("none", false), ("some", true)] {
        let row = points_of(&place.at(name).join("results")).remove(0);
        assert_eq!((!row["chamfer"].is_empty(), !row["f_score"].is_empty()), (there, there), "{name}");
        assert!(row["depth_mae"].parse::<f64>().unwrap() > 0.0 && !row["normal_roughness"].is_empty());
        assert!(row["mesh"].contains("16^3"), "{name}: {}", row["mesh"]);
    }
}

#[test]
fn a_mesh_is_drawn_as_a_picture_from_several_sides() {
    let place = trained("");
    let draw = "mesh run --resolution 24 --threshold 1";
    place.run(&format!("{draw} --picture mesh.png --at 0.1,0.6 --columns 64 --paint colours"), 0);
    let picture = image::open(place.at("mesh.png")).unwrap().to_rgb8();
    assert_eq!(picture.dimensions(), (64 + 4 + 64, 64));
    let coloured = picture.pixels().filter(|pixel| pixel.0.iter().max().unwrap() - pixel.0.iter().min().unwrap() > 20);
    assert!(coloured.count() > 20);
    for (flags, code, words) in [
        ("--view 99", 2, ["--view 99", "held-out views"]),
        ("--at 1.5", 2, ["--at 1.5: out of range", ""]),
        ("--picture mesh.jpg", 2, ["mesh.jpg", ".png"]),
        ("--picture nowhere/mesh.png", 4, ["no folder nowhere", ""]),
    ] {
        let picture = if flags.contains("--picture") { "" } else { "--picture mesh.png" };
        place.says(&format!("{draw} {picture} {flags}"), code, &words);
    }
}
