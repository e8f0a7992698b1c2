//! How much memory the program takes of files that are made to take more, and of trainings: watched from outside.

use std::fs;
use std::process::Command;
use std::time::Duration;

use crate::common::program::{Place, augnerf, set};
use crate::common::{assert_says, built};
use crate::hostile::scene;
use augnerf::settings::{DataKind, Preset};

/// Runs a command to its end and returns its exit code, what it said and the most MiB that it had.
fn watched(command: &mut Command) -> (i32, String, f64) {
    let said = tempfile::NamedTempFile::new().unwrap();
    // Both append: neither writes over the other.
    let log = || fs::File::options().append(true).open(said.path()).unwrap();
    let mut child = command.stdout(log()).stderr(log()).spawn().unwrap();
    let status = format!("/proc/{}/status", child.id());
    let mut most = 0.0f64;
    let code = loop {
        let now = fs::read_to_string(&status).unwrap_or_default();
        let kib =
            now.lines().find_map(|line| line.strip_prefix("VmHWM:")?.trim().strip_suffix(" kB")?.parse::<f64>().ok());
        most = most.max(kib.unwrap_or(0.0) / 1024.0);
        if let Some(ended) = child.try_wait().unwrap() {
            break ended.code().unwrap_or(-1);
        }
        std::thread::sleep(Duration::from_millis(1));
    };
    (code, fs::read_to_string(said.path()).unwrap(), most)
}

/// Demands that a file is refused with these words, and with less memory than is promised.
#[track_caller]
fn refused_within_memory(arguments: &[&str], code: i32, words: &[&str]) {
    // A program that ends between two looks is not seen: it runs again.
    for _ in 0..20 {
        let (found, said, most) = watched(&mut augnerf(arguments));
        assert_eq!(found, code, "{said}");
        assert_says(&said, words);
        assert!(most < 1024.0, "{most} MiB: {said}");
        if most > 1.0 {
            return;
        }
    }
    panic!("{arguments:?} was never seen at work");
}

#[test]
fn poses_of_more_bytes_than_a_scene_has_are_refused_as_they_are_read() {
    let dir = scene();
    let text = format!(r#"{{"camera_angle_x": 0.7, "frames": [{}0]}}"#, "[],".repeat(11 << 20));
    fs::write(dir.path().join("transforms.json"), text).unwrap();
    let words = ["transforms.json", "more than 32 MiB"];
    refused_within_memory(&["data", "check", dir.path().to_str().unwrap()], 3, &words);
}

/// What a training of the plain core is said to take is near what it takes: neither is more than one and a half times the
/// other, so that what fits is not refused.
#[test]
#[ignore = "slow"]
fn memory_is_estimated_before_it_is_taken() {
    let every = "field.core=plain train.steps=2 train.batching=all-images data.width=32 eval.chunk=64 eval.train_views=0 \
        eval.pictures=0 data.test_skip=8";
    for (threads, own) in [
        (2, "train.rays=4096 train.chunk=1024 field.width=128 field.depth=8 sampling.fine=24"),
        (1, "train.rays=2048 train.chunk=512 field.width=128 field.depth=4 sampling.fine=64"),
        (2, "train.rays=1024 train.chunk=1024 field.width=256 field.depth=8 sampling.fine=0"),
    ] {
        let (place, settings) = (Place::new(), format!("{every} {own}"));
        let train = format!("train -q --preset smoke --threads {threads} --out run{}", set(&settings));
        let (code, said, most) = watched(&mut place.command(&train));
        assert_eq!(code, 0, "{said}");
        let config = built(Some(Preset::Smoke), &settings.replace(' ', "; ")).unwrap();
        let config = config.resolve(DataKind::BuiltinBlender, augnerf::bench::EXTENT).unwrap();
        let said = augnerf::train::graphs_mib(&config, threads);
        println!("{said:.0} MiB estimated, {most:.0} MiB taken");
        assert!(said < 1.5 * most && most < 1.5 * said, "{said} MiB estimated, {most} MiB taken");
    }
}
