//! Files and arguments that broke the program once, or were made to: each is refused in a sentence, soon, and without
//! taking the machine's memory.

use std::fs;
use std::io::Write;
use std::time::{Duration, Instant};

use crate::common::files::fixture;
use crate::common::program::{Place, augnerf, set};
use crate::common::{assert_says, built};
use augnerf::base::Error;
use augnerf::mesh::read_mesh;
use augnerf::metrics::{Backbone, Lpips};
use augnerf::settings::build;
use candle_core::Device;
use tempfile::TempDir;

/// Ten times as long as any of these files takes to be refused on a slow machine: only a hang takes longer.
const HANG: Duration = Duration::from_secs(600);
/// Longest message for a person.
const MESSAGE: usize = 20_000;

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

/// Every file of weights here is either description too large, too deep, or not what it says: tuples in tuples, as deep as the
/// file is long, are the end of the program where reading or dropping them recurses. A million of them side by side are each of a
/// byte in the file, as are copies of a memo's entry.
#[test]
fn weights_ask_for_no_more_than_they_hold() {
    let start = b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.\x80\x02K\x01.\x80\x02K\x01.";
    let pickled = |parts: &[&[u8]]| [&start[..], &parts.concat(), b"."].concat();
    let stored = |name: &str| fs::read(fixture(&format!("hostile/{name}"))).unwrap();
    for (file, words) in [
        (stored("shape.pth"), "2 sizes and 0 strides"),
        (stored("shape3.pth"), "squeeze"),
        (stored("laughs.pth"), "deep"),
        (stored("zlaughs.pth"), "deep"),
        (stored("panic-35683"), "checksum"),
        (pickled(&[b")", &[0x85; 1_000_000]]), "deep"),
        (pickled(&[&[b')'; 1_000_000]]), "64 MiB"),
        (pickled(&[b"X\x00\xff\0\0", &[b'x'; 0xff00], b"q\0", &b"h\0".repeat(10_000)]), "64 MiB"),
    ] {
        let dir = TempDir::new().unwrap();
        fs::write(dir.path().join("squeezenet1_1_features.pth"), file).unwrap();
        // The features are looked at where the linear layers are sound.
        let header = r#"{"lin0.model.1.weight":{"dtype":"F32","shape":[1],"data_offsets":[0,4]}}"#;
        let linear = [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), &[0; 4]].concat();
        fs::write(dir.path().join("squeeze_lin_v0.1.safetensors"), linear).unwrap();
        let message = refused(|| Lpips::load(dir.path(), Backbone::Squeeze, &Device::Cpu).map(|_| ()));
        assert_says(&message, &["squeezenet1_1_features.pth", words]);
    }
}

#[test]
fn rows_without_properties_are_not_counted() {
    for name in ["hostile/pl6.ply", "hostile/pl7.ply"] {
        let message = refused(|| read_mesh(&fixture(name)));
        assert_says(&message, &[name, "1000000000000 rows of 0 properties"]);
    }
}

#[test]
fn settings_are_not_nested_without_an_end() {
    let deep = vec!["a"; 60_000].join(".");
    let place = Place::new();
    place.says(&format!("train --print-config --set {deep}=1"), 2, &["60000 parts"]);
    let tables = format!("[{deep}]\nx = 1\n");
    let [arrays, inline] = ["[", "{a="].map(|open| format!("method = {}", open.repeat(100_000)));
    for text in [format!("{deep} = 1\n"), tables, arrays, inline] {
        place.write("config.toml", &text);
        let file = place.at("config.toml");
        assert_says(&refused(|| build(None, Some(&file), &[])), &["config.toml"]);
        refused(|| augnerf::sweep::Definition::read(&file));
        refused(|| built(None, &text));
    }
    let head = "title = 'a'\npreset = 'smoke'\nscenes = ['builtin']\nseeds = [0]";
    place.write("sweep.toml", format!("{head}\n[set]\n'{deep}' = 1\n[[row]]\nname = 'a'\n"));
    place.says("sweep plan sweep.toml", 2, &["60000 parts"]);
}

/// A scene of two views.
pub fn scene() -> TempDir {
    let dir = TempDir::new().unwrap();
    let frame = |i: usize| {
        image::RgbImage::new(8, 8).save(dir.path().join(format!("{i}.png"))).unwrap();
        format!(r#"{{"file_path": "{i}", "transform_matrix": [[1,0,0,{i}],[0,1,0,0],[0,0,1,4],[0,0,0,1]]}}"#)
    };
    let text = format!("{{\"camera_angle_x\": 0.7, \"frames\": [{}, {}]}}", frame(0), frame(1));
    fs::write(dir.path().join("transforms.json"), text).unwrap();
    dir
}

#[test]
fn a_terminal_gets_no_commands_from_files() {
    let place = Place::with("config.toml", "title = \"a\u{1b}[31m\u{9b}2J\"\n\"b\\u0000\u{202e}\" = 1\n");
    let message = place.run("train --print-config --config config.toml", 2);
    assert!(!message.contains(['\u{1b}', '\0', '\u{9b}', '\u{202e}']), "{message:?}");
    place.write("a.obj", format!("v 0 0 {}\u{1b}[2J\0\n", "y".repeat(5 << 20)));
    let mesh = set("data.width=12 eval.mesh.resolution=16 eval.mesh.reference=a.obj");
    let message = place.run(&format!("train --preset smoke{mesh}"), 3);
    assert!(message.len() < MESSAGE && !message.contains(['\u{1b}', '\0']), "{} bytes", message.len());
}

/// As `--config <(...)` has it: a pipe by the name that the shell gives it. A picture of a scene is no pipe: nobody would write
/// to it.
#[cfg(unix)]
#[test]
fn pipes_are_read_where_a_user_names_them_alone() {
    let place = Place::with("sweep.toml", "extends = \"/dev/zero\"\n");
    for command in ["train --print-config --config /dev/zero", "sweep plan sweep.toml"] {
        place.says(command, 2, &["/dev/zero", "more than 4 MiB"]);
    }
    let mut reading = augnerf(&["train", "--print-config", "--config", "/dev/stdin"]);
    let reading = reading.stdin(std::process::Stdio::piped()).stdout(std::process::Stdio::piped());
    let mut child = reading.spawn().unwrap();
    child.stdin.take().unwrap().write_all(b"train.steps = 77\n").unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success() && String::from_utf8_lossy(&output.stdout).contains("steps = 77"));
    let scene = scene();
    fs::remove_file(scene.path().join("0.png")).unwrap();
    std::os::unix::fs::symlink("/dev/zero", scene.path().join("0.png")).unwrap();
    Place::new().says(&format!("data check {}", scene.path().display()), 3, &["transforms.json", "frame 0"]);
}
