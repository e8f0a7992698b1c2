//! What each address of the page answers.

use std::sync::Arc;

use serde_json::{Value, json};

use crate::base::Error;
use crate::data::cameras::camera_path;
use crate::data::{Camera, View, path, pose};
use crate::draw::scale_colour;

use super::http::{Reply, Request};
use super::picture::Layer;
use super::pictures::Pictures;
use super::request::{Arguments, check_pose};
use super::shown::{ShownRun, Weights};

/// The most cameras of a path.
const MOST_CAMERAS: usize = 10_000;
/// Colours of the page's scale of depth, from near to far.
const SCALE_COLOURS: usize = 9;

/// The page's files: name, type and content.
const FILES: [(&str, &str, &str); 4] = [
    ("", "text/html; charset=utf-8", include_str!("../page/index.html")),
    ("viewer.js", "text/javascript; charset=utf-8", include_str!("../page/viewer.js")),
    ("icon.svg", "image/svg+xml", include_str!("../page/icon.svg")),
    ("viewer.css", "text/css; charset=utf-8", include_str!("../page/viewer.css")),
];

/// What is answered: also an error is, in words.
pub type Answer = std::result::Result<Reply, Reply>;

impl From<String> for Reply {
    /// Answers a wrong address.
    fn from(words: String) -> Reply {
        Reply::refused(400, &words)
    }
}

impl From<Error> for Reply {
    fn from(error: Error) -> Reply {
        match error {
            Error::Interrupted { .. } => Reply::refused(409, "The page has asked for a newer picture."),
            error => Reply::refused(500, &error.to_string()),
        }
    }
}

impl From<candle_core::Error> for Reply {
    fn from(error: candle_core::Error) -> Reply {
        Error::from(error).into()
    }
}

/// The addresses of one page with one or two runs.
pub struct Router {
    pub runs: Vec<Arc<ShownRun>>,
    pub pictures: Pictures,
}

impl Router {
    /// Answers a request that may be answered. `has_gone` tells whether its sender has.
    pub fn route(&self, request: &Request, body: &[u8], has_gone: &dyn Fn() -> bool) -> Reply {
        let (path, query) = request.url.split_once('?').unwrap_or((&request.url, ""));
        let mut parts = path.splitn(3, '/').skip(1);
        let (token, name) = (parts.next().unwrap_or_default(), parts.next());
        let arguments = Arguments::of(query);
        let answer = match (request.method.as_str(), name) {
            // The page's addresses are relative: they need the slash.
            ("GET", None) => Ok(Reply { headers: vec![("Location", format!("{token}/"))], ..Reply::refused(301, "") }),
            ("GET", Some("scene")) => Ok(json_reply(&self.scene())),
            ("GET", Some("state")) => Ok(json_reply(&self.state())),
            ("GET", Some("picture")) => self.pictures.picture(&self.runs, &arguments, has_gone),
            ("GET", Some("photograph")) => self.pictures.photograph(&self.runs, &arguments),
            ("GET", Some("ray")) => self.pictures.ray(&self.runs, &arguments, has_gone),
            ("POST", Some("path")) => self.path(&arguments, body),
            ("GET", Some(name)) => match FILES.iter().find(|(file, ..)| *file == name) {
                Some((_, kind, content)) => Ok(Reply::new(kind, content.as_bytes().to_vec())),
                None => Ok(Reply::refused(404, "There is nothing at this address.")),
            },
            _ => Ok(Reply::refused(405, "This address is not asked for in this way.")),
        };
        answer.unwrap_or_else(|refusal| refusal)
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
        let shares = (0..SCALE_COLOURS).map(|at| 1.0 - at as f32 / (SCALE_COLOURS - 1) as f32);
        let colours: Vec<[u8; 3]> =
            shares.map(|share| scale_colour(share).map(|value| (255.0 * value) as u8)).collect();
        let layers: Vec<&str> = Layer::ALL.into_iter().map(Layer::name).collect();
        json!({
            "name": scene.name,
            "views": views,
            "up": up.unwrap_or([0.0, 0.0, 1.0]),
            "centre": centre,
            "ndc": scene.ndc.is_some(),
            "layers": layers,
            "depth_colours": colours,
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
                "occupied": weights.and_then(Weights::occupied),
                "depths": weights.map(|weights| [weights.depths.0, weights.depths.1]),
                "distance": weights.map(|weights| distance(run, weights)),
            })
        };
        json!({ "runs": self.runs.iter().map(run).collect::<Vec<Value>>() })
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
        Ok(json_reply(&camera_path(&cameras, &scene.space.world, fps)))
    }
}

pub fn json_reply(value: &Value) -> Reply {
    Reply::new("application/json", value.to_string().into_bytes())
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
