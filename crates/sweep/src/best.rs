//! The best settings of a finished sweep, by the mean over seeds.

use std::path::PathBuf;

use serde::Serialize;

use crate::base::{Error, Result};
use crate::metrics::{Direction, Metric};
use crate::report::statistics::p_text;
use crate::report::tables::text::interval_of;
use crate::report::tables::{Line, Table, Verdict};
use crate::report::{TableSpec, distinct};
use crate::settings::registry::REGISTRY;
use crate::settings::{Config, value_at};

use super::folder::SweepFolder;
use super::outputs::SweepOutputs;
use super::points::Point;

/// The best line of a scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Best {
    /// The scene's name.
    pub scene: String,
    /// Row and axis values.
    pub label: String,
    /// The metric's key.
    pub metric: String,
    /// Its mean over the seeds.
    pub mean: f64,
    /// The points, one a seed.
    pub seeds: Vec<BestSeed>,
    /// The method, and each setting that differs among the scene's points and is not at its default.
    pub settings: Vec<(String, String)>,
    /// The second-best line, with its mean.
    pub next: Option<(String, f64)>,
    /// The difference of this line to its baseline, or of the second-best line if this one is the baseline, and whether it
    /// is distinguishable from zero. `None` without a baseline, or seeds that both have.
    pub against_baseline: Option<String>,
    /// Number of candidate lines, this one included.
    pub candidates: usize,
    /// Lines without a number for every seed; they were not considered.
    pub unfinished: Vec<String>,
    /// The views that were measured, as in the protocol: `test`, `every-8-val`.
    pub split: String,
    /// With at least one seed, PSNR is no higher than that of the best single colour of the training views.
    pub no_better_than_one_colour: bool,
    /// With how many seeds.
    pub seeds_of_one_colour: usize,
    /// These are validation views, not the views of reported results.
    pub on_validation: bool,
}

/// A point of the best line.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BestSeed {
    /// Its seed.
    pub seed: u64,
    /// Value of the metric.
    pub value: f64,
    /// The point's name.
    pub id: String,
    /// Its run folder, or `None` if only results are available.
    pub run: Option<PathBuf>,
}

/// Finds the best line of each scene. A line with missing points is not considered, since means over other seeds do
/// not compare.
///
/// # Errors
/// The metric does not exist or has no better direction; nothing was measured; rows are not comparable and `force` is
/// unset.
pub fn best(
    folder: &SweepFolder,
    spec: &TableSpec,
    points: &[Point],
    outputs: &SweepOutputs,
    metric: &str,
    force: bool,
) -> Result<Vec<Best>> {
    let known = Metric::in_tables().find(|known| known.key == metric && known.direction != Direction::Neither);
    let Some(known) = known else {
        let keys: Vec<&str> =
            Metric::in_tables().filter(|m| m.direction != Direction::Neither).map(|m| m.key).collect();
        return Err(Error::Config(format!(
            "--metric {metric}: unknown metric, or one without a best value; choose from {}",
            keys.join(", ")
        )));
    };
    let spec = TableSpec { metrics: vec![metric.into()], ..spec.clone() };
    let table = Table::new(&spec, &outputs.records, force)?;
    let of_scene = |(scene, lines): (&str, Vec<&Line>)| {
        let mut ranked: Vec<(&Line, f64)> = lines.iter().filter_map(|line| Some((*line, complete(line)?))).collect();
        ranked.sort_by(|a, b| match known.direction {
            Direction::Up => b.1.total_cmp(&a.1),
            _ => a.1.total_cmp(&b.1),
        });
        let (line, mean) = *ranked.first()?;
        let missing = |line: &&&Line| !line.quoted && complete(line).is_none();
        let of_line = outputs.records.iter().filter(|r| r.scene == line.scene && r.label() == line.label);
        let splits = distinct(of_line.map(|record| record.protocol("split").to_string()));
        let is_validation = |split: &String| split.split('-').any(|part| part == "val");
        Some(Best {
            scene: scene.into(),
            label: line.label.clone(),
            metric: metric.into(),
            mean,
            seeds: seeds(folder, outputs, line, metric),
            settings: settings(points, line),
            next: ranked.get(1).map(|(line, mean)| (line.label.clone(), *mean)),
            against_baseline: ranked.iter().take(2).find_map(|(line, _)| against_baseline(line, known.unit)),
            candidates: ranked.len(),
            unfinished: lines.iter().filter(missing).map(|line| line.label.clone()).collect(),
            on_validation: splits.iter().all(is_validation),
            split: splits.join(", "),
            no_better_than_one_colour: !line.no_better_than_one_colour.is_empty(),
            seeds_of_one_colour: line.no_better_than_one_colour.len(),
        })
    };
    let found: Vec<Best> = table.scenes().into_iter().filter_map(of_scene).collect();
    if found.is_empty() {
        return Err(Error::Config(format!(
            "{}: no row has {metric} for all of its points; `augnerf sweep status` shows how far they are",
            folder.path().display()
        )));
    }
    Ok(found)
}

/// Returns a sentence on a line's difference to its baseline, by the comparison of the table.
fn against_baseline(line: &Line, unit: &str) -> Option<String> {
    let (baseline, cell) = (line.baseline.as_ref()?, &line.cells[0]);
    let comparison = cell.comparison.as_ref()?;
    let (label, p) = (&line.label, comparison.p_holm.map_or(String::new(), |p| format!(", p {}", p_text(p))));
    let said = match (comparison.interval, comparison.verdict()) {
        (None, _) => "has no interval: one seed is too few",
        (_, Some(Verdict::NotDistinguishable)) => "is not distinguishable from zero",
        (_, Some(_)) => "is distinguishable from zero",
        (_, None) => "has an interval without zero, but is not significant after Holm's correction",
    };
    let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
    Some(format!("the difference of {label} to {baseline} {said}: {}{unit}{p}", interval_of(cell)))
}

/// Returns the mean of a line if all of its points have the metric.
fn complete(line: &Line) -> Option<f64> {
    let cell = &line.cells[0];
    cell.mean.filter(|_| line.points > 0 && cell.n == line.points && !line.scored)
}

fn seeds(folder: &SweepFolder, outputs: &SweepOutputs, line: &Line, metric: &str) -> Vec<BestSeed> {
    let own = outputs.records.iter().filter(|r| r.scene == line.scene && r.label() == line.label);
    let seed = |record: &crate::report::Record| {
        let run = Some(folder.point(&record.id).run()).filter(|run| run.is_dir());
        Some(BestSeed { seed: record.seed?, value: record.metric(metric)?, id: record.id.clone(), run })
    };
    own.filter_map(seed).collect()
}

/// Returns the line's method and its value of each setting that differs within the scene and is not at its default.
/// Includes settings that its method does not read.
fn settings(points: &[Point], line: &Line) -> Vec<(String, String)> {
    let of_scene: Vec<&Point> = points.iter().filter(|point| point.scene == line.scene).collect();
    let tables: Vec<toml::Table> = of_scene.iter().map(|point| point.config.portable().to_table()).collect();
    let default = Config::default().portable().to_table();
    let Some(own) = of_scene.iter().position(|point| line.ids.contains(&point.id)) else { return Vec::new() };
    let text = |table: &toml::Table, path: &str| value_at(table, path).map_or("unset".into(), ToString::to_string);
    let varied = REGISTRY.settings.iter().map(|setting| setting.path.as_str()).filter(|path| {
        let value = text(&tables[own], path);
        let is_told = *path == "method" || value != text(&default, path);
        is_told && *path != "seed" && tables.iter().any(|table| text(table, path) != value)
    });
    varied.map(|path| (path.to_string(), text(&tables[own], path))).collect()
}
