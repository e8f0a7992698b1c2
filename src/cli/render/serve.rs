//! `augnerf render --serve`: a line of JSON on standard input asks for an image, and a line on standard output answers.

use std::io::{self, BufRead, Read, Write};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::{Duration, Instant};

use serde_json::{Map, Value, json};

use crate::base::files::write_atomic;
use crate::base::{Error, Result};
use crate::cli::progress::printed;
use crate::cli::signals::catch_signals_of_server;
use crate::data::cameras::{CAMERA_KEYS, parse_camera};
use crate::data::{Camera, npy};
use crate::draw::{depth_range, write_png8};
use crate::methods::Renderer;
use crate::run::{RenderedView, Trained, Viewer};
use crate::view::{Layer, draw_layer};

use super::LOOKS_AWAY;

/// Version of the protocol. Another one may read requests or write answers differently; further keys do not count.
const PROTOCOL: u32 = 1;
/// The longest line of a request, with its end.
const MOST_LINE_BYTES: usize = 64 << 10;
/// The most pixels of an image.
const MOST_PIXELS: usize = 16 << 20;
/// The longest name of an image.
const MOST_NAME_BYTES: usize = 100;
/// How often a server without requests looks whether a signal ends it.
const PATIENCE: Duration = Duration::from_millis(100);
/// The keys of a request besides those of its camera.
const NAME: &str = "name";
const OUTPUTS: &str = "outputs";

/// A file of an image.
#[derive(Clone, Copy)]
enum Output {
    /// An 8-bit PNG.
    Png(Layer),
    /// Colours, float32 `[height, width, 3]`.
    Colours,
    /// Depth along the viewing axis in the units of the scene's files, float32 `[height, width]`.
    Depths,
    /// Accumulated weights, float32 `[height, width]`.
    Accumulations,
}

impl Output {
    /// All of them with the ends of their files' names. The first is the default.
    const ALL: [(&str, Output); 7] = [
        ("rgb.png", Output::Png(Layer::Colour)),
        ("depth.png", Output::Png(Layer::Depth)),
        ("accumulation.png", Output::Png(Layer::Accumulation)),
        ("normals.png", Output::Png(Layer::Normals)),
        ("rgb.npy", Output::Colours),
        ("depth.npy", Output::Depths),
        ("accumulation.npy", Output::Accumulations),
    ];
}

/// A request that can be answered.
struct Request {
    camera: Camera,
    name: String,
    outputs: Vec<(&'static str, Output)>,
}

/// Answers requests for images of a run until the input ends. Their files are in `folder`. All is in memory, so that the
/// run is free for others meanwhile.
///
/// # Errors
/// [`Error::Interrupted`]: a signal ended it. [`Error::Output`]: no folder can be created, or standard output takes no line.
pub fn serve(trained: Trained, folder: &Path) -> Result<()> {
    let stop = catch_signals_of_server()?;
    std::fs::create_dir_all(folder).map_err(|error| Error::unwritable(folder, &error))?;
    let Trained { run, config, scene, state, model, runtime, .. } = trained;
    let name = run.path().display().to_string();
    drop(run);
    let viewer = Viewer { model: &model, config: &config, scene: &scene, runtime: &runtime };
    let server = Server { run: name, step: state.step, viewer, renderer: viewer.renderer()?, folder, stop: &stop };
    let lines = lines_of_input();
    let mut answer = server.ready();
    for index in 0.. {
        if !is_told(&answer)? {
            break;
        }
        let Some(line) = server.next(&lines)? else { break };
        answer = server.answer(index, line)?;
    }
    Ok(())
}

/// What a request is answered with.
struct Server<'a> {
    run: String,
    step: u64,
    viewer: Viewer<'a>,
    renderer: Box<dyn Renderer>,
    folder: &'a Path,
    /// The signal that ends it, or 0.
    stop: &'a AtomicUsize,
}

impl Server<'_> {
    /// Returns the first line, which says what is served.
    fn ready(&self) -> Value {
        let Camera { width, height, .. } = self.like();
        json!({
            "ready": true,
            "protocol": PROTOCOL,
            "run": self.run,
            "step": self.step,
            "width": width,
            "height": height,
            "folder": self.folder.display().to_string(),
            "outputs": Output::ALL.map(|(name, _)| name),
        })
    }

    /// Returns the camera whose lens and size a request has unless it states others, as `--cameras` does.
    fn like(&self) -> Camera {
        let scene = self.viewer.scene;
        scene.test.first().or(scene.train.first()).expect("a scene has views").camera
    }

    /// # Errors
    /// [`Error::Interrupted`]: there was a signal.
    fn check_signal(&self) -> Result<()> {
        match self.stop.load(Ordering::SeqCst) {
            0 => Ok(()),
            signal => Err(Error::Interrupted {
                signal: signal as i32,
                message: format!("render --serve ended by signal {signal}"),
            }),
        }
    }

    /// Waits for the next line. Returns `None` at the end of the input.
    fn next(&self, lines: &Receiver<io::Result<Line>>) -> Result<Option<Line>> {
        loop {
            self.check_signal()?;
            match lines.recv_timeout(PATIENCE) {
                Ok(line) => {
                    return line.map(Some).map_err(|error| Error::Data(format!("cannot read standard input: {error}")));
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Ok(None),
            }
        }
    }

    /// Returns the answer to a request: its files, or what is wrong with it.
    fn answer(&self, index: usize, line: Line) -> Result<Value> {
        let started = Instant::now();
        match self.request(index, line).and_then(|request| self.render(&request)) {
            Ok(files) => {
                let milliseconds = started.elapsed().as_millis() as u64;
                Ok(json!({ "request": index, "files": files, "milliseconds": milliseconds }))
            }
            Err(error @ Error::Interrupted { .. }) => Err(error),
            Err(error) => Ok(json!({ "request": index, "error": error.to_string() })),
        }
    }

    /// Reads a request, the one with this index from 0.
    fn request(&self, index: usize, line: Line) -> Result<Request> {
        let place = format!("request {index}");
        let failed = |what: String| Error::Data(format!("{place}: {what}"));
        let Line::Text(text) = line else {
            return Err(failed(format!("the line is longer than {MOST_LINE_BYTES} bytes, which no request needs")));
        };
        let scene = self.viewer.scene;
        let (camera, others) = parse_camera(&place, &text, &self.like(), &scene.space.world)?;
        let (width, height) = (camera.width, camera.height);
        if width * height > MOST_PIXELS {
            return Err(failed(format!("{width} x {height} pixels, but at most {MOST_PIXELS} are rendered at once")));
        }
        if scene.ndc.is_some() && !camera.faces_forward() {
            return Err(failed(format!("the camera {LOOKS_AWAY}")));
        }
        check_keys(&others).map_err(failed)?;
        let name = others.get(NAME).map_or_else(|| Ok(format!("{index:03}")), name).map_err(failed)?;
        let outputs = others.get(OUTPUTS).map_or_else(|| Ok(vec![Output::ALL[0]]), outputs).map_err(failed)?;
        Ok(Request { camera, name, outputs })
    }

    /// Renders an image and writes its files. Returns their names by output.
    fn render(&self, request: &Request) -> Result<Map<String, Value>> {
        let mut stop_check = || self.check_signal();
        let view = self.viewer.render_unless(&*self.renderer, &request.camera, usize::MAX, &mut stop_check)?;
        let write = |&(end, output): &(&str, Output)| {
            let file = format!("{}_{end}", request.name);
            self.write(output, &self.folder.join(&file), &view, &request.camera)?;
            Ok((end.to_string(), file.into()))
        };
        request.outputs.iter().map(write).collect()
    }

    fn write(&self, output: Output, path: &Path, view: &RenderedView, camera: &Camera) -> Result<()> {
        let size = [camera.height, camera.width];
        match output {
            Output::Png(layer) => {
                let scene = self.viewer.scene;
                // As `--cameras` has it for a single camera.
                let range = depth_range(&view.depth, Some(&view.acc));
                let range = range.unwrap_or((scene.near as f32, scene.far as f32));
                let scene = (scene, self.viewer.config.data.origin_of_pixels());
                write_png8(path, &*draw_layer(layer, view, camera, scene, range)?)
            }
            Output::Colours => write_npy(path, &[size[0], size[1], 3], &view.image.pixels),
            Output::Depths => {
                let scale = self.viewer.scene.space.world.scale;
                let depths = self.viewer.scene_depth(camera, view);
                let depths: Vec<f32> = depths.into_iter().map(|depth| (f64::from(depth) / scale) as f32).collect();
                write_npy(path, &size, &depths)
            }
            Output::Accumulations => write_npy(path, &size, &view.acc),
        }
    }
}

fn write_npy(path: &Path, shape: &[usize], values: &[f32]) -> Result<()> {
    let mut bytes = npy::header("<f4", shape);
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    write_atomic(path, &bytes)
}

/// Returns an error for a key that no request has.
fn check_keys(besides_camera: &Map<String, Value>) -> std::result::Result<(), String> {
    match besides_camera.keys().find(|key| ![NAME, OUTPUTS].contains(&key.as_str())) {
        None => Ok(()),
        Some(unknown) => {
            Err(format!("unknown key \"{unknown}\"; a request has {}, {NAME} and {OUTPUTS}", CAMERA_KEYS.join(", ")))
        }
    }
}

/// Reads the name of an image. It must not lead out of the folder, or hide in it.
fn name(value: &Value) -> std::result::Result<String, String> {
    let is_sound = |name: &&str| {
        (1..=MOST_NAME_BYTES).contains(&name.len())
            && name.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c))
            && !name.starts_with('.')
    };
    value.as_str().filter(is_sound).map(String::from).ok_or_else(|| {
        format!(
            "\"{NAME}\" must be 1 to {MOST_NAME_BYTES} letters, digits, hyphens, underscores and dots, and must not begin \
             with a dot"
        )
    })
}

fn outputs(value: &Value) -> std::result::Result<Vec<(&'static str, Output)>, String> {
    let known = |value: &Value| Output::ALL.into_iter().find(|(name, _)| value.as_str() == Some(name));
    let found: Option<Vec<_>> = value.as_array().and_then(|list| list.iter().map(known).collect());
    found.filter(|found| !found.is_empty()).ok_or_else(|| {
        let names = Output::ALL.map(|(name, _)| name).join(", ");
        format!("\"{OUTPUTS}\" must be a list of one or more of {names}")
    })
}

/// A line of the input.
enum Line {
    Text(Vec<u8>),
    /// It has more than [`MOST_LINE_BYTES`], and was not kept.
    TooLong,
}

/// Reads lines in another thread, because a signal does not end the wait for a line.
fn lines_of_input() -> Receiver<io::Result<Line>> {
    let (sender, receiver) = sync_channel(0);
    std::thread::spawn(move || {
        let mut input = io::stdin().lock();
        let lines = std::iter::from_fn(|| read_line(&mut input).transpose());
        for line in lines {
            let is_last = line.is_err();
            if sender.send(line).is_err() || is_last {
                break;
            }
        }
    });
    receiver
}

fn read_line(input: &mut impl BufRead) -> io::Result<Option<Line>> {
    let mut text = Vec::new();
    input.take(MOST_LINE_BYTES as u64).read_until(b'\n', &mut text)?;
    if text.len() < MOST_LINE_BYTES || text.ends_with(b"\n") {
        return Ok((!text.is_empty()).then_some(Line::Text(text)));
    }
    input.skip_until(b'\n')?;
    Ok(Some(Line::TooLong))
}

/// Writes an answer. Returns whether there is still a reader.
fn is_told(answer: &Value) -> Result<bool> {
    let mut out = io::stdout();
    let written = writeln!(out, "{answer}").and_then(|()| out.flush());
    let is_gone = written.as_ref().is_err_and(|error| error.kind() == io::ErrorKind::BrokenPipe);
    printed(written).map(|()| !is_gone)
}
