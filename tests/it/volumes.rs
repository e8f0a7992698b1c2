//! Neural Volumes through the trainer and through everything that is done with a run.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use crate::common::files::{json, text};
use crate::common::learning::{Small, assert_learns, assert_precisions_agree, assert_threads_agree};
use crate::common::program::succeed;
use crate::common::{built, tiny_config};
use augnerf::run::load_scene;
use augnerf::settings::{Method, Preset, Resolved, VolumeCode, VolumeConfig};
use candle_core::Device;
use tempfile::TempDir;

const SMALL: Small =
    Small { method: "nv", settings: "nv.resolution=16 nv.divide=16 nv.warp_resolution=4 nv.code=variational" };

/// One run for the tests that only read it.
fn small() -> &'static Path {
    static RUN: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    &RUN.get_or_init(|| SMALL.once()).1
}

fn tiny(code: VolumeCode) -> Resolved {
    tiny_config(Method::Nv, |config| {
        config.nv = VolumeConfig { code, resolution: 16, divide: 16, warp_resolution: 4, ..VolumeConfig::default() };
    })
}

#[test]
fn steps_lower_the_error() {
    // A volume before a plain background that learns from few rays, or at a high rate, empties itself.
    let settings = "method=nv; data.width=16; train.rays=256; train.batching=all-images; train.precrop_steps=0; \
        nv.resolution=16; nv.divide=16; nv.warp_resolution=4";
    let scene = load_scene(built(Some(Preset::Smoke), settings).unwrap(), &()).unwrap();
    assert_learns(&scene, 120, 0.5);
}

/// f32 by operations of our own and f64 by the same or candle's.
#[test]
fn steps_are_the_same_in_both_precisions_and_with_any_number_of_threads() {
    for code in [VolumeCode::Fixed, VolumeCode::Variational] {
        assert_precisions_agree(&tiny(code), "mean_acc");
    }
    assert_threads_agree(&tiny(VolumeCode::Fixed));
}

#[test]
fn a_run_that_was_cut_off_ends_as_one_that_was_not() {
    SMALL.assert_resumes(small());
}

#[test]
fn a_run_has_its_terms_parameters_pictures_and_surface() {
    let run = small();
    let header = text(&run.join("scalars.csv"));
    for column in ["loss_image", "loss_accumulation", "loss_variation", "loss_code", "mean_acc", "psnr"] {
        assert!(header.lines().next().unwrap().split(',').any(|name| name == column), "{column}: {header}");
    }
    let state =
        candle_core::safetensors::load(run.join("checkpoints/step_000000040/state.safetensors"), &Device::Cpu).unwrap();
    for name in ["volume.code", "volume.template.4.weight", "volume.warp.weights.1.bias"] {
        assert!(state.keys().any(|key| key.ends_with(name)), "{name}: {:?}", state.keys());
    }
    let dir = TempDir::new().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    SMALL.train(&dir.path().join("other"), "2");
    let name = run.to_str().unwrap();
    succeed(&["render", "--quiet", name, "--frames", "1", "--out", &at("path")]);
    succeed(&["compare", "--quiet", name, &at("other"), "--out", &at("compared")]);
    // Opacities have hardly moved from ln 2 per half a side of 2.4.
    succeed(&["mesh", "--quiet", name, "--threshold", "0.541", "--resolution", "12", "--out", &at("mesh")]);
    assert!(std::fs::metadata(dir.path().join("mesh/mesh.ply")).unwrap().len() > 100);
    let metrics = json(&run.join("metrics.json"));
    assert!(metrics["mean"]["psnr"].as_f64().unwrap() > 5.0, "{metrics}");
    assert!(metrics["protocol"]["nv"].as_str().unwrap().starts_with("16^3 from 64 channels, warp 4^3"), "{metrics}");
}
