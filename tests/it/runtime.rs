//! Runtimes: several trainings in one process, none in another's way.

use std::path::Path;
use std::sync::Barrier;
use std::sync::atomic::AtomicUsize;

use augnerf::base::Error;
use augnerf::run::{Existing, Job, Setup};
use augnerf::runtime::Runtime;
use augnerf::settings::Method;

use crate::common::files::{FLEETING, assert_same_files, files};
use crate::common::program::Place;
use crate::common::{tiny_config, tiny_scene};

/// Trains in `folder` on a runtime of its own; what that did.
fn train(folder: &Path, method: Method, threads: usize) -> u64 {
    let runtime = Runtime::new("cpu", Some(threads)).unwrap();
    let config = tiny_config(method, |config| {
        config.train.steps = 12;
        config.train.log_every = 3;
        config.train.eval_every = 6;
        config.train.checkpoint_every = 4;
    });
    let setup = Setup { config, scene: &tiny_scene(), lpips: &[], runtime: runtime.clone() };
    Job::create(folder, Existing::Refuse, setup).unwrap().train(&(), &AtomicUsize::new(0)).unwrap();
    runtime.work().multiply_adds
}

#[test]
fn two_trainings_at_once_give_the_bytes_of_one() {
    let folder = tempfile::TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    let alone = train(&at("alone"), Method::AugNerf, 2);
    train(&at("other alone"), Method::Nerf, 2);
    let together = Barrier::new(2);
    let (first, _) = std::thread::scope(|scope| {
        let start = |name: &'static str, method, threads| {
            let (together, at) = (&together, &at);
            scope.spawn(move || {
                together.wait();
                train(&at(name), method, threads)
            })
        };
        let (first, second) = (start("first", Method::AugNerf, 1), start("second", Method::Nerf, 3));
        (first.join().unwrap(), second.join().unwrap())
    });
    assert_same_files(&at("alone"), &at("first"), &FLEETING);
    assert_same_files(&at("other alone"), &at("second"), &FLEETING);
    assert!(files(&at("alone"), &FLEETING) != files(&at("other alone"), &FLEETING));
    // Another training's work is not counted.
    assert!(alone > 0);
    assert_eq!(alone, first);
}

#[test]
fn what_is_no_device_is_refused() {
    for device in ["abacus", "cpu:1", "cuda:x", "gpu:x"] {
        let Err(Error::Config(message)) = Runtime::new(device, None) else { panic!("{device} is none") };
        assert!(message.starts_with(&format!("device {device}: ")), "{message}");
    }
}

/// Rayon's variable sets the threads unless `--threads` does. What is no number of threads is said.
#[test]
fn rayons_variable_sets_the_threads() {
    let place = Place::new();
    let threads = |variable: Option<&str>, flags: &str| {
        let mut bench = place.command(&format!("bench --rays 8 --coarse 8 --fine 8 --width 16 --steps 1 {flags}"));
        bench.env_remove("RAYON_NUM_THREADS").envs(variable.map(|value| ("RAYON_NUM_THREADS", value)));
        let said = bench.output().unwrap();
        let [answer, notes] = [said.stdout, said.stderr].map(|text| String::from_utf8(text).unwrap());
        let answer: serde_json::Value = serde_json::from_str(answer.lines().next().unwrap()).unwrap();
        (answer["threads"].as_u64().unwrap(), notes.contains("warning: RAYON_NUM_THREADS="))
    };
    let (all, _) = threads(None, "");
    for (variable, flags, expected) in [
        ("3", "", (3, false)),
        ("3", "--threads 2", (2, false)),
        ("", "", (all, false)),
        ("abc", "", (all, true)),
        ("abc", "--quiet", (all, false)),
        ("abc", "--threads 2", (2, false)),
    ] {
        assert_eq!(threads(Some(variable), flags), expected, "{variable:?} {flags}");
    }
}
