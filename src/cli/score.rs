//! `augnerf score`.

use std::path::PathBuf;

use clap::Args;
use serde_json::{Map, Value, json};

use crate::base::csv::csv_text;
use crate::base::files::write_named;
use crate::base::{Error, Result, version};
use crate::data::images::is_image;
use crate::data::{Photos, Scene};
use crate::metrics::{METRICS, Metric, PSNR, Scope, no_better_than_one_colour};
use crate::run::{Matching, Picture, RunDir, Score, Truth, load_lpips, load_scene, load_scene_of, pictures, score};
use crate::runtime::Runtime;
use crate::settings::{Resolved, build};

use super::answer::Answer;
use super::experiment::{data_settings, scene_settings};
use super::progress::{Console, print};
use super::{Choice, Compute, LpipsWeights, choice};

pub const EXAMPLES: &str = "Examples:
  augnerf score renders/ truth/                              # two folders, equal names
  augnerf score renders/ --data fern --set data.downscale=8  # held-out views of a scene
  augnerf score renders/ runs/fern-nerf-0 --out views.csv    # those of a run, a line each

Prints one line of JSON with the means over views. Values are first rounded to 8 bits, as in every measurement here.";

const MATCHINGS: [Choice<Matching>; 2] = [
    ("name", "Equal names without ending; NAME_rgb counts as NAME", Matching::Name),
    ("order", "Sorted by name, numbers by value: the first with the first", Matching::Order),
];
const COLOURS: [Choice<[f32; 3]>; 2] =
    [("white", "1 in each channel", [1.0; 3]), ("black", "0 in each channel", [0.0; 3])];

#[derive(Args)]
#[command(next_help_heading = "Experiment")]
pub struct ScoreArguments {
    /// Folder of rendered images: PNG, JPEG or WebP
    predictions: PathBuf,
    /// Folder of ground-truth images, or a run folder [default: --data]
    #[arg(conflicts_with = "data")]
    truth: Option<PathBuf>,
    /// Scene folder with the held-out views, here or in AUGNERF_DATA; builtin, or builtin:17 by number
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// A setting of section data, or seed: --set data.downscale=8
    #[arg(long, value_name = "FIELD=VALUE", requires = "data")]
    set: Vec<String>,
    /// How images are matched with views
    #[arg(long = "match", value_name = "HOW", value_parser = choice(&MATCHINGS), default_value = "name")]
    matching: Matching,
    /// Background of transparent images [default: the scene's]
    #[arg(long, value_name = "COLOUR", value_parser = choice(&COLOURS))]
    background: Option<[f32; 3]>,
    #[command(flatten)]
    weights: LpipsWeights,
    /// Write the numbers of each view to this CSV file
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    out: Option<PathBuf>,
    #[command(flatten)]
    answer: Answer,
    #[command(flatten)]
    compute: Compute,
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
        let held_out = self.held_out(console)?;
        let scene = held_out.as_ref().map(|(_, scene)| scene);
        let truth = match (&held_out, &self.truth) {
            (Some((config, scene)), _) => Truth::Scene(config, scene),
            (None, Some(folder)) => Truth::Pictures(pictures(folder, "_truth")?),
            (None, None) => {
                let message = "no ground truth; name a folder of images, a run, or a scene with --data";
                return Err(Error::Config(message.into()));
            }
        };
        let weights = self.weights.lpips_weights.as_ref().map(|dir| dir.to_string_lossy().into_owned());
        let lpips = load_lpips(&weights.unwrap_or_default(), runtime.device())?;
        // Two folders of other programs may have equal names that end as this program's.
        let is_ours = |all: &[Picture]| !all.iter().any(|picture| picture.name.ends_with("_rgb"));
        let ending = if matches!(&truth, Truth::Pictures(all) if !is_ours(all)) { "" } else { "_rgb" };
        let (predictions, background) = (pictures(&self.predictions, ending)?, self.background(scene)?);
        let scored = score(&predictions, &truth, self.matching, background, &lpips, console)?;
        if let Some(out) = &self.out {
            write_named(out, csv(&scored).as_bytes())?;
        }
        say_unusual(&scored, &predictions, console);
        // Scripts rely on JSON, with or without the flag.
        let line = self.line(&scored, scene);
        self.answer.give(&line, || print(&line.to_string()))
    }

    /// Returns the scene whose held-out views are the ground truth, or `None` if that is a folder of images.
    fn held_out(&self, console: &Console) -> Result<Option<(Resolved, Scene)>> {
        if let Some(truth) = self.truth.as_deref().filter(|truth| RunDir::holds_run(truth)) {
            let run = RunDir::open(truth)?;
            return load_scene_of(&run, run.read_config()?, Photos::Read, console).map(Some);
        }
        let Some(data) = &self.data else { return Ok(None) };
        let mut assignments = scene_settings("--data ", data, console)?;
        // Training views, which a seed may corrupt, give the floor.
        assignments.extend(data_settings(&self.set, &["seed"], "score, which reads section data and seed", "--data")?);
        load_scene(build(None, None, &assignments)?, console).map(Some)
    }

    /// Returns the background of transparent images, which must be that of the scene's views.
    fn background(&self, scene: Option<&Scene>) -> Result<Option<[f32; 3]>> {
        match (self.background, scene.and_then(|scene| scene.background)) {
            (Some(named), Some(own)) if named != own => Err(Error::Config(
                "--background: not that of the scene's views; omit it, or change theirs with --set data.background"
                    .into(),
            )),
            (named, own) => Ok(named.or(own)),
        }
    }

    /// Returns the means and the known columns of the protocol as JSON.
    fn line(&self, scored: &Score, scene: Option<&Scene>) -> Value {
        let mut line = Map::new();
        line.insert("views".into(), scored.views.len().into());
        let of_views = |scope| matches!(scope, Scope::View | Scope::Mean);
        for (metric, value) in scored.mean.iter().filter(|(metric, value)| of_views(metric.scope) && value.is_some()) {
            line.insert(metric.key.into(), json!(value));
        }
        line.entry(PSNR.key).or_insert(Value::Null);
        line.insert("predictions".into(), self.predictions.to_string_lossy().into());
        let truth = self.truth.as_ref().map(|truth| truth.to_string_lossy().into_owned());
        line.insert("truth".into(), truth.or_else(|| scene.map(|scene| scene.name.clone())).into());
        let protocol = scored.protocol.iter().map(|(name, text)| (name.to_string(), text.as_str().into()));
        line.insert("protocol".into(), Value::Object(protocol.collect()));
        line.insert("program".into(), version().into());
        Value::Object(line)
    }
}

fn say_unusual(scored: &Score, predictions: &[Picture], console: &Console) {
    let is_jpeg = |picture: &Picture| {
        let ending = picture.path.extension().map(|ending| ending.to_ascii_lowercase());
        ending.is_some_and(|ending| ending == "jpg" || ending == "jpeg")
    };
    if predictions.iter().any(is_jpeg) {
        console.say("some images are JPEG: the numbers include the loss by compression");
    }
    no_better_than_one_colour(&scored.mean).iter().for_each(|remark| console.say(remark));
    if let Some(view) = scored.views.iter().find(|view| view.get(&PSNR).is_none()) {
        console.say(&format!(
            "view {}: equal to its ground truth, so its PSNR is infinite and the mean is empty",
            view.name
        ));
    }
}

/// Formats a line for each view: its name and numbers.
fn csv(scored: &Score) -> String {
    let is_measured = |metric: &&&Metric| scored.views.iter().any(|view| view.get(metric).is_some());
    let metrics = METRICS.iter().filter(|metric| metric.scope == Scope::View);
    let measured: Vec<&&Metric> = metrics.filter(is_measured).collect();
    let head =
        ["name", "prediction"].into_iter().chain(measured.iter().map(|metric| metric.key)).map(String::from).collect();
    let rows = scored.views.iter().zip(&scored.images).map(|(view, image)| {
        let number = |metric: &&&Metric| view.get(metric).map_or(String::new(), |value| value.to_string());
        [view.name.clone(), image.to_string_lossy().into_owned()]
            .into_iter()
            .chain(measured.iter().map(number))
            .collect()
    });
    csv_text(std::iter::once(head).chain(rows))
}
