//! Scene Representation Networks through the trainer and through everything that is done with a run.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use crate::common::files::{json, text};
use crate::common::learning::{Small, assert_learns, assert_precisions_agree, assert_threads_agree};
use crate::common::program::succeed;
use crate::common::{tiny_config, tiny_scene};
use augnerf::settings::{Method, Resolved, SrnConfig};
use candle_core::Device;
use tempfile::TempDir;

const SMALL: Small = Small { method: "srn", settings: "srn.width=24 train.chunk=16" };

/// One run for the tests that only read it.
fn small() -> &'static Path {
    static RUN: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    &RUN.get_or_init(|| SMALL.once()).1
}

fn tiny() -> Resolved {
    tiny_config(Method::Srn, |config| {
        config.srn = SrnConfig { width: 48, ..SrnConfig::default() };
        config.train.chunk = 16;
    })
}

#[test]
fn steps_lower_the_error() {
    assert_learns(&(tiny(), tiny_scene()), 150, 0.5);
}

/// f32 on packed weights and f64 in candle's operations.
#[test]
fn steps_are_the_same_in_both_precisions_and_with_any_number_of_threads() {
    assert_precisions_agree(&tiny(), "depth_deviation");
    assert_threads_agree(&tiny());
}

#[test]
fn a_run_that_was_cut_off_ends_as_one_that_was_not() {
    SMALL.assert_resumes(small());
}

#[test]
fn a_run_has_its_terms_parameters_and_pictures() {
    let run = small();
    let header = text(&run.join("scalars.csv"));
    for column in ["loss_image", "loss_depth", "depth_deviation", "psnr"] {
        assert!(header.lines().next().unwrap().split(',').any(|name| name == column), "{column}: {header}");
    }
    let state =
        candle_core::safetensors::load(run.join("checkpoints/step_000000040/state.safetensors"), &Device::Cpu).unwrap();
    for name in ["phi.0.weight", "phi.3.scale", "lstm.weight_hh", "head.bias", "pixel.5.bias"] {
        assert!(state.keys().any(|key| key.ends_with(name)), "{name}: {:?}", state.keys());
    }
    let dir = TempDir::new().unwrap();
    let [other, path, compared] = ["other", "path", "compared"].map(|name| dir.path().join(name));
    SMALL.train(&other, "2");
    let [run_name, other, path, compared] = [run, &other, &path, &compared].map(|path| path.to_str().unwrap());
    succeed(&["render", "--quiet", run_name, "--frames", "1", "--out", path]);
    succeed(&["compare", "--quiet", run_name, other, "--out", compared]);
    let metrics = json(&run.join("metrics.json"));
    assert!(metrics["mean"]["psnr"].as_f64().unwrap() > 5.0, "{metrics}");
    assert!(metrics["protocol"]["learning_rate"].as_str().unwrap().ends_with(", constant"), "{metrics}");
    assert!(metrics["protocol"]["srn"].as_str().unwrap().starts_with("width 24, 4 + 5 layers, 10 steps"), "{metrics}");
}
