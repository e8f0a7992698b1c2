//! From a definition to configurations. Each is built and checked, and its scene is located, before anything is
//! measured.

use std::collections::BTreeSet;
use std::fmt::Display;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use toml::Value;

use crate::base::{Error, Result};
use crate::metrics::Scope;
use crate::report::{AxisValue, label};
use crate::run::locate_scene;
use crate::settings::{BuiltinScene, Config, DataKind, Preset, build, check_assignment, leaves};

use super::axes::{Axis, AxisPoint};
use super::definition::{BudgetKind, Combine, Definition, Row, scene_name};
use super::points::Point;

/// A row of the table with its values on axes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TablePosition {
    /// The row's name.
    pub row: String,
    /// The values on axes.
    pub axes: Vec<AxisValue>,
}

/// A point before its budget is applied, at one position in the table.
pub struct PlannedRun {
    /// The point, with its own number of steps and no name yet.
    pub point: Point,
    /// The budget's kind, and the configuration that it equals in cost; `None` if the row has its own steps.
    pub budget: Option<(BudgetKind, Config)>,
    /// Steps over which its learning rate falls, or `None` if the scene is missing.
    pub decay_steps: Option<u64>,
}

/// A definition's table before budgets are applied.
pub struct Layout {
    /// The runs, in the order in which points run.
    pub planned: Vec<PlannedRun>,
    /// Rows with wrong settings.
    pub refused: Refused,
}

impl Layout {
    /// Builds the configurations of a definition's table. Points run seed by seed, so that part of a sweep already makes
    /// a table. Relative scenes are below `data_root`.
    pub fn of(definition: &Definition, data_root: Option<&Path>) -> Result<Layout> {
        let preset = Preset::parse(&definition.preset)?;
        let mut layout = Layout { planned: Vec::new(), refused: Refused::default() };
        for &seed in &definition.seeds {
            for scene in &definition.scenes {
                let builder = Builder { definition, preset, scene, folder: scene_folder(scene, data_root), seed };
                for row in &definition.row {
                    for axes in combinations(definition, row)? {
                        let (laid, named) = (builder.lay(row, &axes), label(&row.name, &named(&axes)));
                        layout.planned.extend(layout.refused.unless(laid, &[&named], scene_name(scene))?);
                    }
                }
            }
        }
        Ok(layout)
    }
}

/// Rows that cannot run, with their scenes, by the reason. One list for all checks of a sweep.
#[derive(Clone, Default)]
pub struct Refused {
    reasons: Vec<(String, Vec<String>)>,
    /// Rows that passed some check.
    passed: BTreeSet<String>,
}

/// Most rows that are named with a reason.
const MOST_NAMED: usize = 20;

impl Refused {
    /// Returns what is there of rows on a scene. A wrong setting refuses the rows; any other error is returned.
    pub(super) fn unless<T>(&mut self, made: Result<T>, rows: &[&str], scene: impl Display) -> Result<Option<T>> {
        let rows = rows.iter().map(|row| format!("{row} ({scene})"));
        let reason = match made {
            Err(error) if error.is_of_settings() => error.to_string(),
            made => {
                self.passed.extend(rows);
                return made.map(Some);
            }
        };
        for row in rows {
            match self.reasons.iter_mut().find(|(known, _)| *known == reason) {
                Some((_, known)) if known.contains(&row) => {}
                Some((_, known)) => known.push(row),
                None => self.reasons.push((reason.clone(), vec![row])),
            }
        }
        Ok(None)
    }

    /// Returns whether no row is refused.
    pub(super) fn is_empty(&self) -> bool {
        self.reasons.is_empty()
    }

    /// Returns the error that names all refused rows, if there are any.
    pub(super) fn check(self) -> Result<()> {
        match &self.reasons[..] {
            [] => return Ok(()),
            [(reason, rows)] if rows.len() > 1 && self.passed.iter().all(|row| rows.contains(row)) => {
                return Err(Error::Config(format!("no row can run: {reason}")));
            }
            _ => {}
        }
        let of_reason = |(reason, rows): &(String, Vec<String>)| {
            let more = rows.len().saturating_sub(MOST_NAMED);
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            format!("{}{more}: {reason}", rows[..rows.len().min(MOST_NAMED)].join(", "))
        };
        let reasons: Vec<String> = self.reasons.iter().map(of_reason).collect();
        Err(Error::Config(format!("rows that cannot run: {}", reasons.join("; "))))
    }
}

fn named(axes: &Combination) -> Vec<AxisValue> {
    axes.iter().map(|(axis, point)| axis.named(point)).collect()
}

/// One point of each of some axes.
type Combination<'a> = Vec<(&'a Axis, AxisPoint)>;

/// Returns the combinations of axis points for a row; one empty combination for a plain row.
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

/// Returns the folder of a scene as `data.dir` names it: empty for the built-in ones, and `builtin:17` by number.
pub(super) fn scene_folder(scene: &str, data_root: Option<&Path>) -> PathBuf {
    match BuiltinScene::named(scene) {
        Some(builtin) => PathBuf::from(builtin.settings().0),
        None => data_root.map_or_else(|| PathBuf::from(scene), |root| root.join(scene)),
    }
}

/// Returns why a configuration's scene is missing, or `None`. A scene that exists but is damaged makes its points fail
/// instead.
pub(super) fn missing(config: &Config) -> Option<String> {
    reason_of(config, &locate_scene(config.clone()))
}

fn reason_of<T>(config: &Config, located: &Result<T>) -> Option<String> {
    match located {
        Err(Error::Data(message)) if !Path::new(&config.data.dir).exists() => Some(message.clone()),
        _ => None,
    }
}

/// Returns an error if the budget does not count what the method does.
fn check_budget(kind: BudgetKind, config: &Config) -> Result<()> {
    if kind == BudgetKind::Seconds || config.method.has_fields() {
        return Ok(());
    }
    Err(Error::Config(format!(
        "budget.kind = \"evaluations\" counts passes through a field's network at points, and method {} has none; \
         set budget.kind = \"seconds\"",
        config.method.name()
    )))
}

struct Builder<'a> {
    definition: &'a Definition,
    preset: Preset,
    scene: &'a str,
    folder: PathBuf,
    seed: u64,
}

impl Builder<'_> {
    fn lay(&self, row: &Row, axes: &Combination) -> Result<PlannedRun> {
        let config = self.plain_config(row, axes)?;
        if let Some(metric) = self.definition.metric_in(Scope::Surface).filter(|_| !config.eval.mesh.is_compared()) {
            let message = format!(
                "metric '{}' needs a surface and a reference mesh, but eval.mesh.resolution is 0 and \
                 eval.mesh.reference is \"none\"; set the resolution to the number of cells along each side of the box, such as \
                 128",
                metric.key
            );
            return Err(Error::Config(message));
        }
        let located = locate_scene(config.clone());
        let located = match located {
            Err(error) if error.is_of_settings() => return Err(error),
            located => located,
        };
        let budget = row.budget.as_ref().or(self.definition.budget.as_ref()).filter(|budget| budget.like != row.name);
        let budget = budget.map(|budget| {
            let other = self.definition.row.iter().find(|row| row.name == budget.like).expect("checked");
            check_budget(budget.kind, &config)?;
            let like = self.plain_config(other, &Vec::new());
            let like = like.and_then(|like| check_budget(budget.kind, &like).map(|()| like));
            let like = like.map_err(|error| error.within(&format!("its budget.like, row '{}'", other.name)))?;
            Ok::<_, Error>((budget.kind, like))
        });
        let (budget, no_data) = (budget.transpose()?, reason_of(&config, &located));
        let decay_steps = located.ok().and_then(|config| config.train.decay_steps);
        let point = Point {
            id: String::new(),
            scene: scene_name(self.scene).to_string(),
            source: self.scene.to_string(),
            config,
            places: vec![TablePosition { row: row.name.clone(), axes: named(axes) }],
            on_cpu: row.device.is_some(),
            without_budget: budget.is_some() && decay_steps.is_none(),
            no_data,
        };
        Ok(PlannedRun { point, budget, decay_steps })
    }

    fn plain_config(&self, row: &Row, axes: &Combination) -> Result<Config> {
        let preset = row.preset.as_deref().map_or(Ok(self.preset), Preset::parse)?;
        let mut assignments: Vec<(Vec<String>, Value)> = Vec::new();
        let mut wrong = None;
        // A table has no order: its levels come before its passes, which they must not contradict.
        let leaves = |set| {
            let mut leaves = leaves(set);
            leaves.sort_by_key(|(key, _)| key != "perturb.levels");
            leaves
        };
        let mut assign = |origin: &str, key: &str, value: &Value| {
            let path: Vec<String> = key.split('.').map(String::from).collect();
            wrong = wrong.take().or_else(|| check_assignment(origin, &path, value).err());
            assignments.push((path, value.clone()));
        };
        for (key, value) in leaves(&self.definition.set) {
            assign(self.definition.origin_of(&key), &key, value);
        }
        for (key, value) in self.definition.settings_of_scene(self.scene).flat_map(leaves) {
            assign("by_scene", &key, value);
        }
        // By the seed itself, not by its position in the list: the same for any seeds of a command line.
        for (key, values) in &self.definition.by_seed {
            assign("by_seed", key, &values[(self.seed % values.len() as u64) as usize]);
        }
        leaves(&row.set).into_iter().for_each(|(key, value)| assign("its set:", &key, value));
        for (axis, point) in axes {
            let origin = format!("axis '{}':", axis.name);
            leaves(&axis.set).into_iter().for_each(|(key, value)| assign(&origin, &key, value));
            point.sets.iter().for_each(|(key, value)| assign(&origin, key, value));
        }
        match BuiltinScene::named(self.scene) {
            Some(BuiltinScene { kind: DataKind::BuiltinBlender, seed: None }) => {}
            Some(BuiltinScene { kind, seed: None }) => assign("scenes", "data.kind", &kind.name().into()),
            _ => assign("scenes", "data.dir", &self.folder.to_string_lossy().into_owned().into()),
        }
        assign("seeds", "seed", &(self.seed as i64).into());
        if let Some(error) = wrong {
            return Err(error);
        }
        let config = build(Some(preset), None, &assignments).map_err(|error| self.with_tip(error))?;
        // Also where the scene is not there yet.
        config.regularizer.check_lattice()?;
        Ok(config)
    }

    /// Adds the sweep for small networks to an error in the layer, where the command line named the preset.
    fn with_tip(&self, error: Error) -> Error {
        let text = error.to_string();
        if !(self.definition.is_preset_changed() && text.contains("perturb.injection_layer")) {
            return error;
        }
        Error::Config(format!(
            "{text}; preset {} has fewer layers than this sweep is for, `augnerf sweep run fig_embedded` is for small networks",
            self.definition.preset
        ))
    }
}
