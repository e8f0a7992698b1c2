//! `augnerf score`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde_json::{Map, Value, json};

use crate::base::csv::csv_text;
use crate::base::files::write_named;
use crate::base::{Error, Result, version};
use crate::data::images::is_image;
use crate::data::{Photos, Scene};
use crate::metrics::{METRICS, Metric, PSNR, Scope, no_better_than_one_colour};
use crate::run::{
    Matching, Picture, RunDir, Score, Truth, both_pictures, load_lpips, load_scene, load_scene_of, pictures, score,
};
use crate::runtime::Runtime;
use crate::settings::{Config, Resolved, build};
use crate::sweep::{Point, Scored, SweepFolder, SweepOutputs};

use super::answer::Answer;
use super::experiment::{data_settings, scene_settings};
use super::progress::{Console, print};
use super::{Compute, LpipsWeights};

pub const EXAMPLES: &str = "Examples:
  augnerf score renders/ truth/                                         # two folders, equal names
  augnerf score renders/ --data fern --set data.downscale=8             # held-out views of a scene
  augnerf score renders/ --into runs/smoke --row nerf-pytorch --seed 0  # a row of a sweep's table

Prints one line of JSON with the means over views and the SHA-256 of the images. Values are first rounded to 8 bits, as in \
every measurement here.";

/// How images are matched with views.
#[derive(Clone, Copy, ValueEnum)]
enum By {
    /// Equal names without ending; NAME_rgb counts as NAME
    Name,
    /// Sorted by name, numbers by value: the first with the first
    Order,
}

/// The background of transparent pixels.
#[derive(Clone, Copy, ValueEnum)]
enum Behind {
    White,
    Black,
}

#[derive(Args)]
#[command(next_help_heading = "Experiment")]
pub struct ScoreArguments {
    /// Folder of rendered images: PNG, JPEG or WebP
    predictions: PathBuf,
    /// Folder of ground-truth images, or a run folder [default: --data, or the scene of --into]
    #[arg(conflicts_with_all = ["data", "into"])]
    truth: Option<PathBuf>,
    /// Scene folder with the held-out views, here or in AUGNERF_DATA; builtin, or builtin:17 by number
    #[arg(long, value_name = "DIR", conflicts_with = "into")]
    data: Option<PathBuf>,
    /// A setting of section data, or seed: --set data.downscale=8
    #[arg(long, value_name = "FIELD=VALUE", requires = "data")]
    set: Vec<String>,
    /// How images are matched with views
    #[arg(long = "match", value_name = "HOW", value_enum, default_value_t = By::Name)]
    by: By,
    /// Background of transparent images [default: the scene's]
    #[arg(long, value_name = "COLOUR", value_enum)]
    background: Option<Behind>,
    #[command(flatten)]
    weights: LpipsWeights,
    /// Write the numbers and hashes of each view to this CSV file
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    out: Option<PathBuf>,
    /// Add the images as a row to the table of this sweep folder, and compare them with its scene
    #[arg(long, value_name = "SWEEP", requires = "row", help_heading = "Output")]
    into: Option<PathBuf>,
    /// Name of that row
    #[arg(long, value_name = "NAME", requires = "into", help_heading = "Output")]
    row: Option<String>,
    /// Seed of the images; with all the baseline's seeds the row is compared with it [default: none]
    #[arg(long, value_name = "N", requires = "into", help_heading = "Output")]
    seed: Option<u64>,
    /// Scene of the sweep [default: its only one]
    #[arg(long, value_name = "NAME", requires = "into", help_heading = "Output")]
    scene: Option<String>,
    #[command(flatten)]
    answer: Answer,
    #[command(flatten)]
    compute: Compute,
}

/// The sweep to whose table images are added.
struct TargetSweep {
    folder: SweepFolder,
    points: Vec<Point>,
    scene: String,
}

impl ScoreArguments {
    pub fn run(self) -> Result<()> {
        self.compute.run(|runtime, console| self.score(runtime, console))
    }

    fn score(&self, runtime: &Runtime, console: &Console) -> Result<()> {
        if let Some(out) = self.out.as_deref().filter(|out| is_image(out)) {
            return Err(Error::Config(format!(
                "--out {}: the name of an image, and a table in CSV is written there; name a file such as scores.csv",
                out.display()
            )));
        }
        let into = self.into.as_deref().map(|path| self.target(path)).transpose()?;
        let scene = self.held_out(into.as_ref(), console)?;
        let (predictions, truth) = match (&scene, &self.truth) {
            (Some((config, scene)), _) => (pictures(&self.predictions, "_rgb")?, Truth::Scene(config, scene)),
            (None, Some(folder)) => {
                let (predictions, truth) = both_pictures(&self.predictions, folder)?;
                (predictions, Truth::Pictures(truth))
            }
            (None, None) => {
                return Err(Error::Config(
                    "no ground truth; name a folder of images, a run, a scene with --data, or a sweep with --into"
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
        let scored = score(&predictions, &truth, matching, background, &lpips, console)?;
        if let Some(out) = &self.out {
            write_named(out, csv(&scored).as_bytes())?;
        }
        self.say_unusual(&scored, &predictions, console);
        if let Some(into) = &into {
            let file = self.add(&scored, into)?;
            console.say(&format!(
                "{}: show the row with `augnerf sweep collect {}`",
                file.display(),
                into.folder.path().display()
            ));
        }
        // Scripts rely on JSON, with or without the flag.
        let line = self.line(&scored, scene.as_ref().map(|(_, scene)| scene));
        self.answer.give(&line, || print(&line.to_string()))
    }

    fn target(&self, path: &Path) -> Result<TargetSweep> {
        let folder = SweepFolder::new(path);
        let points = folder
            .points(None)?
            .ok_or_else(|| Error::Checkpoint(format!("{}: no folder of a sweep; name runs/NAME", path.display())))?;
        let mut scenes: Vec<&str> = points.iter().map(|point| point.scene.as_str()).collect();
        scenes.sort_unstable();
        scenes.dedup();
        let scene = match (&self.scene, scenes.as_slice()) {
            (Some(scene), known) if known.contains(&scene.as_str()) => scene.clone(),
            (None, [only]) => only.to_string(),
            (_, known) => {
                return Err(Error::Config(format!("--scene NAME: choose one of the sweep's: {}", known.join(", "))));
            }
        };
        Ok(TargetSweep { folder, points, scene })
    }

    /// Returns the scene whose held-out views are the ground truth, or `None` if that is a folder of images.
    fn held_out(&self, into: Option<&TargetSweep>, console: &Console) -> Result<Option<(Resolved, Scene)>> {
        let config = match (&self.truth, &self.data, into) {
            (Some(truth), ..) if RunDir::holds_run(truth) => {
                let run = RunDir::open(truth)?;
                return load_scene_of(&run, run.read_config()?, Photos::Read, console).map(Some);
            }
            (Some(_), ..) => return Ok(None),
            (None, Some(data), _) => self.config(data, console)?,
            (None, None, Some(into)) => {
                let of_scene = || into.points.iter().filter(|point| point.scene == into.scene);
                // Held-out views may depend on the seed.
                let of_seed = of_scene().find(|point| Some(point.config.seed) == self.seed);
                of_seed.or_else(|| of_scene().next()).expect("a point's scene").config.clone()
            }
            (None, None, None) => return Ok(None),
        };
        load_scene(config, console).map(Some)
    }

    fn config(&self, data: &Path, console: &Console) -> Result<Config> {
        let mut assignments = scene_settings("--data ", data, console)?;
        // Training views, which a seed may corrupt, give the floor.
        assignments.extend(data_settings(&self.set, &["seed"], "score, which reads section data and seed", "--data")?);
        build(None, None, &assignments)
    }

    /// Returns the background of transparent images, which must be that of the scene's views.
    fn background(&self, scene: Option<&Scene>) -> Result<Option<[f32; 3]>> {
        let named = self.background.map(|behind| match behind {
            Behind::White => [1.0; 3],
            Behind::Black => [0.0; 3],
        });
        match (named, scene.and_then(|scene| scene.background)) {
            (Some(named), Some(own)) if named != own => Err(Error::Config(
                "--background: not that of the scene's views; omit it, or change theirs with --set data.background"
                    .into(),
            )),
            (named, own) => Ok(named.or(own)),
        }
    }

    fn add(&self, scored: &Score, into: &TargetSweep) -> Result<PathBuf> {
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
            console.say("some images are JPEG: the numbers include the loss by compression");
        }
        no_better_than_one_colour(&scored.mean).iter().for_each(|remark| console.say(remark));
        if let Some(view) = scored.views.iter().find(|view| view.metrics.get(&PSNR).is_none()) {
            console.say(&format!(
                "view {}: equal to its ground truth, so its PSNR is infinite and the mean is empty",
                view.metrics.name
            ));
        }
    }

    /// Returns the means, the hashes and the known columns of the protocol as JSON.
    fn line(&self, scored: &Score, scene: Option<&Scene>) -> Value {
        let mut line = Map::new();
        line.insert("views".into(), scored.views.len().into());
        let of_views = |scope| matches!(scope, Scope::View | Scope::Mean);
        for (metric, value) in scored.mean.iter().filter(|(metric, value)| of_views(metric.scope) && value.is_some()) {
            line.insert(metric.key.into(), json!(value));
        }
        line.entry(PSNR.key).or_insert(Value::Null);
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

/// Formats a line for each view: its name, numbers, files and hashes.
fn csv(scored: &Score) -> String {
    let is_measured = |metric: &Metric| scored.views.iter().any(|view| view.metrics.get(metric).is_some());
    let measured: Vec<&Metric> =
        METRICS.iter().copied().filter(|metric| metric.scope == Scope::View && is_measured(metric)).collect();
    let keys: Vec<&str> = measured.iter().map(|metric| metric.key).collect();
    let files = ["prediction", "prediction_sha256", "truth", "truth_sha256"];
    let head = ["name"].iter().chain(&keys).chain(&files).map(ToString::to_string).collect();
    let rows = scored.views.iter().map(|view| {
        let number = |metric: &&Metric| view.metrics.get(metric).map_or(String::new(), |value| value.to_string());
        let path = |path: &Path| path.display().to_string();
        let mut row = vec![view.metrics.name.clone()];
        row.extend(measured.iter().map(number));
        row.extend([path(&view.prediction), view.prediction_sha256.clone()]);
        row.extend([view.truth.as_deref().map_or(String::new(), path), view.truth_sha256.clone()]);
        row
    });
    csv_text(std::iter::once(head).chain(rows))
}
