use std::fs;

use tempfile::NamedTempFile;

use crate::augment::Site;
use crate::base::Result;
use crate::settings::registry::REGISTRY;
use crate::settings::{Config, DataKind, Extent, Preset, build, parse_assignment, value_at};

use super::filled_in;

const BLENDER: DataKind = DataKind::BuiltinBlender;

fn built(preset: Option<Preset>, file: Option<&NamedTempFile>, texts: &[&str]) -> Result<Config> {
    let assignments: Vec<_> = texts.iter().map(|text| parse_assignment(text).unwrap()).collect();
    build(preset, file.map(NamedTempFile::path), &assignments)
}

/// Settings as a run of a scene has them.
fn resolved(config: Config, kind: DataKind) -> Config {
    config.resolve(kind, Extent { near: 2.0, far: 6.0, domain: None, pixels: 16 }).unwrap().into_draft()
}

fn file_of(text: &str) -> NamedTempFile {
    let file = NamedTempFile::new().unwrap();
    fs::write(file.path(), text).unwrap();
    file
}

/// The file of a run with these settings.
fn run(preset: Option<Preset>, texts: &[&str], kind: DataKind) -> NamedTempFile {
    file_of(&resolved(built(preset, None, texts).unwrap(), kind).to_toml())
}

/// Settings over a run with preset `cpu`.
fn over(texts: &[&str], kind: DataKind, given: &[&str]) -> Result<Config> {
    built(None, Some(&run(Some(Preset::Cpu), texts, kind)), given).map(|config| resolved(config, kind))
}

fn refusal(texts: &[&str], kind: DataKind, given: &[&str]) -> String {
    over(texts, kind, given).unwrap_err().to_string()
}

/// As if all settings had been given at once.
#[test]
fn numbers_that_a_run_had_by_default_follow_what_changes() {
    let (aug, calibrated) = ("method=aug-nerf", "perturb.attack=calibrated");
    for (texts, given) in [
        (&["method=nerf"][..], &[aug, calibrated][..]),
        (&[aug], &[calibrated]),
        (&[aug, calibrated], &["perturb.attack=paper"]),
        (&[aug, calibrated], &["perturb.geometry=paper"]),
        (&[aug, calibrated], &["perturb.t.steps=10", "sampling.coarse=48"]),
        (&[aug, calibrated], &["data.near=3"]),
        // What was chosen, or is given, stays.
        (&[aug, "perturb.t.epsilon=0.3", "perturb.rgb.steps=2"], &[calibrated, "perturb.feature.epsilon=0.02"]),
        (&[aug, calibrated, "perturb.rgb.epsilon=0.5"], &[calibrated, "train.steps=9"]),
        (&["regularizer.kind=tv"], &["regularizer.kind=l1"]),
        (&["regularizer.kind=tv"], &["regularizer.kind=['l1','tv']"]),
        (&["regularizer.kind=tv"], &["regularizer.kind=[]"]),
        (&[], &["regularizer.kind=distortion"]),
        (&["regularizer.kind=depth-smoothness"], &["train.rays=128"]),
        (&[], &["train.batching=all-images"]),
        (&["train.batching=all-images"], &["train.batching=one-image"]),
        (&["train.precrop_steps=7"], &["train.batching=all-images"]),
        (&["method=nv"], &["nv.resolution=32"]),
        (&["field.encoding=hash"], &["field.hash.contraction=ball"]),
    ] {
        let all = [texts, given].concat();
        let at_once = resolved(built(Some(Preset::Cpu), None, &all).unwrap(), BLENDER);
        assert_eq!(over(texts, BLENDER, given).unwrap(), at_once, "{texts:?} {given:?}");
    }
    // Outside NDC a grid's box is another one.
    let (texts, given) = (["field.encoding=hash"], ["data.ndc=false"]);
    let all = [texts[0], given[0]];
    let at_once = resolved(built(Some(Preset::Cpu), None, &all).unwrap(), DataKind::BuiltinForward);
    assert_eq!(over(&texts, DataKind::BuiltinForward, &given).unwrap(), at_once);
}

#[test]
fn a_calibrated_attack_over_a_plain_run_is_large_enough_to_matter() {
    let given = ["method=aug-nerf", "perturb.attack=calibrated"];
    let perturb = over(&[], BLENDER, &given).unwrap().perturb;
    let t = &perturb.sites[Site::T];
    assert_eq!((t.steps, t.step_size, t.epsilon), (Some(3), Some(2.5 / 3.0), Some(0.25.into())));
    assert_eq!(perturb.sites[Site::Rgb].epsilon, Some((4.0 / 255.0).into()));
}

/// Names and bytes of runs that go on are those of the same settings with what was given.
#[test]
fn what_changes_no_default_leaves_a_run_s_settings_as_they_are() {
    for (name, preset) in Preset::ALL {
        for texts in [&[][..], &["method=aug-nerf", "perturb.attack=calibrated"]] {
            let config = resolved(built(Some(preset), None, texts).unwrap(), BLENDER);
            let file = file_of(&config.to_toml());
            assert_eq!(built(None, Some(&file), &[]).unwrap(), config, "{name}");
            let mut longer = config.clone();
            (longer.train.steps, longer.seed, longer.perturb.lambda) = (600_000, 3, 0.2);
            let given = ["train.steps=600000", "seed=3", "perturb.lambda=0.2"];
            let found = built(None, Some(&file), &given).unwrap();
            assert_eq!((found.to_toml(), found.hash()), (longer.to_toml(), longer.hash()), "{name}");
        }
    }
}

/// A person chose what such a file says.
#[test]
fn a_file_that_is_no_run_s_keeps_what_it_says() {
    let file =
        file_of("[regularizer]\nkind = \"tv\"\nweight = 3.8e-6\n\n[perturb.t]\nepsilon = 0.5\nstep_size = 0.01\n");
    let found = built(None, Some(&file), &["regularizer.kind=l1", "perturb.attack=calibrated"]).unwrap();
    assert_eq!(found.regularizer.weight, [3.8e-6]);
    assert_eq!(found.perturb.sites[Site::T].step_size, Some(0.01));
}

/// Another representation starts from its own layer.
#[test]
fn another_representation_has_what_it_starts_from() {
    let hash = |preset, texts: &[&str]| resolved(built(preset, None, texts).unwrap(), BLENDER).hash();
    for (texts, given) in [
        (&["field.encoding=hash"][..], &["field.encoding=positional"][..]),
        (&["field.encoding=positional"], &["field.encoding=hash"]),
        (&["method=nerf"], &["method=mip-nerf"]),
        (&["method=aug-mip-nerf"], &["method=aug-nerf"]),
        (&["method=nerf"], &["method=srn"]),
        (&["method=srn"], &["method=nerf"]),
        // What was chosen stays.
        (&["train.rays=77", "field.width=48"], &["field.encoding=hash"]),
    ] {
        let found = built(None, Some(&run(None, texts, BLENDER)), given).unwrap();
        assert_eq!(resolved(found, BLENDER).hash(), hash(None, &[texts, given].concat()), "{texts:?} {given:?}");
    }
    // A preset's numbers look like chosen ones.
    let message = refusal(&[], BLENDER, &["field.encoding=hash"]);
    for words in ["field.encoding = \"hash\" over a run", "sampling.coarse = 32", "train.rays = 512", "; set "] {
        assert!(message.contains(words), "{message}");
    }
    assert!(!message.contains("field.width") && !message.contains("train.steps"), "{message}");
    let given = ["field.encoding=hash", "sampling.coarse=32", "train.rays=256"];
    let found = over(&[], BLENDER, &given).unwrap();
    assert_eq!((found.sampling.coarse, found.train.rays, found.field.rgb_limit), (32, 256, 8.0));
}

#[test]
fn what_cannot_be_told_is_asked_for() {
    let (aug, calibrated, paper) = ("method=aug-nerf", "perturb.attack=calibrated", "perturb.attack=paper");
    // Density's size hangs on a capture's near and far.
    let capture = |given: &[&str]| over(&[aug, calibrated], DataKind::Colmap, given);
    let message = refusal(&[aug, calibrated], DataKind::Colmap, &[paper]);
    assert!(
        message.starts_with("perturb.density.epsilon = ") && message.contains("; set perturb.density.epsilon, too")
    );
    assert!(!message.contains("perturb.t."), "{message}");
    capture(&[paper, "perturb.density.epsilon=1e-5"]).unwrap();
    capture(&[paper, "perturb.levels=input"]).unwrap();
    capture(&["train.steps=9"]).unwrap();
    // Numbers that were chosen for something else.
    for (texts, given, words) in [
        (&["regularizer.kind=tv", "regularizer.weight=0.5"][..], "regularizer.kind=l1", "names l1, and the run chose"),
        (&[aug, "perturb.t.step_size=0.02"], calibrated, "; set perturb.t.step_size, too"),
        (&[aug], "perturb.step_unit=relative", "perturb.rgb.step_size, perturb.density.step_size, too"),
    ] {
        let message = refusal(texts, BLENDER, &[given]);
        assert!(message.contains(words), "{message}");
    }
    let none = over(&["regularizer.kind=tv", "regularizer.weight=0.5"], BLENDER, &["regularizer.kind=[]"]).unwrap();
    assert!(none.regularizer.weight.is_empty());
}

/// Each setting that a run fills in is in the list, or has a default by the scene alone.
#[test]
fn every_number_that_is_filled_in_is_known() {
    const OF_SCENE: [&str; 7] = [
        "data.downscale",
        "data.pixel_origin",
        "sampling.density_noise",
        "train.batching",
        "train.decay_steps",
        "field.hash.finest",
        "nv.bounds",
    ];
    let known: Vec<String> = filled_in().collect();
    for texts in [
        &[][..],
        &["field.encoding=hash"],
        &["method=nv"],
        &["method=llff"],
        &["regularizer.kind=['tv','depth-smoothness']"],
    ] {
        let open = built(None, None, texts).unwrap();
        let (open, filled) = (open.to_table(), resolved(open, BLENDER).to_table());
        for setting in &REGISTRY.settings {
            let path = setting.path.as_str();
            // The same for every attack.
            let is_constant = path.starts_with("perturb.") && (path.ends_with(".steps") || path.ends_with(".norm"));
            let is_filled = setting.optional && value_at(&open, path).is_none() && value_at(&filled, path).is_some();
            let is_known = known.iter().any(|known| known == path) || OF_SCENE.contains(&path) || is_constant;
            assert!(!is_filled || is_known, "{path}: list it in over_run.rs, or here");
        }
    }
}
