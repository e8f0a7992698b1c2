//! From a definition to points: every configuration built and checked before the first training.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use toml::Value;

use crate::base::{Error, Result};
use crate::run::locate_scene;
use crate::settings::{Config, Preset, build};

use super::axes::{Axis, AxisPoint};
use super::budget::{StepCosts, steps_within};
use super::definition::{Budget, Combine, Definition, Row, scene_name};
use crate::metrics::Scope;
use crate::report::{AxisValue, label};

/// One training: a configuration with its seed. Rows that come to the same share it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Point {
    /// Content hash of the configuration: the name of the point's folder.
    pub id: String,
    /// The scene's name.
    pub scene: String,
    /// The scene as the definition names it.
    pub source: String,
    /// The configuration before its scene fills what depends on it.
    pub config: Config,
    /// Where it stands in the table; at least one place.
    pub places: Vec<Place>,
    /// Its steps are those of a budget that could not be told without the scene.
    pub without_budget: bool,
    /// Why its scene cannot be read; none where it can.
    #[serde(skip)]
    pub no_data: Option<String>,
}

/// A cell of the table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Place {
    /// The row's name.
    pub row: String,
    /// The values of axes.
    pub axes: Vec<AxisValue>,
}

impl Point {
    /// For a person: scene, row, seed.
    pub fn label(&self) -> String {
        let place = &self.places[0];
        format!("{} · {} · seed {}", label(&place.row, &place.axes), self.scene, self.config.seed)
    }

    /// Looks for the scene below `data_root`.
    pub(super) fn locate(&mut self, data_root: Option<&Path>) {
        self.config.data.dir = scene_folder(&self.source, data_root).to_string_lossy().into_owned();
        self.no_data = missing(&self.config);
    }
}

/// Why there is no scene where a configuration looks for it. One that is there and broken fails
/// its points instead.
fn missing(config: &Config) -> Option<String> {
    match locate_scene(config.clone()) {
        Err(Error::Data(message)) if !Path::new(&config.data.dir).exists() => Some(message),
        _ => None,
    }
}

/// Expands a definition in the order in which points are run: seed by seed, so that a part of a
/// sweep is a table already. `data_root` is where relative scenes lie.
pub fn expand(definition: &Definition, data_root: Option<&Path>, costs: &dyn StepCosts) -> Result<Vec<Point>> {
    let preset = Preset::parse(&definition.preset)?;
    let mut points: Vec<Point> = Vec::new();
    let mut known: HashMap<String, usize> = HashMap::new();
    for &seed in &definition.seeds {
        for scene in &definition.scenes {
            let builder = Builder { definition, preset, scene, folder: scene_folder(scene, data_root), seed, costs };
            for row in &definition.row {
                for axes in combinations(definition, row)? {
                    let point = builder.point(row, &axes)?;
                    let Some(&index) = known.get(&point.id) else {
                        known.insert(point.id.clone(), points.len());
                        points.push(point);
                        continue;
                    };
                    let places = &mut points[index].places;
                    let [place] = &point.places[..] else { unreachable!("a new point has one place") };
                    if let Some(same) = places.iter().find(|other| other.row != place.row && other.axes == place.axes) {
                        return Err(Error::Config(format!(
                            "rows '{}' and '{}' are the same experiment; change or remove one",
                            same.row, place.row
                        )));
                    }
                    places.push(place.clone());
                }
            }
        }
    }
    Ok(points)
}

fn named(axes: &Combination) -> Vec<AxisValue> {
    axes.iter().map(|(axis, point)| axis.named(point)).collect()
}

/// A place on each of some axes.
type Combination<'a> = Vec<(&'a Axis, AxisPoint)>;

/// The places on axes that a row is trained at; one empty combination for a plain row.
fn combinations<'a>(definition: &'a Definition, row: &'a Row) -> Result<Vec<Combination<'a>>> {
    let on_axis = |axis: &'a Axis| -> Result<Combination<'a>> {
        let points = axis.points().map_err(|message| Error::Config(format!("axis '{}': {message}", axis.name)))?;
        Ok(points.into_iter().map(|point| (axis, point)).collect())
    };
    let axes: Vec<Combination> = definition.axes_of(row).iter().map(on_axis).collect::<Result<_>>()?;
    if axes.is_empty() {
        return Ok(vec![Vec::new()]);
    }
    Ok(match definition.combine {
        Combine::OneAtATime => axes.into_iter().flatten().map(|point| vec![point]).collect(),
        Combine::Product => axes.iter().fold(vec![Vec::new()], |partial: Vec<Combination>, axis| {
            let extended = |combination: &Combination<'a>| -> Vec<Combination<'a>> {
                axis.iter().map(|point| [combination.as_slice(), std::slice::from_ref(point)].concat()).collect()
            };
            partial.iter().flat_map(extended).collect()
        }),
    })
}

/// Where a scene is; empty for the embedded ones.
fn scene_folder(scene: &str, data_root: Option<&Path>) -> PathBuf {
    match scene {
        "builtin" | "builtin-forward" => PathBuf::new(),
        folder => data_root.map_or_else(|| PathBuf::from(folder), |root| root.join(folder)),
    }
}

struct Builder<'a> {
    definition: &'a Definition,
    preset: Preset,
    scene: &'a str,
    folder: PathBuf,
    seed: u64,
    costs: &'a dyn StepCosts,
}

impl Builder<'_> {
    fn point(&self, row: &Row, axes: &Combination) -> Result<Point> {
        let mut config = self.plain_config(row, axes)?;
        if let Some(metric) = self.definition.metric_in(Scope::Surface).filter(|_| config.eval.mesh.resolution == 0) {
            let message = format!(
                "metric '{}' needs a surface, which eval.mesh.resolution = 0 leaves out: set it to the cells along each \
                 side of the box, such as 128",
                metric.key
            );
            return Err(in_row(row, axes, Error::Config(message)));
        }
        let located = match locate_scene(config.clone()) {
            Err(error @ Error::Config(_)) => return Err(in_row(row, axes, error)),
            located => located.ok(),
        };
        let budget = row.budget.as_ref().or(self.definition.budget.as_ref()).filter(|budget| budget.like != row.name);
        if let (Some(Budget { kind, like }), Some(located)) = (budget, &located) {
            let other = self.definition.row.iter().find(|row| row.name == *like).expect("checked");
            let steps = steps_within(*kind, &config, &self.plain_config(other, &Vec::new())?, self.costs)?;
            // The decay of the learning rate is stretched too: at the old one a long run would stand still at its end.
            let stretch = steps as f64 / config.train.steps as f64;
            let decay_steps = located.decay_steps as f64 * stretch;
            config.train.decay_steps = Some((decay_steps.round() as u64).max(1));
            config.train.steps = steps;
            config.validate().map_err(|error| in_row(row, axes, error))?;
        }
        let without_budget = budget.is_some() && located.is_none();
        Ok(Point {
            // Not the point that the row would be without its budget.
            id: config.hash() + if without_budget { "-without-budget" } else { "" },
            scene: scene_name(self.scene).to_string(),
            source: self.scene.to_string(),
            no_data: missing(&config),
            config,
            places: vec![Place { row: row.name.clone(), axes: named(axes) }],
            without_budget,
        })
    }

    fn plain_config(&self, row: &Row, axes: &Combination) -> Result<Config> {
        let preset = row.preset.as_deref().map_or(Ok(self.preset), Preset::parse)?;
        let mut assignments: Vec<(Vec<String>, Value)> = Vec::new();
        let mut assign = |key: &str, value: Value| {
            assignments.push((key.split('.').map(String::from).collect(), value));
        };
        for (table, value) in [&self.definition.set, &row.set].into_iter().flatten() {
            flatten(table, value, &mut assign);
        }
        for (_, point) in axes {
            point.sets.iter().for_each(|(key, value)| assign(key, value.clone()));
        }
        match self.scene {
            "builtin" => {}
            "builtin-forward" => assign("data.kind", Value::String("builtin-forward".into())),
            _ => assign("data.dir", Value::String(self.folder.to_string_lossy().into_owned())),
        }
        assign("seed", Value::Integer(self.seed as i64));
        build(Some(preset), None, &assignments).map_err(|error| in_row(row, axes, error))
    }
}

/// The same error with the row that it is about.
fn in_row(row: &Row, axes: &Combination, error: Error) -> Error {
    match error {
        Error::Config(message) => Error::Config(format!("row '{}': {message}", label(&row.name, &named(axes)))),
        other => other,
    }
}

/// `a.b = v` and nested tables alike, as dotted names.
fn flatten(key: &str, value: &Value, assign: &mut impl FnMut(&str, Value)) {
    match value {
        Value::Table(table) => {
            table.iter().for_each(|(inner, value)| flatten(&format!("{key}.{inner}"), value, assign))
        }
        value => assign(key, value.clone()),
    }
}
