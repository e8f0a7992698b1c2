//! `augnerf render --serve`: requests as lines of JSON, images as those of `render --cameras`.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use augnerf::data::npy::{Array, read_array};
use serde_json::{Value, json};

use crate::common::assert_says;
use crate::common::files::{entries, text};
use crate::common::program::{Place, set, wait_for};

/// No answer on a busy machine takes so long.
const PATIENCE: Duration = Duration::from_secs(600);

/// A folder with the run that most tests serve, `RUN`.
fn shared() -> Place {
    Place::once("served", |place| train(place, ""))
}

/// A run of a second at 16 x 16, with further settings.
fn train(place: &Place, settings: &str) {
    let small =
        "data.width=16 field.width=16 sampling.coarse=8 sampling.fine=8 train.rays=64 train.steps=12 eval.pictures=0";
    place.run(&format!("train --quiet --preset smoke --out RUN{}{}", set(small), set(settings)), 0);
}

const SERVE: &str = "render RUN --serve --out served --quiet";

/// A server that is killed when it is dropped.
struct Served {
    child: Child,
    answers: Receiver<String>,
}

impl Served {
    /// Starts a server and returns it with its first line.
    fn start(place: &Place) -> (Served, Value) {
        let mut command = place.command(SERVE);
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let (sender, answers) = channel();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        std::thread::spawn(move || lines.map_while(Result::ok).try_for_each(|line| sender.send(line)));
        let served = Served { child, answers };
        let ready = served.answer();
        (served, ready)
    }

    /// The next answer.
    fn answer(&self) -> Value {
        serde_json::from_str(&self.answers.recv_timeout(PATIENCE).expect("an answer")).unwrap()
    }

    fn write(&mut self, text: &str) {
        let input = self.child.stdin.as_mut().unwrap();
        input.write_all(text.as_bytes()).and_then(|()| input.flush()).unwrap();
    }

    /// Sends a line and returns its answer.
    fn ask(&mut self, line: &str) -> Value {
        self.write(&format!("{line}\n"));
        self.answer()
    }

    fn ended(&mut self) -> ExitStatus {
        let mut status = None;
        wait_for("the server's end", || {
            status = self.child.try_wait().unwrap();
            status.is_some()
        });
        status.unwrap()
    }

    /// Ends the input, demands success, and returns the answers that were left.
    fn end(mut self) -> Vec<Value> {
        drop(self.child.stdin.take());
        assert_eq!(self.ended().code(), Some(0));
        self.answers.iter().map(|line| serde_json::from_str(&line).unwrap()).collect()
    }

    fn signal(&self, name: &str) {
        assert!(Command::new("kill").args([name, &self.child.id().to_string()]).status().unwrap().success());
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        // It may have ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A camera that looks along -z from a little right of (0, 0, `z`).
fn camera(z: f64) -> Value {
    json!({ "camera_to_world": [1, 0, 0, 0.3, 0, 1, 0, 0.1, 0, 0, 1, z, 0, 0, 0, 1], "fov": 50, "w": 20, "h": 12 })
}

/// The same camera with further keys.
fn with(camera: &Value, further: Value) -> String {
    let mut camera = camera.as_object().unwrap().clone();
    camera.extend(further.as_object().unwrap().clone());
    Value::Object(camera).to_string()
}

const ALL: [&str; 7] =
    ["rgb.png", "depth.png", "accumulation.png", "normals.png", "rgb.npy", "depth.npy", "accumulation.npy"];

/// Values of an 8-bit image as the program rounds them.
fn eight_bits(values: &[f64]) -> Vec<u8> {
    values.iter().map(|value| (*value as f32 * 255.0).round() as u8).collect()
}

#[test]
fn images_are_those_of_render_cameras_byte_for_byte() {
    let place = shared();
    // The run is free while it is served.
    let (mut served, ready) = Served::start(&place);
    assert_eq!((&ready["ready"], &ready["protocol"]), (&json!(true), &json!(1)));
    assert_eq!((&ready["step"], &ready["width"], &ready["height"]), (&json!(12), &json!(16), &json!(16)));
    assert_eq!((&ready["run"], &ready["folder"]), (&json!("RUN"), &json!("served")));
    assert_eq!(ready["outputs"], json!(ALL));
    let off_centre = with(&camera(3.0), json!({ "fl_x": 17.5, "fl_y": 16, "cx": 8.25, "cy": 7 }));
    let off_centre: Value = serde_json::from_str(&off_centre).unwrap();
    let own_size = json!({ "camera_to_world": camera(4.5)["camera_to_world"] });
    let mut images = Vec::new();
    for (index, camera) in [camera(4.0), off_centre, own_size].iter().enumerate() {
        let answer = served.ask(&with(camera, json!({ "outputs": ALL, "name": format!("view-{index}") })));
        assert_eq!(answer["request"], index);
        assert!(answer["milliseconds"].is_u64(), "{answer}");
        let file = |output: &str| place.at("served").join(answer["files"][output].as_str().unwrap());
        let expected = format!("expected{index}");
        place.write("camera.json", json!({ "camera_path": [camera] }).to_string());
        place.run(&format!("render RUN --cameras camera.json --out {expected} --quiet"), 0);
        let bytes = |path: PathBuf| std::fs::read(path).unwrap();
        for kind in ["rgb", "depth"] {
            let same = bytes(file(&format!("{kind}.png"))) == bytes(place.at(&format!("{expected}/{kind}_000.png")));
            assert!(same, "{kind} of camera {index} differs");
        }
        check_values(&place, &expected, &file);
        images.push(bytes(file("rgb.png")));
    }
    assert!(images[0] != images[1] && images[1] != images[2], "the cameras see different things");
    assert_eq!(entries(&place.at("served")).len(), 3 * ALL.len());
    assert!(served.end().is_empty());
}

/// Arrays have the numbers of which the images are.
fn check_values(place: &Place, expected: &str, file: &dyn Fn(&str) -> PathBuf) {
    let array = |output: &str| read_array(&file(output)).unwrap();
    let png = |output: &str| image::open(file(output)).unwrap().to_rgb8();
    let (rgb, depth, acc) = (array("rgb.npy"), array("depth.npy"), array("accumulation.npy"));
    let colours = png("rgb.png");
    let (width, height) = (colours.width() as usize, colours.height() as usize);
    assert_eq!((rgb.shape, depth.shape), (vec![height, width, 3], vec![height, width]));
    assert_eq!(&eight_bits(&rgb.values), colours.as_raw());
    let grey = eight_bits(&acc.values.iter().map(|acc| acc.clamp(0.0, 1.0)).collect::<Vec<_>>());
    assert_eq!(png("accumulation.png").as_raw().iter().step_by(3).copied().collect::<Vec<u8>>(), grey);
    assert_eq!((png("normals.png").width(), png("normals.png").height()), (width as u32, height as u32));
    // 16-bit depth is in scene units, and says nothing where less than half of the light is stopped.
    let steps = image::open(place.at(&format!("{expected}/depth16_000.png"))).unwrap().to_luma16();
    let unit = place.json(&format!("{expected}/depth.json"))["max"].as_f64().unwrap() / 65535.0;
    let scale = place.json("RUN/scene.json")["world_to_scene"]["scale"].as_f64().unwrap();
    let mut compared = 0;
    for ((step, depth), acc) in steps.as_raw().iter().zip(&depth.values).zip(&acc.values) {
        assert_eq!(*step > 0, *acc >= 0.5);
        if *step > 0 {
            assert!((depth * scale - f64::from(*step) * unit).abs() <= unit, "{depth} {step}");
            compared += 1;
        }
    }
    assert!(compared > 0, "some light is stopped");
}

#[test]
fn wrong_requests_are_answered_in_words_and_the_next_is_read() {
    let place = shared();
    let (mut served, _) = Served::start(&place);
    let good = camera(4.0);
    let further = |further: Value| with(&good, further);
    let nowhere = good.to_string().replace("0.3", "NaN");
    let doubled = good.to_string().replacen('1', "2", 1);
    let deep = "[".repeat(5000);
    let long = format!("{{\"name\": \"{}\"}}", "a".repeat(1 << 17));
    let wrong = [
        ("", vec!["request 0", "not valid JSON"]),
        ("render", vec!["request 1", "not valid JSON"]),
        ("[1, 2]", vec!["request 2", "must be an object"]),
        ("{}", vec!["request 3", "camera_to_world"]),
        (&nowhere, vec!["request 4", "camera_to_world", "16 numbers"]),
        (&doubled, vec!["request 5", "rotation", "2.0000"]),
        (&further(json!({ "w": 100_000 })), vec!["\"w\" is", "1 to 16384"]),
        (&further(json!({ "w": 16384, "h": 16384 })), vec!["16384 x 16384 pixels", "at most 16777216"]),
        (&further(json!({ "fov": 180 })), vec!["\"fov\" is 180", "between 0 and 180"]),
        (&further(json!({ "fx": 20 })), vec!["unknown key \"fx\"", "fl_x", "outputs"]),
        (&further(json!({ "outputs": ["rgb"] })), vec!["\"outputs\"", "rgb.png", "depth.npy"]),
        (&further(json!({ "outputs": [] })), vec!["\"outputs\"", "one or more"]),
        (&further(json!({ "name": "../secret" })), vec!["\"name\" must be", "letters"]),
        (&further(json!({ "name": ".hidden" })), vec!["\"name\" must be", "dot"]),
        (&further(json!({ "name": "a".repeat(101) })), vec!["\"name\" must be 1 to 100"]),
        (&deep, vec!["not valid JSON", "recursion"]),
        (&long, vec!["longer than 65536 bytes"]),
    ];
    for (index, (line, words)) in wrong.iter().enumerate() {
        let answer = served.ask(line);
        assert_eq!(answer["request"], index);
        let error = answer["error"].as_str().unwrap_or_else(|| panic!("{line}: {answer}"));
        assert_says(error, words);
        assert!(!error.contains('\n') && answer.get("files").is_none(), "{answer}");
    }
    assert!(entries(&place.at("served")).is_empty(), "a wrong request left a file");
    // Names are those of the requests unless they state others.
    let answer = served.ask(&good.to_string());
    assert_eq!(answer["files"], json!({ "rgb.png": format!("{:03}_rgb.png", wrong.len()) }));
    // A folder in the way of a file, until it is gone.
    let taken = place.at("served/taken_rgb.png");
    std::fs::create_dir(&taken).unwrap();
    let ask = further(json!({ "name": "taken" }));
    assert_says(served.ask(&ask)["error"].as_str().unwrap(), &["cannot write", "taken_rgb.png"]);
    std::fs::remove_dir(&taken).unwrap();
    assert_eq!(served.ask(&ask)["files"]["rgb.png"], "taken_rgb.png");
    assert!(taken.is_file());
}

/// A program may send many requests before it reads, and needs no end of its last line.
#[test]
fn answers_come_in_the_order_of_requests_also_at_the_end_of_input() {
    let place = shared();
    let (mut served, _) = Served::start(&place);
    let request = |index: usize| match index {
        2 => "nonsense".to_string(),
        _ => with(&camera(3.0 + index as f64), json!({ "name": format!("of-{index}") })),
    };
    let lines: Vec<String> = (0..5).map(request).collect();
    served.write(&lines.join("\n"));
    let answers = served.end();
    assert_eq!(answers.len(), 5);
    for (index, answer) in answers.iter().enumerate() {
        assert_eq!(answer["request"], index);
        match index {
            2 => assert!(answer["error"].is_string(), "{answer}"),
            _ => assert_eq!(answer["files"]["rgb.png"], format!("of-{index}_rgb.png")),
        }
    }
    assert_eq!(entries(&place.at("served")).len(), 4);
}

#[cfg(unix)]
#[test]
fn a_signal_ends_a_server_that_waits_or_renders() {
    for (signal, code) in [("-TERM", 143), ("-INT", 130)] {
        let place = shared();
        let (mut served, _) = Served::start(&place);
        served.ask(&camera(4.0).to_string());
        served.signal(signal);
        assert_eq!(served.ended().code(), Some(code), "while it waits");
        let said = std::io::read_to_string(served.child.stderr.take().unwrap()).unwrap();
        assert!(said.contains("render --serve ended by signal") && !said.contains("checkpoint"), "{said}");
    }
    // Of a large image, which is not answered. It has begun after some time, and the signal ends the server before, too.
    let place = Place::new();
    train(&place, "eval.chunk=64");
    let (mut served, _) = Served::start(&place);
    served.write(&format!("{}\n", with(&camera(4.0), json!({ "w": 4096, "h": 4096 }))));
    std::thread::sleep(Duration::from_millis(500));
    served.signal("-TERM");
    assert_eq!(served.ended().code(), Some(143));
    assert!(served.answers.recv().is_err() && entries(&place.at("served")).is_empty());
}

/// Nobody is left to be answered.
#[test]
fn a_server_whose_answers_nobody_reads_ends() {
    let place = shared();
    let mut child = place.command(SERVE).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let mut output = BufReader::new(child.stdout.take().unwrap());
    let mut ready = String::new();
    output.read_line(&mut ready).unwrap();
    drop(output);
    writeln!(child.stdin.as_mut().unwrap(), "{}", camera(4.0)).unwrap();
    let mut status = None;
    wait_for("the server's end", || {
        status = child.try_wait().unwrap();
        status.is_some()
    });
    assert_eq!(status.unwrap().code(), Some(0));
    assert!(place.at("served/000_rgb.png").is_file());
}

#[test]
fn cameras_that_look_away_have_no_normalized_device_coordinates() {
    let place = Place::new();
    train(&place, "data.kind=builtin-forward");
    let (mut served, _) = Served::start(&place);
    let away = json!({ "camera_to_world": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1] });
    let error = served.ask(&away.to_string());
    assert_says(error["error"].as_str().unwrap(), &["request 0", "looks away from the -z axis", "data.ndc=false"]);
    // Depth is that of the scene's files, not of the coordinates, which end at 1.
    let ahead =
        json!({ "camera_to_world": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1], "outputs": ["depth.npy"] });
    let answer = served.ask(&ahead.to_string());
    let file = place.at("served").join(answer["files"]["depth.npy"].as_str().unwrap());
    let Array { values, .. } = read_array(&file).unwrap();
    assert!(values.iter().any(|depth| *depth > 1.5), "{values:?}");
}

#[test]
fn flags_of_known_cameras_and_folders_with_files_are_refused() {
    let place = shared();
    place.says("render RUN --serve", 2, &["--out"]);
    let flags = "--what views|--cameras a.json|--frames 2|--resolution 8x8|--fps 2|--write-cameras a.json|--json";
    for flag in flags.split('|') {
        place.says(&format!("{SERVE} {flag}"), 2, &["--serve", flag.split(' ').next().unwrap()]);
    }
    place.says("render RUN --serve --out RUN", 4, &["already holds files"]);
}

/// The example of docs/rendering.md in Python, as it is there.
#[test]
fn the_example_of_the_page_runs() {
    let Ok(python) = Command::new("python3").arg("--version").output() else { return };
    assert!(python.status.success());
    let page = text(&Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/rendering.md"));
    let example = page.split("```python\n").nth(1).and_then(|rest| rest.split("```").next()).expect("an example");
    let place = shared();
    let programs = Path::new(env!("CARGO_BIN_EXE_augnerf")).parent().unwrap();
    let search = std::env::join_paths(
        [programs.to_path_buf()].into_iter().chain(std::env::split_paths(&std::env::var_os("PATH").unwrap())),
    );
    let output = Command::new("timeout")
        .args(["600", "python3", "-c", example])
        .current_dir(place.path())
        .env("PATH", search.unwrap())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(said.lines().count(), 4, "{said}");
    for index in 0..3 {
        assert_says(&said, &[&format!("{index:03}_rgb.png"), &format!("{index:03}_depth.npy")]);
        assert!(place.at(&format!("images/{index:03}_depth.npy")).is_file());
    }
}
