//! The server: addresses and their answers, tokens, and whose turn it is.

use std::collections::HashMap;
use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use candle_core::{DType, Tensor};
use serde_json::{Value, json};

use crate::base::{Error, Image, Result};
use crate::data::cameras::camera_path;
use crate::data::{Camera, RayBuffer, View, path, pose};
use crate::draw::{encode_jpeg, encode_png8};
use crate::run::{RenderedView, Viewer};

use super::http::{Connection, Request};
use super::perturbed::Attack;
use super::picture::{Layer, draw_layer};
use super::request::{Arguments, check_pose};
use super::samples::RaySamples;
use super::shown::{ShownRun, Weights};

/// The most connections at once. A page has at most six. Pictures are made for one at a time.
const MOST_CONNECTIONS: usize = 64;
/// How often the server looks for a connection and for its end.
const PAUSE: Duration = Duration::from_millis(10);
/// Pause after a connection that cannot be accepted, as without descriptors, and for how long such failures may follow each
/// other. Silent connections end sooner, so that descriptors become free.
const PAUSE_AFTER_ERROR: Duration = Duration::from_millis(200);
const HOPELESS: Duration = Duration::from_secs(20);
/// A page asks for the state every two seconds. After this time without it is closed.
const WATCHED: Duration = Duration::from_secs(7);
/// How long the server waits for its last answers.
const FAREWELL: Duration = Duration::from_secs(2);
/// The most pages whose turns are remembered.
const MOST_PAGES: usize = 1000;
/// The most bytes of a body that is read without being asked for, so that its sender gets an answer.
const MOST_STRAY_BYTES: u64 = 64 << 10;
/// The most bytes and cameras of a path.
const MOST_PATH_BYTES: u64 = 4 << 20;
const MOST_CAMERAS: usize = 10_000;
/// Rays that are searched at once. A search remembers every operation on them.
const SEARCHED_RAYS: usize = 128;
/// Quality of pictures while the camera moves.
const MOVING_QUALITY: u8 = 82;
/// What a page may load: its own script, style and pictures.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// The page's files: name, type and content.
const FILES: [(&str, &str, &str); 4] = [
    ("", "text/html; charset=utf-8", include_str!("../page/index.html")),
    ("viewer.js", "text/javascript; charset=utf-8", include_str!("../page/viewer.js")),
    ("icon.svg", "image/svg+xml", include_str!("../page/icon.svg")),
    ("viewer.css", "text/css; charset=utf-8", include_str!("../page/viewer.css")),
];

/// Where a server listens.
#[derive(Clone, Debug)]
pub struct ServerOptions {
    /// The address of the interface. 127.0.0.1 is reached from this computer alone.
    pub host: IpAddr,
    /// The port; 0 takes a free one.
    pub port: u16,
}

/// The server of one page with one or two runs.
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    token: String,
    runs: Vec<Arc<ShownRun>>,
    /// The newest picture that each page's slot has asked for.
    turns: Mutex<HashMap<String, u64>>,
    /// When a page last asked for anything.
    asked: Mutex<Option<Instant>>,
    /// The server stops; pictures that are being made are given up.
    stopping: AtomicBool,
    /// Held while a picture is made: two at once would each take twice as long.
    rendering: Mutex<()>,
    /// A clone is held for each connection.
    connections: Arc<()>,
    /// A clone is held for each request that is being answered.
    answering: Arc<()>,
}

/// An answer.
struct Reply {
    status: u16,
    kind: &'static str,
    body: Vec<u8>,
    /// Headers of its own.
    headers: Vec<(&'static str, String)>,
}

impl Reply {
    fn new(kind: &'static str, body: Vec<u8>) -> Reply {
        Reply { status: 200, kind, body, headers: Vec::new() }
    }

    fn json(value: &Value) -> Reply {
        Reply::new("application/json", value.to_string().into_bytes())
    }

    /// A refusal in words.
    fn refused(status: u16, words: &str) -> Reply {
        Reply { status, ..Reply::new("text/plain; charset=utf-8", words.as_bytes().to_vec()) }
    }
}

/// Why there is no picture.
enum Failure {
    /// A wrong address.
    Asked(String),
    /// The page has asked for a newer one.
    Superseded,
    /// The picture cannot be made.
    Made(Error),
}

impl From<String> for Failure {
    fn from(words: String) -> Failure {
        Failure::Asked(words)
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Failure {
        match error {
            Error::Interrupted { .. } => Failure::Superseded,
            error => Failure::Made(error),
        }
    }
}

impl From<candle_core::Error> for Failure {
    fn from(error: candle_core::Error) -> Failure {
        Failure::Made(error.into())
    }
}

type Answer = std::result::Result<Reply, Failure>;

impl Server {
    /// Listens for pages that show `runs`, which must be of one scene.
    ///
    /// # Errors
    /// [`Error::Config`]: the runs' scenes differ. [`Error::Output`]: the port is taken or the address is not of this computer.
    pub fn bind(runs: Vec<Arc<ShownRun>>, options: &ServerOptions) -> Result<Server> {
        if let Some(other) = runs.iter().skip(1).find(|run| !are_of_one_scene(&runs[0], run)) {
            return Err(Error::Config(format!(
                "{} and {} have different scenes or units, so no camera can show both: view runs of one scene",
                runs[0].label, other.label
            )));
        }
        let wanted = SocketAddr::new(options.host, options.port);
        let failed = |why: String| {
            Error::Output(format!("{wanted}: cannot listen there: {why}; choose another --host or --port"))
        };
        let listen = || -> io::Result<(TcpListener, SocketAddr)> {
            let listener = TcpListener::bind(wanted)?;
            listener.set_nonblocking(true)?;
            let address = listener.local_addr()?;
            Ok((listener, address))
        };
        let (listener, address) = listen().map_err(|e| failed(e.to_string()))?;
        let mut secret = [0u8; 16];
        getrandom::fill(&mut secret).map_err(|e| failed(format!("no random numbers for its token ({e})")))?;
        let token = secret.iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(Server {
            listener,
            address,
            token,
            runs,
            turns: Mutex::default(),
            asked: Mutex::default(),
            stopping: AtomicBool::new(false),
            rendering: Mutex::default(),
            connections: Arc::default(),
            answering: Arc::default(),
        })
    }

    /// Returns the address to open.
    pub fn url(&self) -> String {
        format!("http://{}/{}/", self.address, self.token)
    }

    /// Returns whether other computers can reach it.
    pub fn is_public(&self) -> bool {
        !self.address.ip().is_loopback()
    }

    /// Returns the host of its address if that is no computer's, but stands for every interface of this one: `0.0.0.0` or
    /// `[::]`.
    pub fn every_interface(&self) -> Option<&'static str> {
        let ip = self.address.ip();
        ip.is_unspecified().then_some(if ip.is_ipv4() { "0.0.0.0" } else { "[::]" })
    }

    /// Returns whether a page is open.
    pub fn is_watched(&self) -> bool {
        self.asked.lock().unwrap_or_else(PoisonError::into_inner).is_some_and(|asked| asked.elapsed() < WATCHED)
    }

    /// Answers until `stop` is not 0. What is being answered then gets a short time to end. A thread whose other side neither
    /// reads nor writes is left behind, so that it holds nobody up.
    ///
    /// # Errors
    /// [`Error::Output`]: no connection can be accepted any more.
    pub fn serve(self: &Arc<Self>, stop: &AtomicUsize) -> Result<()> {
        let ended = self.accept(stop);
        self.stopping.store(true, Ordering::SeqCst);
        let until = Instant::now() + FAREWELL;
        while Instant::now() < until && Arc::strong_count(&self.answering) > 1 {
            std::thread::sleep(PAUSE);
        }
        ended
    }

    fn accept(self: &Arc<Self>, stop: &AtomicUsize) -> Result<()> {
        let mut failing = None;
        while stop.load(Ordering::SeqCst) == 0 {
            match self.listener.accept() {
                Ok((stream, _)) => {
                    failing = None;
                    self.begin(stream);
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    failing = None;
                    std::thread::sleep(PAUSE);
                }
                Err(error) if failing.get_or_insert_with(Instant::now).elapsed() > HOPELESS => {
                    let address = self.address;
                    return Err(Error::Output(format!(
                        "{address}: no connection to the page can be accepted any more: {error}"
                    )));
                }
                Err(_) => std::thread::sleep(PAUSE_AFTER_ERROR),
            }
        }
        Ok(())
    }

    /// Answers a connection on a thread of its own, so that a defect there ends nothing else. A connection too many is closed.
    fn begin(self: &Arc<Self>, stream: TcpStream) {
        let (server, connection) = (self.clone(), self.connections.clone());
        // One is the server's own.
        if Arc::strong_count(&connection) > MOST_CONNECTIONS + 1 {
            return;
        }
        let work = move || {
            let _connection = connection;
            // Its other side has gone, is silent or sends no requests: there is nobody to tell.
            let _ = server.converse(stream);
        };
        // Without a thread it is closed.
        let _ = std::thread::Builder::new().name("page".into()).spawn(work);
    }

    fn converse(&self, stream: TcpStream) -> io::Result<()> {
        let mut connection = Connection::new(stream)?;
        while let Some(request) = connection.request()? {
            let _answering = self.answering.clone();
            if self.stopping.load(Ordering::SeqCst) || !self.answer(&mut connection, &request)? {
                break;
            }
        }
        Ok(())
    }

    /// Answers a request. Returns whether its connection stays open.
    fn answer(&self, connection: &mut Connection, request: &Request) -> io::Result<bool> {
        let refusal = self.check(request);
        let is_known = refusal.is_none();
        let most = if is_known && request.method == "POST" { MOST_PATH_BYTES } else { MOST_STRAY_BYTES };
        let is_short = request.body_length() <= most;
        let reply = if is_short {
            let body = connection.body(request.body_length())?;
            refusal.unwrap_or_else(|| self.route(request, &body))
        } else {
            Reply::refused(413, "The request is too long, or does not say how long it is.")
        };
        let stays_open = is_known && is_short && request.stays_open();
        let fixed = [
            ("Content-Type", reply.kind),
            ("Cache-Control", "no-store"),
            ("X-Content-Type-Options", "nosniff"),
            // The token is in the address.
            ("Referrer-Policy", "no-referrer"),
            ("Content-Security-Policy", POLICY),
        ];
        let own = reply.headers.iter().map(|(name, value)| (*name, value.as_str()));
        let body: &[u8] = if request.method == "HEAD" { &[] } else { &reply.body };
        connection.answer(reply.status, fixed.into_iter().chain(own), body, stays_open)?;
        Ok(stays_open)
    }

    /// Refuses what comes from another page, or without the token.
    fn check(&self, request: &Request) -> Option<Reply> {
        if let Some(origin) = request.header("Origin") {
            let host = request.header("Host").unwrap_or_default();
            if origin.strip_prefix("http://") != Some(host) {
                return Some(Reply::refused(
                    403,
                    "Another page has asked for this. Open the address that augnerf printed.",
                ));
            }
        }
        let given = request.url.split('/').nth(1).unwrap_or_default();
        let differences = given.bytes().zip(self.token.bytes()).fold(0, |found, (a, b)| found | (a ^ b));
        if given.len() != self.token.len() || differences != 0 {
            let words = "The address lacks its token. Open the whole address that augnerf printed.";
            return Some(Reply::refused(403, words));
        }
        None
    }

    fn route(&self, request: &Request, body: &[u8]) -> Reply {
        *self.asked.lock().unwrap_or_else(PoisonError::into_inner) = Some(Instant::now());
        let (path, query) = request.url.split_once('?').unwrap_or((&request.url, ""));
        let name = path.splitn(3, '/').nth(2);
        let arguments = Arguments::of(query);
        let answer = match (request.method.as_str(), name) {
            // The page's addresses are relative: they need the slash.
            ("GET", None) => {
                let headers = vec![("Location", format!("/{}/", self.token))];
                Ok(Reply { headers, ..Reply::refused(301, "") })
            }
            ("GET", Some("scene")) => Ok(Reply::json(&self.scene())),
            ("GET", Some("state")) => Ok(Reply::json(&self.state())),
            ("GET", Some("picture")) => self.picture(&arguments),
            ("GET", Some("photograph")) => self.photograph(&arguments),
            ("GET", Some("ray")) => self.ray(&arguments),
            ("POST", Some("path")) => self.path(&arguments, body),
            ("GET", Some(name)) => match FILES.iter().find(|(file, ..)| *file == name) {
                Some((_, kind, content)) => Ok(Reply::new(kind, content.as_bytes().to_vec())),
                None => Ok(Reply::refused(404, "There is nothing at this address.")),
            },
            _ => Ok(Reply::refused(405, "This address is not asked for in this way.")),
        };
        answer.unwrap_or_else(|failure| match failure {
            Failure::Asked(words) => Reply::refused(400, &words),
            Failure::Superseded => Reply::refused(409, "The page has asked for a newer picture."),
            Failure::Made(error) => Reply::refused(500, &error.to_string()),
        })
    }

    /// Describes the scene: its cameras, and what to turn around.
    fn scene(&self) -> Value {
        let run = &self.runs[0];
        let views = |split: &str, views: &[View]| -> Vec<Value> {
            let view = |(index, view): (usize, &View)| {
                let Camera { width, height, focal, pose, .. } = view.camera;
                let fov = 2.0 * (0.5 * height as f64 / focal[1]).atan().to_degrees();
                let pose: Vec<f64> = pose.into_iter().flatten().collect();
                json!({ "id": format!("{split}:{index}"), "name": view.name, "split": split, "pose": pose, "fov": fov, "width": width, "height": height })
            };
            views.iter().enumerate().map(view).collect()
        };
        let scene = &run.scene;
        let poses: Vec<pose::Pose> = scene.train.iter().map(|view| view.camera.pose).collect();
        let up = pose::normalized(pose::mean(poses.iter().map(|pose| pose::column(pose, 1))));
        let centre = path::centre(&poses).filter(|_| path::goes_around(&poses));
        let views = [views("held-out", &scene.test), views("train", &scene.train)].concat();
        let layers: Vec<&str> = Layer::ALL.into_iter().map(Layer::name).collect();
        json!({
            "name": scene.name,
            "views": views,
            "up": up.unwrap_or([0.0, 0.0, 1.0]),
            "centre": centre,
            "ndc": scene.ndc.is_some(),
            "layers": layers,
        })
    }

    /// Describes what changes: steps, and what the weights can show.
    fn state(&self) -> Value {
        let run = |run: &Arc<ShownRun>| {
            let weights = run.weights();
            let weights = weights.as_deref();
            let sites = weights.and_then(|weights| weights.perturbed.as_ref()).map(|perturbed| perturbed.sites());
            json!({
                "label": run.label,
                "method": run.config.method.name(),
                "step": weights.map(|weights| weights.step),
                "steps": run.steps,
                "sites": sites.unwrap_or_default(),
                "attacked": run.config.method.is_augmented(),
                "occupied": weights.and_then(|weights| weights.occupied),
                "depths": weights.map(|weights| [weights.depths.0, weights.depths.1]),
                "distance": weights.map(|weights| distance(run, weights)),
            })
        };
        json!({ "runs": self.runs.iter().map(run).collect::<Vec<Value>>() })
    }

    fn run(&self, arguments: &Arguments) -> std::result::Result<(&ShownRun, Arc<Weights>), Failure> {
        let index: usize = arguments.number("run")?;
        let run = self
            .runs
            .get(index)
            .ok_or_else(|| format!("run={index}: the page has {} runs, from 0", self.runs.len()))?;
        let weights = run.weights().ok_or_else(|| "the training has not made a step yet".to_string())?;
        Ok((run, weights))
    }

    /// Returns the camera. Views are named as the first run has them: another run may have other views.
    fn camera(&self, arguments: &Arguments, run: &ShownRun) -> std::result::Result<Camera, Failure> {
        Ok(arguments.camera(&self.runs[0].scene, run.scene.ndc.is_some())?)
    }

    /// Waits until a picture may be made. Pages that have asked for a newer one in the meantime give up.
    fn wait(&self, arguments: &Arguments) -> std::result::Result<(MutexGuard<'_, ()>, String, u64), Failure> {
        let (page, turn) = arguments.turn()?;
        {
            let mut turns = self.turns.lock().unwrap_or_else(PoisonError::into_inner);
            if turns.len() >= MOST_PAGES && !turns.contains_key(&page) {
                turns.clear();
            }
            let newest = turns.entry(page.clone()).or_default();
            *newest = turn.max(*newest);
        }
        let guard = self.rendering.lock().unwrap_or_else(PoisonError::into_inner);
        self.check_turn(&page, turn)?;
        Ok((guard, page, turn))
    }

    /// # Errors
    /// [`Error::Interrupted`]: the page has asked for a newer picture.
    fn check_turn(&self, page: &str, turn: u64) -> Result<()> {
        let turns = self.turns.lock().unwrap_or_else(PoisonError::into_inner);
        let stopping = self.stopping.load(Ordering::SeqCst);
        match stopping || turns.get(page).is_some_and(|newest| *newest > turn) {
            true => Err(Error::Interrupted { signal: 0, message: "superseded".into() }),
            false => Ok(()),
        }
    }

    fn picture(&self, arguments: &Arguments) -> Answer {
        let (run, weights) = self.run(arguments)?;
        let (camera, layer) = (self.camera(arguments, run)?, arguments.layer()?);
        let attack = arguments.attack(&sites_of(&weights))?;
        let (guard, page, turn) = self.wait(arguments)?;
        let started = Instant::now();
        let stop_check = || self.check_turn(&page, turn);
        let view = match attack {
            Some(attack) => {
                perturbed_view(run, &weights, &camera, arguments.view(&self.runs[0].scene)?, &attack, &stop_check)?
            }
            None => {
                let viewer =
                    Viewer { model: &weights.model, config: &run.config, scene: &run.scene, runtime: &run.runtime };
                viewer.render_unless(&*weights.renderer, &camera, &stop_check)?
            }
        };
        let milliseconds = started.elapsed().as_millis();
        drop(guard);
        let depths = self.runs[0].weights().map_or(weights.depths, |first| first.depths);
        let image = draw_layer(layer, &view, &camera, &run.scene, depths)?;
        let mut reply = match arguments.get("moving") {
            Some(_) => Reply::new("image/jpeg", encode_jpeg(&image, MOVING_QUALITY)?),
            None => png(&image)?,
        };
        reply.headers = vec![("X-Milliseconds", milliseconds.to_string()), ("X-Step", weights.step.to_string())];
        Ok(reply)
    }

    fn photograph(&self, arguments: &Arguments) -> Answer {
        let run = self.runs.first().expect("a page has a run");
        let view = arguments.view(&run.scene)?.ok_or_else(|| "view is missing".to_string())?;
        png(&view.image)
    }

    fn ray(&self, arguments: &Arguments) -> Answer {
        let (run, weights) = self.run(arguments)?;
        let camera = self.camera(arguments, run)?;
        let (x, y): (u32, u32) = (arguments.number("x")?, arguments.number("y")?);
        if x as usize >= camera.width || y as usize >= camera.height {
            return Err(
                format!("x={x}, y={y}: outside the picture of {} x {} pixels", camera.width, camera.height).into()
            );
        }
        let perturbed = weights
            .perturbed
            .as_ref()
            .ok_or_else(|| "only fields on the processor have samples to show".to_string())?;
        let view = arguments.view(&self.runs[0].scene)?;
        let attack = arguments.attack(&perturbed.sites())?;
        let (guard, ..) = self.wait(arguments)?;
        let of = |attack: &Attack| -> Result<RaySamples> {
            let rays = RayBuffer::new(
                &[(&camera, x, y)],
                run.scene.ndc.as_ref(),
                run.config.data.origin_of_pixels(),
                perturbed.ray_parts(),
            )
            .to_tensors(DType::F32, run.runtime.device())?;
            let target = view.map(|view| photographed(view, &camera, &[(x, y)])).transpose()?;
            let norm = f64::from(rays.direction_norm.flatten_all()?.to_vec1::<f32>()?[0]);
            RaySamples::of(&perturbed.pass(&rays, target.as_ref(), attack, 0)?, norm)
        };
        let clean = Attack { sites: Vec::new(), scale: 0.0 };
        let (clean, attacked) =
            run.runtime.install(|| -> Result<_> { Ok((of(&clean)?, attack.as_ref().map(of).transpose()?)) })?;
        drop(guard);
        Ok(Reply::json(&json!({ "clean": clean, "attacked": attacked })))
    }

    /// Returns the recorded cameras as the file that `augnerf render --cameras` reads.
    fn path(&self, arguments: &Arguments, body: &[u8]) -> Answer {
        let poses: Vec<[[f64; 4]; 3]> =
            serde_json::from_slice(body).map_err(|_| "a path is a list of 3 x 4 numbers".to_string())?;
        if poses.is_empty() || poses.len() > MOST_CAMERAS {
            return Err(format!("{} cameras: a path has 1 to {MOST_CAMERAS}", poses.len()).into());
        }
        let scene = &self.runs[0].scene;
        let like = arguments.camera(scene, scene.ndc.is_some())?;
        for (index, pose) in poses.iter().enumerate() {
            check_pose(pose).map_err(|words| format!("camera {index} (from 0): {words}"))?;
        }
        let cameras: Vec<Camera> = poses.into_iter().map(|pose| Camera { pose, ..like }).collect();
        let fps: f64 = arguments.number("fps")?;
        if !(0.1..=240.0).contains(&fps) {
            return Err(format!("fps={fps}: must be 0.1 to 240").into());
        }
        Ok(Reply::json(&camera_path(&cameras, &scene.space.world, fps)))
    }
}

/// Returns whether one camera can show both runs: whether they have the same scene in the same units.
fn are_of_one_scene(a: &ShownRun, b: &ShownRun) -> bool {
    let poses = |run: &ShownRun| {
        run.scene
            .train
            .iter()
            .chain(&run.scene.test)
            .map(|view| (view.name.clone(), view.camera.pose))
            .collect::<HashMap<_, _>>()
    };
    let (of_a, of_b) = (poses(a), poses(b));
    let mut common = of_a.iter().filter_map(|(name, pose)| Some((pose, of_b.get(name)?))).peekable();
    a.scene.name == b.scene.name && common.peek().is_some() && common.all(|(a, b)| a == b)
}

fn sites_of(weights: &Weights) -> Vec<&'static str> {
    weights.perturbed.as_ref().map(|perturbed| perturbed.sites()).unwrap_or_default()
}

/// Returns how far in front of the first camera the middle of the depths is, in scene units.
fn distance(run: &ShownRun, weights: &Weights) -> f64 {
    let (near, far) = weights.depths;
    let middle = f64::from(0.5 * (near + far));
    if run.scene.ndc.is_none() {
        return middle;
    }
    let camera = run.first_camera();
    let (origin, direction) = camera.ray(camera.centre[0], camera.centre[1]);
    crate::data::Ndc::world_t(origin, direction, middle.min(0.95))
}

fn png(image: &Image) -> Answer {
    let made = encode_png8(image).map_err(|reason| Error::Output(format!("cannot encode a picture: {reason}")))?;
    Ok(Reply::new("image/png", made))
}

/// Returns what a photograph shows at pixels of a picture of its camera in another size, `[pixels, 3]`.
fn photographed(view: &View, camera: &Camera, pixels: &[(u32, u32)]) -> Result<Tensor> {
    let Image { width, height, channels, pixels: values } = &*view.image;
    // `with_size` keeps the vertical field of view, around the middle of the columns.
    let scale = *height as f64 / camera.height as f64;
    let left = 0.5 * (*width as f64 - scale * camera.width as f64);
    let colours: Vec<f32> = pixels
        .iter()
        .flat_map(|&(x, y)| {
            let at = |value: f64, size: usize| (value.max(0.0) as usize).min(size - 1);
            let (x, y) = (at(left + scale * (f64::from(x) + 0.5), *width), at(scale * (f64::from(y) + 0.5), *height));
            let first = channels * (y * width + x);
            [values[first], values[first + 1], values[first + 2]]
        })
        .collect();
    Ok(Tensor::from_vec(colours, (pixels.len(), 3), &candle_core::Device::Cpu)?)
}

/// Renders a view with the deltas of an attack.
fn perturbed_view(
    run: &ShownRun,
    weights: &Weights,
    camera: &Camera,
    view: Option<&View>,
    attack: &Attack,
    stop_check: &(dyn Fn() -> Result<()> + Sync),
) -> Result<RenderedView> {
    let perturbed = weights.perturbed.as_ref().expect("it has sites");
    let (width, height) = (camera.width, camera.height);
    let pixels: Vec<(u32, u32)> = (0..height as u32).flat_map(|y| (0..width as u32).map(move |x| (x, y))).collect();
    let parts: Vec<(u64, &[(u32, u32)])> = (0..).zip(pixels.chunks(SEARCHED_RAYS)).collect();
    let render = |parts: &[(u64, &[(u32, u32)])]| -> Result<[Vec<f32>; 3]> {
        stop_check()?;
        let (part, pixels) = parts[0];
        let of_camera: Vec<(&Camera, u32, u32)> = pixels.iter().map(|&(x, y)| (camera, x, y)).collect();
        let rays = RayBuffer::new(
            &of_camera,
            run.scene.ndc.as_ref(),
            run.config.data.origin_of_pixels(),
            perturbed.ray_parts(),
        )
        .to_tensors(DType::F32, run.runtime.device())?;
        let target = view.map(|view| photographed(view, camera, pixels)).transpose()?;
        let out = perturbed.render(&rays, target.as_ref(), attack, part)?;
        let host = |tensor: &Tensor| tensor.flatten_all()?.to_vec1::<f32>();
        Ok([host(&out.rgb)?, host(&(out.depth / &out.acc)?)?, host(&out.acc)?])
    };
    let mut rendered: [Vec<f32>; 3] = Default::default();
    for part in run.runtime.install(|| run.runtime.over_parts(&parts, 1, render))? {
        rendered.iter_mut().zip(part).for_each(|(whole, part)| whole.extend(part));
    }
    let [pixels, depth, acc] = rendered;
    Ok(RenderedView { image: Image { width, height, channels: 3, pixels }, depth, acc })
}
