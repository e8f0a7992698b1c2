//! SRN, Neural Volumes and LLFF through the trainer and through everything that is done with a run.

use std::path::PathBuf;

use crate::common::files::json;
use crate::common::learning::{Small, assert_keeps, assert_learns, assert_precisions_agree, assert_threads_agree};
use crate::common::program::{refuse, succeed};
use crate::common::{built, tiny_config, tiny_scene};
use augnerf::data::Scene;
use augnerf::run::load_scene;
use augnerf::settings::{Method, Resolved, SrnConfig, VolumeCode, VolumeConfig};
use tempfile::TempDir;

const SRN: Small = Small { method: "srn", settings: "srn.width=24 train.chunk=16" };
const VOLUMES: Small =
    Small { method: "nv", settings: "nv.resolution=16 nv.divide=16 nv.warp_resolution=4 nv.code=variational" };
const PLANES: Small = Small {
    method: "llff",
    settings: "data.kind=builtin-forward llff.planes=8 llff.inputs=3 llff.window=16 llff.crop=8",
};

fn srn() -> Resolved {
    tiny_config(Method::Srn, |config| {
        config.srn = SrnConfig { width: 48, ..SrnConfig::default() };
        config.train.chunk = 16;
    })
}

fn volumes(code: VolumeCode) -> Resolved {
    tiny_config(Method::Nv, |config| {
        config.nv = VolumeConfig { code, resolution: 16, divide: 16, warp_resolution: 4, ..VolumeConfig::default() };
    })
}

fn located(settings: &str) -> (Resolved, Scene) {
    load_scene(built(None, settings).unwrap(), &()).unwrap()
}

#[test]
fn steps_lower_the_error() {
    assert_learns(&(srn(), tiny_scene()), 150, 0.5);
    // A volume before a plain background that learns from few rays, or at a high rate, empties itself.
    let volumes = "method=nv; data.width=16; train.rays=256; train.batching=all-images; train.precrop_steps=0; \
        nv.resolution=16; nv.divide=16; nv.warp_resolution=4";
    assert_learns(&located(volumes), 120, 0.5);
    // Later steps come nearer to the views that they leave out.
    let planes = "method=llff; data.kind=builtin-forward; data.ndc=false; data.width=32; llff.planes=8; llff.inputs=3; \
        llff.window=32; llff.crop=16; train.learning_rate=2e-3";
    assert_learns(&located(planes), 43, 0.7);
}

/// f32 by operations of our own, and f64 by the same or candle's.
#[test]
fn steps_are_the_same_in_both_precisions_and_with_any_number_of_threads() {
    assert_precisions_agree(&srn(), "depth_deviation");
    assert_threads_agree(&srn());
    for code in [VolumeCode::Fixed, VolumeCode::Variational] {
        assert_precisions_agree(&volumes(code), "mean_acc");
    }
    assert_threads_agree(&volumes(VolumeCode::Fixed));
}

/// A run that is resumed as if it had not been cut off, evaluated, rendered and compared. Its protocol describes the method.
#[track_caller]
fn used(small: &Small, description: &str) -> (TempDir, PathBuf) {
    let (dir, run) = small.once();
    small.assert_resumes(&run);
    small.train(&dir.path().join("other"), "2");
    let metrics = json(&run.join("metrics.json"));
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    succeed(&["eval", "--quiet", &at("run")]);
    assert_eq!(json(&run.join("metrics.json")), metrics, "the checkpoint gives the numbers of the trained network");
    succeed(&["render", "--quiet", &at("run"), "--frames", "1", "--out", &at("path")]);
    succeed(&["compare", "--quiet", &at("run"), &at("other"), "--out", &at("compared")]);
    assert!(metrics["mean"]["psnr"].as_f64().unwrap() > 5.0, "{metrics}");
    assert!(metrics["protocol"][small.method].as_str().unwrap().starts_with(description), "{metrics}");
    (dir, run)
}

#[test]
fn a_run_of_srn_has_its_terms_parameters_and_pictures() {
    let (_dir, run) = used(&SRN, "width 24, 4 + 5 layers, 10 steps");
    let parameters = ["phi.0.weight", "phi.3.scale", "lstm.weight_hh", "head.bias", "pixel.5.bias"];
    assert_keeps(&run, &["loss_image", "loss_depth", "depth_deviation", "psnr"], &parameters);
    let metrics = json(&run.join("metrics.json"));
    assert!(metrics["protocol"]["learning_rate"].as_str().unwrap().ends_with(", constant"), "{metrics}");
}

#[test]
fn a_run_of_volumes_has_its_terms_parameters_pictures_and_surface() {
    let (dir, run) = used(&VOLUMES, "16^3 from 64 channels, warp 4^3");
    let terms = ["loss_image", "loss_accumulation", "loss_variation", "loss_code", "mean_acc", "psnr"];
    assert_keeps(&run, &terms, &["volume.code", "volume.template.4.weight", "volume.warp.weights.1.bias"]);
    let mesh = dir.path().join("mesh");
    let [name, out] = [&run, &mesh].map(|path| path.to_str().unwrap());
    // Opacities have hardly moved from ln 2 per half a side of 2.4.
    succeed(&["mesh", "--quiet", name, "--threshold", "0.541", "--resolution", "12", "--out", out]);
    assert!(std::fs::metadata(mesh.join("mesh.ply")).unwrap().len() > 100);
}

#[test]
fn a_run_of_planes_has_pictures_and_no_surface() {
    let (_dir, run) = used(&PLANES, "8 planes");
    refuse(&["mesh", run.to_str().unwrap()], 2, &["LLFF has a stack of planes for each training view"]);
    let few = ["train", "--preset", "smoke", "--method", "llff", "--data", "builtin-forward", "--set"];
    refuse(&[&few[..], &["data.train_views=2"]].concat(), 2, &["needs at least", "training views", "leaves 2"]);
}
