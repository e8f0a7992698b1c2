//! `augnerf score`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde_json::{Map, Value, json};

use crate::base::csv::csv_text;
use crate::base::files::write_atomic;
use crate::base::{Error, Result, version};
use crate::data::Scene;
use crate::metrics::METRICS;
use crate::metrics::Scope;
use crate::run::{
    Matching, Picture, RunDir, Score, Truth, both_pictures, load_lpips, load_scene, load_scene_of, pictures, score,
};
use crate::settings::{Config, Resolved, build, parse_assignment};
use crate::sweep::{Point, Scored, SweepFolder, SweepOutputs};

use super::answer::Answer;
use super::progress::{Console, print};
use super::{Compute, LpipsWeights};

pub const EXAMPLES: &str = "Examples:
  augnerf score renders/ truth/                                         # two folders, equal names
  augnerf score renders/ --data fern --set data.downscale=8             # held-out views of a scene
  augnerf score renders/ runs/fern-nerf-0                               # those of a run
  augnerf score renders/ --into runs/smoke --row nerf-pytorch --seed 0  # a row of a table

Pictures are PNG, JPEG or WebP. Values are rounded to 8 bits, as ours are before they are measured; PSNR is the mean of the views'. One line of JSON on \
standard output has the means and the SHA-256 of what was scored.";

/// How pictures find their views.
#[derive(Clone, Copy, ValueEnum)]
enum By {
    /// Equal names but for the ending; of pictures of this program NAME_rgb is NAME
    Name,
    /// Sorted by name, numbers by their size: the first with the first
    Order,
}

/// What see-through pixels are put on.
#[derive(Clone, Copy, ValueEnum)]
enum Behind {
    White,
    Black,
}

#[derive(Args)]
pub struct ScoreArguments {
    /// Folder with the pictures that a program rendered: PNG, JPEG or WebP
    predictions: PathBuf,
    /// What they should show: a folder of pictures, or a run folder, whose held-out views it is then [default: --data, or the
    /// scene of --into]
    #[arg(conflicts_with_all = ["data", "into"])]
    truth: Option<PathBuf>,
    /// Scene folder whose held-out views they should show, or builtin
    #[arg(long, value_name = "DIR", conflicts_with = "into")]
    data: Option<PathBuf>,
    /// A setting of how that scene is read: --set data.downscale=8
    #[arg(long, value_name = "FIELD=VALUE", requires = "data")]
    set: Vec<String>,
    /// How pictures find their views
    #[arg(long = "match", value_name = "HOW", value_enum, default_value_t = By::Name)]
    by: By,
    /// What see-through pictures are put on [default: the scene's background]
    #[arg(long, value_name = "COLOUR", value_enum)]
    background: Option<Behind>,
    /// CSV file for the numbers and hashes of each view
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Folder of a sweep in whose table the pictures are to stand, marked as scored; what they should show are then the
    /// held-out views of its scene
    #[arg(long, value_name = "SWEEP", requires = "row")]
    into: Option<PathBuf>,
    /// What the table calls them
    #[arg(long, value_name = "NAME", requires = "into")]
    row: Option<String>,
    /// The seed that they stand for: with one for each of the baseline's, the row is compared with it
    #[arg(long, value_name = "N", requires = "into")]
    seed: Option<u64>,
    /// Of a sweep with several scenes: which
    #[arg(long, value_name = "NAME", requires = "into")]
    scene: Option<String>,
    #[command(flatten)]
    weights: LpipsWeights,
    #[command(flatten)]
    compute: Compute,
    #[command(flatten)]
    answer: Answer,
}

/// A sweep that pictures are to stand in.
struct Into {
    folder: SweepFolder,
    points: Vec<Point>,
    scene: String,
}

impl ScoreArguments {
    pub fn run(self) -> Result<()> {
        let runtime = self.compute.runtime()?;
        let console = Console::new(self.compute.quiet);
        let into = self.into.as_deref().map(|path| self.sweep(path)).transpose()?;
        let scene = self.held_out(into.as_ref(), &console)?;
        let (predictions, truth) = match (&scene, &self.truth) {
            (Some((config, scene)), _) => (pictures(&self.predictions, "_rgb")?, Truth::Scene(config, scene)),
            (None, Some(folder)) => {
                let (predictions, truth) = both_pictures(&self.predictions, folder)?;
                (predictions, Truth::Pictures(truth))
            }
            (None, None) => {
                return Err(Error::Config(
                    "name what the pictures should show: a folder of pictures, a run, a scene with --data, or a sweep with \
                     --into"
                        .into(),
                ));
            }
        };
        let weights = self.weights.lpips_weights.as_ref().map(|dir| dir.to_string_lossy().into_owned());
        let lpips = load_lpips(&weights.unwrap_or_default(), runtime.device())?;
        let matching = match self.by {
            By::Name => Matching::Name,
            By::Order => Matching::Order,
        };
        let background = self.background(scene.as_ref().map(|(_, scene)| scene))?;
        let scored = runtime.install(|| score(&predictions, &truth, matching, background, &lpips, &console))?;
        if let Some(out) = &self.out {
            write_atomic(out, csv(&scored).as_bytes())?;
        }
        self.say_unusual(&scored, &predictions, &console);
        if let Some(into) = &into {
            let file = self.add(&scored, into)?;
            console.say(&format!(
                "{}: `augnerf sweep collect {}` shows the row",
                file.display(),
                into.folder.path().display()
            ));
        }
        // JSON it always is.
        let line = self.line(&scored, scene.as_ref().map(|(_, scene)| scene));
        self.answer.give(&line, || print(&line.to_string()))
    }

    fn sweep(&self, path: &Path) -> Result<Into> {
        let folder = SweepFolder::new(path);
        let points = folder
            .points(None)?
            .ok_or_else(|| Error::Checkpoint(format!("{} is no folder of a sweep: name runs/NAME", path.display())))?;
        let mut scenes: Vec<&str> = points.iter().map(|point| point.scene.as_str()).collect();
        scenes.sort_unstable();
        scenes.dedup();
        let scene = match (&self.scene, scenes.as_slice()) {
            (Some(scene), known) if known.contains(&scene.as_str()) => scene.clone(),
            (None, [only]) => only.to_string(),
            (_, known) => {
                return Err(Error::Config(format!("--scene NAME: name one of the sweep's, {}", known.join(", "))));
            }
        };
        Ok(Into { folder, points, scene })
    }

    /// The scene whose held-out views are the truth; none where that is a folder of pictures.
    fn held_out(&self, into: Option<&Into>, console: &Console) -> Result<Option<(Resolved, Scene)>> {
        let config = match (&self.truth, &self.data, into) {
            (Some(truth), ..) if RunDir::holds_run(truth) => {
                let run = RunDir::open(truth)?;
                return load_scene_of(&run, run.read_config()?, console).map(Some);
            }
            (Some(_), ..) => return Ok(None),
            (None, Some(data), _) => self.config(data)?,
            (None, None, Some(into)) => {
                let of_scene = || into.points.iter().filter(|point| point.scene == into.scene);
                // Held-out views may go with the seed.
                let of_seed = of_scene().find(|point| Some(point.config.seed) == self.seed);
                of_seed.or_else(|| of_scene().next()).expect("a point's scene").config.clone()
            }
            (None, None, None) => return Ok(None),
        };
        load_scene(config, console).map(Some)
    }

    fn config(&self, data: &Path) -> Result<Config> {
        let mut assignments = Vec::new();
        if data != Path::new("builtin") {
            let data = std::path::absolute(data).map_err(|e| Error::unreadable(data, &e))?;
            let data = data.to_string_lossy().into_owned();
            assignments.push((vec!["data".into(), "dir".into()], toml::Value::String(data)));
        }
        for text in &self.set {
            assignments.push(parse_assignment(text)?);
        }
        build(None, None, &assignments)
    }

    /// The background of see-through pictures, which is that of the views that they are held against.
    fn background(&self, scene: Option<&Scene>) -> Result<Option<[f32; 3]>> {
        let named = self.background.map(|behind| match behind {
            Behind::White => [1.0; 3],
            Behind::Black => [0.0; 3],
        });
        match (named, scene.and_then(|scene| scene.background)) {
            (Some(named), Some(own)) if named != own => Err(Error::Config(
                "--background: the scene's views stand on another one; --set data.background changes it".into(),
            )),
            (named, own) => Ok(named.or(own)),
        }
    }

    fn add(&self, scored: &Score, into: &Into) -> Result<PathBuf> {
        let definition = into.folder.definition()?;
        let outputs = SweepOutputs::of_folder(&into.folder, &definition, &into.points)?;
        let of_views = |scope| matches!(scope, Scope::View | Scope::Mean);
        let metrics = scored.mean.iter().filter(|(metric, value)| of_views(metric.scope) && value.is_some());
        let scored = Scored {
            row: self.row.clone().expect("clap asks for it"),
            scene: into.scene.clone(),
            seed: self.seed,
            predictions_sha256: scored.predictions_sha256.clone(),
            truth: scored.truth_sha256.clone(),
            metrics: metrics.map(|(metric, value)| (metric.key.to_string(), value)).collect(),
            protocol: scored.protocol.clone(),
        };
        let spec = definition.table("", &into.points);
        into.folder.add_scored(&scored, &spec, &outputs.records)
    }

    fn say_unusual(&self, scored: &Score, predictions: &[Picture], console: &Console) {
        let ending = |picture: &Picture| picture.path.extension().map(|ending| ending.to_ascii_lowercase());
        let is_jpeg = |picture: &&Picture| ending(picture).is_some_and(|ending| ending == "jpg" || ending == "jpeg");
        if predictions.iter().any(|picture| is_jpeg(&picture)) {
            console.say("some pictures are JPEG: what their compression cost is in the numbers");
        }
        if let Some(view) = scored.views.iter().find(|view| view.metrics.get("psnr").is_none()) {
            console.say(&format!(
                "view {} equals what it is held against: its PSNR is infinite, and the mean is left empty",
                view.metrics.name
            ));
        }
    }

    /// The means, the hashes and what is known of the protocol.
    fn line(&self, scored: &Score, scene: Option<&Scene>) -> Value {
        let mut line = Map::new();
        line.insert("views".into(), scored.views.len().into());
        let of_views = |scope| matches!(scope, Scope::View | Scope::Mean);
        for (metric, value) in scored.mean.iter().filter(|(metric, value)| of_views(metric.scope) && value.is_some()) {
            line.insert(metric.key.into(), json!(value));
        }
        line.entry("psnr").or_insert(Value::Null);
        let known: BTreeMap<&str, &str> =
            scored.protocol.iter().map(|(name, text)| (name.as_str(), text.as_str())).collect();
        line.insert("predictions".into(), self.predictions.to_string_lossy().into());
        line.insert("predictions_sha256".into(), scored.predictions_sha256.clone().into());
        let truth = self.truth.as_ref().map(|truth| truth.to_string_lossy().into_owned());
        let truth = truth.or_else(|| scene.map(|scene| scene.name.clone()));
        line.insert("truth".into(), truth.into());
        line.insert("truth_sha256".into(), scored.truth_sha256.clone().into());
        line.insert("protocol".into(), json!(known));
        line.insert("program".into(), version().into());
        Value::Object(line)
    }
}

/// A line a view: its name, its numbers, files and their hashes.
fn csv(scored: &Score) -> String {
    let measured: Vec<&str> = METRICS
        .iter()
        .filter(|metric| metric.scope == Scope::View)
        .map(|metric| metric.key)
        .filter(|key| scored.views.iter().any(|view| view.metrics.get(key).is_some()))
        .collect();
    let files = ["prediction", "prediction_sha256", "truth", "truth_sha256"];
    let head = ["name"].iter().chain(&measured).chain(&files).map(ToString::to_string).collect();
    let rows = scored.views.iter().map(|view| {
        let number = |key: &&str| view.metrics.get(key).map_or(String::new(), |value| value.to_string());
        let path = |path: &Path| path.display().to_string();
        let mut row = vec![view.metrics.name.clone()];
        row.extend(measured.iter().map(number));
        row.extend([path(&view.prediction), view.prediction_sha256.clone()]);
        row.extend([view.truth.as_deref().map_or(String::new(), path), view.truth_sha256.clone()]);
        row
    });
    csv_text(std::iter::once(head).chain(rows))
}
