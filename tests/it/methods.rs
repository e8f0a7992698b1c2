//! Methods without radiance fields: what cannot be asked of them is refused in a sentence, and their protocol is theirs.

use crate::common::program::{Place, set};
use crate::common::{assert_says, built, record, row_against, tiny_scene};
use augnerf::base::Result;
use augnerf::report::tables::{Table, table_latex, table_markdown};
use augnerf::report::{Record, TableSpec};
use augnerf::run::surface_threshold;
use augnerf::settings::{Config, DataKind, Extent, Preset};
use augnerf::sweep::{Definition, StepSeconds, expand};

/// The methods, and why each has no density in space; none where it has one.
const BASELINES: [(&str, Option<&str>); 3] = [
    ("srn", Some("an SRN knows where a ray ends, not where space is full")),
    ("nv", None),
    ("llff", Some("no density in space")),
];

fn draft(settings: &[&str]) -> Result<Config> {
    built(Some(Preset::Smoke), &settings.join("; "))
}

/// What is said of settings of a method on a kind of scene; nothing where they are taken.
fn said(kind: DataKind, settings: &[&str]) -> String {
    let located = draft(settings).and_then(|config| config.locate(kind));
    located.map_or_else(|refusal| refusal.to_string(), |_| String::new())
}

#[test]
fn what_cannot_apply_is_refused_by_its_setting() {
    for (method, no_density) in BASELINES {
        let named = format!("method={method}");
        let with = |setting: &str| said(DataKind::Blender, &[&named, setting]);
        for term in ["l1", "tv", "laplacian", "distortion"] {
            let told = with(&format!("regularizer.kind={term}"));
            assert_says(&told, &[&format!("regularizer.kind = \"{term}\" with method {method}: "), "nerf or aug-nerf"]);
        }
        let told = with("eval.mesh.resolution=64");
        match no_density {
            Some(why) => assert_says(&told, &[&format!("eval.mesh.resolution = 64 with method {method}: "), why]),
            None => assert_eq!(told, ""),
        }
        // Read by no method without a second pass, and so taken.
        assert_eq!(with("perturb.lambda=0.5") + &with("field.width=7"), "");
    }
    assert_says(&said(DataKind::Blender, &["method=aug-srn"]), &["aug-srn", "llff"]);
}

#[test]
fn forward_facing_scenes_are_taken_in_the_world_and_by_methods_that_work_there() {
    for forward in [DataKind::Llff, DataKind::BuiltinForward] {
        assert_eq!(said(forward, &["method=srn"]) + &said(forward, &["method=llff"]), "");
        for method in ["method=srn", "method=llff"] {
            assert_says(&said(forward, &[method, "data.ndc=true"]), &["data.ndc = true", "set data.ndc=false"]);
        }
        let told = said(forward, &["method=nv"]);
        assert_says(&told, &[forward.name(), "no bounded box and no known background", "use srn, llff"]);
    }
    assert_eq!(said(DataKind::Llff, &["method=nv", "data.ndc=false", "data.spherify=true"]), "");
}

#[test]
fn numbers_that_networks_cannot_have_are_named() {
    for (setting, words) in [
        ("nv.resolution=48", ["nv.resolution = 48", "a power of two"]),
        ("nv.divide=3", ["nv.divide = 3", "a power of two"]),
        ("nv.step=0", ["nv.step = 0", "above 0.0001"]),
        ("llff.planes=12", ["llff.planes = 12", "a multiple of 8"]),
        ("llff.window=100", ["llff.window = 100", "a multiple of 8"]),
        ("llff.crop=128", ["llff.crop = 128", "64 (llff.window)"]),
        ("llff.far=0", ["llff.far = 0", "positive"]),
        ("srn.steps=0", ["srn.steps = 0", "1 to 1000"]),
        ("srn.scale=0", ["srn.scale = 0", "positive"]),
    ] {
        let method = format!("method={}", setting.split('.').next().unwrap());
        assert_says(&said(DataKind::Blender, &[&method, setting]), &words);
    }
    let ends = ["method=llff", "llff.near=3", "llff.far=2"];
    assert_says(&said(DataKind::Blender, &ends), &["llff.far = 2", "beyond llff.near = 3"]);
}

#[test]
fn commands_that_need_fields_are_refused_before_anything_is_computed() {
    let place = Place::new();
    for (method, _) in BASELINES {
        let balance = format!("train --balance --method {method} --preset smoke");
        place.says(&balance, 2, &["--balance with method", method]);
        let coarse = format!("bench --method {method} --coarse 8");
        place.says(&coarse, 2, &["--coarse 8", method, "omit the flag"]);
    }
    place.says("bench --method llff --rays 8", 2, &["--rays 8", "llff"]);
    place.says("bench --method srn --set srn.width=8", 2, &["srn.width", "its own flag"]);
}

/// A step of every row takes a second.
fn equal(configs: &[&Config]) -> Result<StepSeconds> {
    Ok(configs.iter().map(|config| (*config, 1.0)).collect())
}

#[test]
fn budgets_of_evaluations_are_for_fields_and_those_of_seconds_for_all() {
    let text = |method: &str, kind: &str, like: &str| {
        format!(
            "title = \"t\"\npreset = \"smoke\"\nscenes = [\"builtin\"]\nseeds = [0]\nbudget = {{ kind = \"{kind}\", like = \
             \"{like}\" }}\n[[row]]\nname = \"NeRF\"\n[[row]]\nname = \"Other\"\nset = {{ method = \"{method}\" }}\n"
        )
    };
    for (method, _) in BASELINES {
        let points = |kind: &str, like: &str| {
            expand(&Definition::parse(&text(method, kind, like), "t.toml").unwrap(), None, &equal)
        };
        let named = format!("method {method}");
        for like in ["NeRF", "Other"] {
            let told = points("evaluations", like).unwrap_err().to_string();
            assert_says(&told, &["Other", "budget.kind = \"evaluations\"", &named, "budget.kind = \"seconds\""]);
        }
        let steps: Vec<u64> = points("seconds", "NeRF").unwrap().iter().map(|point| point.config.train.steps).collect();
        assert_eq!(steps, [1200, 1200], "{method}");
    }
    // How many samples occupied cells leave is not known before a step.
    let occupied = text("nerf", "evaluations", "NeRF")
        .replace("smoke", "fast")
        .replace("method = \"nerf\"", "\"sampling.kind\" = \"occupancy\"");
    let told = expand(&Definition::parse(&occupied, "t.toml").unwrap(), None, &equal).unwrap_err().to_string();
    assert_says(&told, &["sampling.kind = \"occupancy\"", "budget.kind = \"seconds\""]);
}

/// A scene fills what is left open, and a resolved configuration resolves to itself.
#[test]
fn open_numbers_follow_from_the_scene() {
    let resolved =
        |method: &str, kind: DataKind, extent: Extent| draft(&[method]).unwrap().resolve(kind, extent).unwrap();
    let extent = augnerf::bench::EXTENT;
    let nv = resolved("method=nv", DataKind::Blender, extent);
    assert_eq!((nv.nv.bounds, nv.nv.step), (Some([[-1.5; 3], [1.5; 3]]), Some(2.0 / 32.0)));
    assert_eq!(nv.nv.cube(), Some(([0.0; 3], 1.5)));
    // Half of the light is stopped in one step of 2/32 of half the cube's side, 1.5.
    assert_eq!(surface_threshold(&nv, &tiny_scene()), 0.5 / (2.0 / 32.0 * 1.5));
    let builtin = resolved("method=nv", DataKind::BuiltinBlender, extent);
    assert_eq!(builtin.nv.cube(), Some(([0.0; 3], 1.2)));
    let flat = Some([[-1.0, 0.0, -1.0], [3.0, 1.0, 1.0]]);
    let capture = resolved("method=nv", DataKind::Transforms, Extent { domain: flat, ..extent });
    assert_eq!(capture.nv.cube(), Some(([1.0, 0.5, 0.0], 2.0)));
    assert_eq!(resolved("method=nv", DataKind::Transforms, extent).nv.cube(), None);
    let llff = resolved("method=llff", DataKind::Blender, extent).llff.clone();
    assert_eq!((llff.near, llff.far), (Some(2.0), Some(6.0)));
    let llff = resolved("method=llff", DataKind::Llff, extent);
    assert_eq!((llff.llff.near, llff.llff.far), (Some(2.0), Some(12.0)));
    let again = llff.clone().into_draft().resolve(DataKind::Llff, extent).unwrap();
    assert_eq!((again.hash(), &*again), (llff.hash(), &*llff));
}

/// A table of rows with and without fields says what each is: captions and notes of differences are about what all have.
#[test]
fn tables_tell_what_rows_without_fields_are() {
    let record = |row, protocol: &[(&str, &str)]| record("chair", row, 0, &[("psnr", Some(20.0))], protocol);
    let nerf = [("width", "200"), ("field_width", "64"), ("field_depth", "8"), ("rays", "512")];
    let records = [
        record("NeRF", &nerf),
        record("Aug-NeRF", &nerf),
        record("SRN", &[("width", "200"), ("rays", "1024"), ("srn", "width 256, 10 steps")]),
        record("LLFF (trained on the scene)", &[("width", "200"), ("llff", "32 planes")]),
    ];
    let printed = |records: &[Record]| {
        let rows = records.iter().map(|record| row_against(&record.row, None)).collect();
        let spec = TableSpec { metrics: vec!["psnr".into()], rows, ..TableSpec::default() };
        let table = Table::new(&spec, records, false).unwrap();
        (table_markdown(&table), table_latex(&table))
    };
    let (markdown, latex) = printed(&records);
    let notes = [
        "SRN: width 256, 10 steps",
        "LLFF (trained on the scene): 32 planes",
        "NeRF, Aug-NeRF: field_width 64, field_depth 8",
        "rows differ in rays: 512 (NeRF, Aug-NeRF); 1024 (SRN)",
        "one network trained on other scenes",
    ];
    assert_says(&markdown, &notes);
    assert_says(&latex, &["SRN: width 256", "LLFF is trained on the scene here"]);
    let (fields, _) = printed(&records[..2]);
    assert!(notes.iter().all(|note| !fields.contains(note)), "{fields}");
    let (without_llff, _) = printed(&records[..3]);
    assert!(without_llff.contains(notes[0]) && !without_llff.contains(notes[4]), "{without_llff}");
}

/// Runs in NDC stand beside those with rays in the world, depths of both in scene units.
#[test]
fn runs_with_and_without_ndc_are_compared_in_scene_units() {
    let place = Place::new();
    for (name, mapped) in [("world", false), ("ndc", true)] {
        let small = set("data.kind=builtin-forward data.width=24 field.width=16 train.steps=8 eval.pictures=0");
        place.run(&format!("train --quiet --preset smoke --out {name}{small} --set data.ndc={mapped}"), 0);
    }
    let compared = |runs: &str, out: &str| {
        place.run(&format!("compare --quiet --out {out} {runs}"), 0);
        let file = place.json(&format!("{out}/compare.json"));
        let end = |i: usize| file["depth_colours"][i].as_f64().unwrap();
        (file["depth_unit"].as_str().unwrap().to_string(), end(0), end(1))
    };
    let (unit, near, far) = compared("ndc", "alone");
    assert!(unit == "NDC" && near >= 0.0 && far <= 1.0, "{unit} {near} {far}");
    for (name, runs) in [("first", "ndc world"), ("second", "world ndc")] {
        // NDC begin a unit before the cameras' mean.
        let (unit, near, far) = compared(runs, name);
        assert!(unit == "scene units" && near > 0.5 && far > near && far.is_finite(), "{unit} {near} {far}");
    }
    place.says("compare ndc world --ray 8,8 --out ray", 2, &["one interval"]);
}

/// A run of a second refuses in the words of its method; what does not hang on fields is done.
#[test]
fn runs_without_fields_refuse_what_needs_them() {
    let place = Place::new();
    let small = "data.width=24 data.test_skip=20 train.steps=2 train.rays=32 eval.pictures=0 eval.train_views=0 srn.width=8 \
                 nv.resolution=8 nv.divide=16 nv.warp_resolution=4 llff.window=24 llff.crop=8 llff.planes=8";
    for (method, no_density) in BASELINES {
        place.run(&format!("train --quiet --preset smoke --method {method} --out {method}{}", set(small)), 0);
        if let Some(why) = no_density {
            let words = ["a mesh of this run with method", method, why, "augnerf compare"];
            place.says(&format!("mesh {method}"), 2, &words);
        }
        let words = [method, "no l1, TV or Laplacian", no_density.unwrap_or("trilinear")];
        place.says(&format!("eval --smoothness {method}"), 2, &words);
        let words = ["a profile along a ray with method", method, "augnerf compare"];
        place.says(&format!("compare {method} --ray 8,8"), 2, &words);
        let protocol = &place.json(&format!("{method}/metrics.json"))["protocol"];
        assert!(protocol["field_width"].is_null() && protocol[method].is_string(), "{protocol}");
    }
    for bench in [
        "llff --set llff.window=32 --set llff.crop=16 --set llff.planes=8",
        "srn --rays 4 --width 8",
        "nv --rays 4 --set nv.resolution=8 --set nv.divide=16 --set nv.warp_resolution=4",
    ] {
        place.run(&format!("bench --steps 1 --method {bench}"), 0);
    }
}
