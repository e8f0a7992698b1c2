//! What every method without fields is held to: equal steps in both precisions and with any number of threads, and runs that end
//! as they would have without a stop.

use std::path::{Path, PathBuf};

use augnerf::data::Scene;
use augnerf::runtime::Runtime;
use augnerf::settings::Resolved;
use augnerf::train::Trainer;
use candle_core::{DType, Device};
use tempfile::TempDir;

use super::files::{assert_same_files, rows, text};
use super::program::succeed;
use super::{flat, runtime, tiny_scene};

/// Of a run, what need not repeat: clocks and locks.
pub const FLEETING: [&str; 2] = ["timing.json", "run.lock"];

/// A run of a second on the embedded scene, 40 steps with a checkpoint every 20, both of which are kept.
pub struct Small {
    /// The method's name.
    pub method: &'static str,
    /// What makes it small, `key=value` with spaces between.
    pub settings: &'static str,
}

impl Small {
    /// A run for the tests that only read it.
    pub fn once(&self) -> (TempDir, PathBuf) {
        let dir = TempDir::new().unwrap();
        let out = dir.path().join("run");
        self.train(&out, "1");
        (dir, out)
    }

    pub fn train(&self, out: &Path, threads: &str) {
        let steps = "data.width=16 train.rays=64 train.steps=40 train.checkpoint_every=20 train.keep_checkpoints=2 eval.pictures=1";
        let set = steps.split_whitespace().chain(self.settings.split_whitespace());
        let run = ["train", "--quiet", "--preset", "smoke", "--method", self.method, "--threads", threads, "--out"];
        let set = set.flat_map(|setting| ["--set", setting]);
        succeed(&run.into_iter().chain([out.to_str().unwrap()]).chain(set).collect::<Vec<_>>());
    }

    /// Other threads, and a stop half-way, leave the bytes of `whole`.
    #[track_caller]
    pub fn assert_resumes(&self, whole: &Path) {
        let dir = TempDir::new().unwrap();
        let out = dir.path().join("run");
        self.train(&out, "3");
        assert_same_files(whole, &out, &FLEETING);
        std::fs::remove_dir_all(out.join("checkpoints/step_000000040")).unwrap();
        succeed(&["resume", "--quiet", "--threads", "2", out.to_str().unwrap()]);
        assert_same_files(whole, &out, &FLEETING);
    }
}

/// Demands columns of a run's log, and parameters of its last checkpoint by the ends of their names.
#[track_caller]
pub fn assert_keeps(run: &Path, columns: &[&str], parameters: &[&str]) {
    let log = rows(&text(&run.join("scalars.csv"))).remove(0);
    columns.iter().for_each(|column| assert!(log.contains_key(*column), "{column}: {log:?}"));
    let state = run.join("checkpoints/step_000000040/state.safetensors");
    let state = candle_core::safetensors::load(state, &Device::Cpu).unwrap();
    for name in parameters {
        assert!(state.keys().any(|key| key.ends_with(name)), "{name}: {:?}", state.keys());
    }
}

/// f32 and f64 take the same steps: loss, squared error and a term that is logged.
#[track_caller]
pub fn assert_precisions_agree(config: &Resolved, term: &str) {
    let steps = |dtype: DType| -> Vec<[f64; 3]> {
        let mut trainer = Trainer::new(config, &tiny_scene(), dtype, runtime()).unwrap();
        let step = |_| {
            let stats = trainer.step(true).unwrap();
            [stats.loss, stats.mse, stats.term(term).unwrap()]
        };
        (0..4).map(step).collect()
    };
    for (single, double) in steps(DType::F32).iter().zip(steps(DType::F64)) {
        for (a, b) in single.iter().zip(double) {
            assert!((a - b).abs() < 2e-3 * b.abs(), "{single:?} {double:?}");
        }
    }
}

/// Later steps have a smaller squared error: the mean of the last ten to that of the first ten, at most `ratio`.
#[track_caller]
pub fn assert_learns((config, scene): &(Resolved, Scene), steps: usize, ratio: f64) {
    let mut trainer = Trainer::new(config, scene, DType::F32, runtime()).unwrap();
    let errors: Vec<f64> = (0..steps).map(|_| trainer.step(false).unwrap().mse).collect();
    let mean = |errors: &[f64]| errors.iter().sum::<f64>() / errors.len() as f64;
    let (first, last) = (mean(&errors[..10]), mean(&errors[steps - 10..]));
    assert!(last < ratio * first, "{first} {last}");
}

#[track_caller]
pub fn assert_threads_agree(config: &Resolved) {
    let parameters = |threads: usize| -> Vec<f64> {
        let runtime = Runtime::new("cpu", Some(threads)).unwrap();
        let mut trainer = Trainer::new(config, &tiny_scene(), DType::F32, &runtime).unwrap();
        (0..3).for_each(|_| drop(trainer.step(false).unwrap()));
        trainer.model().unwrap().variables().iter().flat_map(|(_, var)| flat(var)).collect()
    };
    let one = parameters(1);
    assert!(one == parameters(2) && one == parameters(3));
}
