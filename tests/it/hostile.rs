//! Files and arguments that broke the program once, or were made to: each is refused in a sentence, soon, and without
//! taking the machine's memory.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::common::assert_says;
use crate::common::program::{augnerf, demand, refuse, succeed};
use augnerf::base::Error;
use augnerf::metrics::{Backbone, Lpips};
use augnerf::settings::{build, parse_assignment};
use augnerf::space::read_mesh;
use candle_core::Device;
use tempfile::TempDir;

/// Ten times as long as any of these files takes to be refused on a slow machine: only a hang takes longer.
pub const HANG: Duration = Duration::from_secs(600);
/// Longest message for a person.
const MESSAGE: usize = 20_000;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/hostile").join(name)
}

/// Demands an error, short and without a hang, and gives its sentence.
#[track_caller]
fn refused<T>(read: impl FnOnce() -> augnerf::base::Result<T>) -> String {
    let started = Instant::now();
    let error: Error = read().err().expect("must be refused");
    let message = error.to_string();
    assert!(started.elapsed() < HANG, "took {:?}: {message}", started.elapsed());
    assert!(message.len() < MESSAGE && !matches!(error, Error::Tensor(_)), "{message}");
    message
}

/// Every file of weights here is either description too large, too deep, or not what it says.
#[test]
fn weights_ask_for_no_more_than_they_hold() {
    for (name, words) in [
        ("shape.pth", "2 sizes and 0 strides"),
        ("shape3.pth", "squeeze"),
        ("laughs.pth", "deep"),
        ("zlaughs.pth", "deep"),
        ("panic-35683", "checksum"),
    ] {
        let dir = TempDir::new().unwrap();
        let load = || refused(|| Lpips::load(dir.path(), Backbone::Squeeze, &Device::Cpu).map(|_| ()));
        fs::copy(fixture(name), dir.path().join("squeezenet1_1_features.pth")).unwrap();
        fs::copy(fixture(name), dir.path().join("squeeze_lin_v0.1.pth")).unwrap();
        let message = load();
        // What opens as a file of weights is looked at after the features.
        let named = if message.contains("squeeze_lin") { words } else { "squeezenet1_1_features.pth" };
        assert_says(&message, &[named]);
        // The features are looked at where the linear layers are sound.
        fs::remove_file(dir.path().join("squeeze_lin_v0.1.pth")).unwrap();
        let header = r#"{"lin0.model.1.weight":{"dtype":"F32","shape":[1],"data_offsets":[0,4]}}"#;
        let linear = [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), &[0; 4]].concat();
        fs::write(dir.path().join("squeeze_lin_v0.1.safetensors"), linear).unwrap();
        assert_says(&load(), &["squeezenet1_1_features.pth", words]);
    }
}

/// Tuples in tuples, as deep as the file is long: the end of the program, where reading or dropping them recurses. A
/// million of them side by side, each of a byte in the file, and copies of a memo's entry.
#[test]
fn weights_are_not_nested_and_not_repeated_without_an_end() {
    let start = b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.\x80\x02K\x01.\x80\x02K\x01.";
    let name = [&b"X\x00\xff\0\0"[..], &[b'x'; 0xff00], b"q\0"].concat();
    for (pickle, word) in [
        ([&b")"[..], &[0x85; 1_000_000]].concat(), "deep"),
        (vec![b')'; 1_000_000], "64 MiB"),
        ([&name[..], &b"h\0".repeat(10_000)].concat(), "64 MiB"),
    ] {
        let file = [start, &pickle[..], b"."].concat();
        let dir = TempDir::new().unwrap();
        for name in ["squeeze_lin_v0.1.pth", "squeezenet1_1_features.pth"] {
            fs::write(dir.path().join(name), &file).unwrap();
        }
        let message = refused(|| Lpips::load(dir.path(), Backbone::Squeeze, &Device::Cpu).map(|_| ()));
        assert_says(&message, &[word]);
    }
}

#[test]
fn rows_without_properties_are_not_counted() {
    for name in ["pl6.ply", "pl7.ply"] {
        let message = refused(|| read_mesh(&fixture(name)));
        assert_says(&message, &[name, "1000000000000 rows of 0 properties"]);
    }
    let file = fixture("pl6.ply");
    refuse(&["mesh", file.to_str().unwrap(), "--chamfer", file.to_str().unwrap()], 3, &["pl6.ply", "1000000000000"]);
}

#[test]
fn settings_are_not_nested_without_an_end() {
    let deep = vec!["a"; 60_000].join(".");
    refuse(&["train", "--print-config", "--set", &format!("{deep}=1")], 2, &["60000 parts"]);
    let dir = TempDir::new().unwrap();
    let file = dir.path().join("config.toml");
    let tables = format!("[{deep}]\nx = 1\n");
    let arrays = format!("method = {}", "[".repeat(100_000));
    let inline = format!("method = {}", "{a=".repeat(100_000));
    for text in [format!("{deep} = 1\n"), tables, arrays, inline] {
        fs::write(&file, &text).unwrap();
        let message = refused(|| build(None, Some(&file), &[]));
        assert_says(&message, &["config.toml"]);
        let sweep = dir.path().join("sweep.toml");
        fs::write(&sweep, &text).unwrap();
        refused(|| augnerf::sweep::Definition::read(&sweep));
        let set = format!(
            "title = 'a'\npreset = 'smoke'\nscenes = ['builtin']\nseeds = [0]\n[set]\n'{deep}' = 1\n[[row]]\nname = 'a'\n"
        );
        fs::write(&sweep, set).unwrap();
        refuse(&["sweep", "plan", sweep.to_str().unwrap()], 2, &["60000 parts"]);
        refused(|| parse_assignment(&text).and_then(|one| build(None, None, &[one])));
    }
}

#[test]
fn names_of_a_megabyte_are_refused_at_once() {
    let name = "x".repeat(1 << 20);
    let message = refused(|| parse_assignment(&format!("train.{name}=1")).and_then(|one| build(None, None, &[one])));
    assert_says(&message, &["unknown key", "did you mean"]);
}

/// A scene of two views; `keys` stand in the document, `x` is where the first camera is.
pub fn scene(keys: &str, x: &str) -> TempDir {
    let dir = TempDir::new().unwrap();
    let frame = |i: usize, x: &str| {
        image::RgbImage::new(8, 8).save(dir.path().join(format!("{i}.png"))).unwrap();
        format!(r#"{{"file_path": "{i}", "transform_matrix": [[1,0,0,{x}],[0,1,0,0],[0,0,1,4],[0,0,0,1]]}}"#)
    };
    let text = format!("{{{keys}, \"frames\": [{}, {}]}}", frame(0, x), frame(1, "0"));
    fs::write(dir.path().join("transforms.json"), text).unwrap();
    dir
}

#[test]
fn numbers_that_f32_cannot_hold_are_refused_with_file_and_field() {
    let angle = r#""camera_angle_x": 0.7"#;
    succeed(&["data", "check", scene(angle, "0.5").path().to_str().unwrap()]);
    for (keys, x, field) in [
        (r#""camera_angle_x": 5e-324"#, "0.5", "camera_angle_x"),
        (r#""camera_angle_x": 3.14159265358979"#, "0.5", "camera_angle_x"),
        (r#""fl_x": 1e39"#, "0.5", "fl_x"),
        (r#""fl_x": 5e-324"#, "0.5", "fl_x"),
        (r#""fl_x": 20, "cx": -1e300"#, "0.5", "cx"),
        (r#""fl_x": 20, "w": 1e-300, "h": 1e-300"#, "0.5", "\"w\""),
        (angle, "1e39", "transform_matrix"),
        (angle, "-1e308", "transform_matrix"),
    ] {
        let dir = scene(keys, x);
        refuse(&["data", "check", dir.path().to_str().unwrap()], 3, &["transforms.json", field]);
    }
}

#[test]
fn a_terminal_gets_no_commands_and_no_megabytes_from_files() {
    let dir = TempDir::new().unwrap();
    let config = dir.path().join("config.toml");
    fs::write(&config, "title = \"a\u{1b}[31m\u{9b}2J\"\n\"b\\u0000\u{202e}\" = 1\n").unwrap();
    let message = demand(&mut augnerf(&["train", "--print-config", "--config", config.to_str().unwrap()]), 2);
    assert!(!message.contains(['\u{1b}', '\0', '\u{9b}', '\u{202e}']), "{message:?}");
    fs::write(&config, format!("steps = {}", "x".repeat(3 << 20))).unwrap();
    let message = demand(&mut augnerf(&["train", "--print-config", "--config", config.to_str().unwrap()]), 2);
    assert!(message.len() < MESSAGE, "{} bytes", message.len());
    assert_says(&message, &["config.toml", "characters) ..."]);
    let mesh = dir.path().join("a.obj");
    fs::write(&mesh, format!("v 0 0 {}\u{1b}[2J\0\n", "y".repeat(5 << 20))).unwrap();
    let message = demand(&mut augnerf(&["mesh", mesh.to_str().unwrap(), "--chamfer", "builtin"]), 3);
    assert!(message.len() < MESSAGE && !message.contains(['\u{1b}', '\0']), "{} bytes", message.len());
}

#[cfg(unix)]
#[test]
fn devices_end_and_pipes_are_read() {
    refuse(&["train", "--print-config", "--config", "/dev/zero"], 2, &["/dev/zero", "more than 4 MiB"]);
    let dir = TempDir::new().unwrap();
    let sweep = dir.path().join("sweep.toml");
    fs::write(&sweep, "extends = \"/dev/zero\"\n").unwrap();
    refuse(&["sweep", "plan", sweep.to_str().unwrap()], 2, &["/dev/zero", "more than 4 MiB"]);
    // As `--config <(...)` has it: a pipe by the name that the shell gives it.
    let mut reading = augnerf(&["train", "--print-config", "--config", "/dev/stdin"]);
    let reading = reading.stdin(std::process::Stdio::piped()).stdout(std::process::Stdio::piped());
    let mut child = reading.spawn().unwrap();
    child.stdin.take().unwrap().write_all(b"train.steps = 77\n").unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success() && String::from_utf8_lossy(&output.stdout).contains("steps = 77"));
    // A picture or table of a scene is no pipe: nobody would write to it.
    let scene = scene(r#""camera_angle_x": 0.7"#, "0.5");
    fs::remove_file(scene.path().join("0.png")).unwrap();
    std::os::unix::fs::symlink("/dev/zero", scene.path().join("0.png")).unwrap();
    refuse(&["data", "check", scene.path().to_str().unwrap()], 3, &["transforms.json", "frame 0"]);
}

#[test]
fn lists_of_a_million_views_are_refused_before_they_are_read() {
    let dir = scene(r#""camera_angle_x": 0.7"#, "0.5");
    let frame = r#"{"file_path": "0", "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]},"#;
    let text = format!(r#"{{"camera_angle_x": 0.7, "frames": [{}{{}}]}}"#, frame.repeat(1_000_000));
    fs::write(dir.path().join("transforms.json"), text).unwrap();
    // No timing: the message says that reading ended at 32 MiB.
    refuse(&["data", "check", dir.path().to_str().unwrap()], 3, &["transforms.json", "more than 32 MiB"]);
}

/// Only the header of a picture is real, which is all that may be looked at before its memory is taken.
#[test]
fn pictures_that_memory_does_not_hold_are_refused_before_they_are_decoded() {
    let dir = scene(r#""camera_angle_x": 0.7"#, "0.5");
    let header = |side: u32| {
        let mut chunk = b"IHDR".to_vec();
        chunk.extend([side.to_be_bytes(), side.to_be_bytes()].concat());
        chunk.extend([8, 2, 0, 0, 0]);
        let mut sum = flate2::Crc::new();
        sum.update(&chunk);
        let sum = sum.sum().to_be_bytes();
        [&b"\x89PNG\r\n\x1a\n\0\0\0\x0d"[..], &chunk, &sum, b"\0\0\0\0IDAT\x35\xaf\x06\x1e\0\0\0\0IEND\xae\x42\x60\x82"]
            .concat()
    };
    for i in 0..2 {
        fs::write(dir.path().join(format!("{i}.png")), header(1_000_000)).unwrap();
    }
    let arguments = ["data", "check", dir.path().to_str().unwrap(), "--set", "data.downscale=1"];
    refuse(&arguments, 3, &["2 images of 1000000x1000000 pixels", "GiB", "data.downscale"]);
}
