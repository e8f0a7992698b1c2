//! A sweep as its file describes it: shared settings, named rows, axes, seeds and scenes.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::base::{Error, Result};

use super::axes::Axis;
use super::extends;
use crate::metrics::{Backbone, Metric, PSNR, SSIM, Scope};
use crate::report::{AxisValue, PublishedKey, RowSpec};
use crate::settings::{BuiltinScene, leaves};

/// A sweep file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Definition {
    /// The question that the table answers, in one line.
    pub title: String,
    /// Preset that points start from, unless their row names another.
    pub preset: String,
    /// Scene folders below the data root, or `builtin`, `builtin-forward`, either with a number: `builtin:17`.
    pub scenes: Vec<String>,
    /// Every row is trained once with each seed, on each scene, with each combination of axes.
    pub seeds: Vec<u64>,
    /// The table's metrics, the most important first.
    #[serde(default = "default_metrics")]
    pub metrics: Vec<String>,
    /// The row that others are compared with, seed by seed. A row may name another.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub baseline: Option<String>,
    /// The table of the paper to compare with: `tab4`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub published: Option<String>,
    /// Condition of the published rows: `clean`, `gaussian_noise`, ...
    #[serde(default = "clean")]
    pub condition: String,
    /// Published methods that this program does not have. Their rows hold the paper's numbers only.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub quoted: Vec<String>,
    /// How axes combine.
    #[serde(default)]
    pub combine: Combine,
    /// Per metric, the largest difference to a baseline that counts as equivalent, in the metric's unit.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub equivalence: BTreeMap<String, f64>,
    /// The cost that rows share, in place of the number of steps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<Budget>,
    /// Settings of every point, by their dotted names. They override the preset.
    #[serde(default)]
    pub set: Table,
    /// Settings that depend on the seed, each a list: a seed takes entry number `seed mod length`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub by_seed: BTreeMap<String, Vec<Value>>,
    /// Settings of single scenes, by the scene's name here or in tables.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub by_scene: BTreeMap<String, Table>,
    /// What the command line changed, `preset` and settings. The title may describe the file's values.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub changed: BTreeMap<String, Value>,
    /// The rows, in the table's order.
    #[serde(default)]
    pub row: Vec<Row>,
    /// The axes that rows are varied along.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub axis: Vec<Axis>,
}

fn default_metrics() -> Vec<String> {
    [&PSNR, &SSIM, Backbone::Squeeze.lpips()].map(|metric| metric.key.to_string()).to_vec()
}

fn clean() -> String {
    "clean".into()
}

/// How axes combine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Combine {
    /// Every value of every axis, with every value of the others.
    #[default]
    Product,
    /// One axis at a time; the others keep the row's values.
    OneAtATime,
}

/// Rows of equal cost. Each row gets as many steps as cost what all steps of `like` cost. Its learning rate falls over
/// these steps as it would over the row's own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Budget {
    /// The quantity that is equal.
    #[serde(default)]
    pub kind: BudgetKind,
    /// The row whose `train.steps` sets the budget.
    pub like: String,
}

/// The quantity that rows of equal budget share.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BudgetKind {
    /// Network evaluations: forward or backward passes through a network at one point. They do not depend on the
    /// machine.
    #[default]
    Evaluations,
    /// Wall time of the steps, measured on the machine that starts the sweep.
    Seconds,
}

/// One row of the table: its differences from the shared settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Row {
    /// The name in the table.
    pub name: String,
    /// Preset of this row, in place of the sweep's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub preset: Option<String>,
    /// Settings by their dotted names.
    #[serde(default)]
    pub set: Table,
    /// The paper does not have this row.
    #[serde(default, skip_serializing_if = "is_false")]
    pub ours: bool,
    /// The paper's name of the row, if it differs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub published: Option<String>,
    /// Condition of the published row, if it differs from the sweep's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub condition: Option<String>,
    /// The row that this one is compared with, in place of the sweep's baseline.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub baseline: Option<String>,
    /// If `false`, the row has one point only and no axis applies, as a reference line.
    #[serde(default = "yes", skip_serializing_if = "is_true")]
    pub axes: bool,
    /// Axes of this row, in place of the sweep's.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub axis: Vec<Axis>,
    /// Budget of this row, in place of the sweep's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<Budget>,
    /// `cpu`: the row runs on the processor, which trains all methods, whatever the command line says.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
}

/// The device that a row can name.
pub(super) const CPU: &str = "cpu";

fn yes() -> bool {
    true
}

fn is_true(value: &bool) -> bool {
    *value
}

pub(super) fn is_false(value: &bool) -> bool {
    !*value
}

/// Names of what the command line changes beside settings.
const PRESET: &str = "preset";
const SCENES: &str = "scenes";
const SEEDS: &str = "seeds";

/// Changes to a definition from the command line.
#[derive(Clone, Debug, Default)]
pub struct Overrides {
    /// Preset in place of the file's.
    pub preset: Option<String>,
    /// Scenes in place of the file's.
    pub scenes: Option<Vec<String>>,
    /// Seeds in place of the file's.
    pub seeds: Option<Vec<u64>>,
    /// Settings for all points. Rows and axes override them.
    pub set: Vec<(Vec<String>, Value)>,
}

impl Definition {
    /// Returns the first of the metrics in this scope.
    pub fn metric_in(&self, scope: Scope) -> Option<&'static Metric> {
        self.metrics.iter().filter_map(|key| Metric::find(key)).find(|metric| metric.scope == scope)
    }

    /// Reads a sweep file, merged with the file that it extends, and checks what can be checked without
    /// configurations.
    pub fn read(path: &Path) -> Result<Definition> {
        let table = extends::read(path)?;
        checked(Value::Table(table).try_into(), &path.display().to_string())
    }

    /// Parses a definition that extends no other; `origin` names it in messages.
    pub fn parse(text: &str, origin: &str) -> Result<Definition> {
        checked(toml::from_str(text), origin)
    }

    /// Returns the definition as TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a definition is plain data")
    }

    /// Applies the changes of the command line.
    pub fn apply(&mut self, overrides: Overrides) -> Result<()> {
        if let Some(preset) = overrides.preset.filter(|preset| *preset != self.preset) {
            self.changed.insert(PRESET.into(), preset.as_str().into());
            self.preset = preset;
        }
        if let Some(scenes) = overrides.scenes.filter(|scenes| *scenes != self.scenes) {
            self.changed.insert(SCENES.into(), scenes.clone().into());
            self.scenes = scenes;
            self.by_scene.retain(|name, _| self.scenes.iter().any(|scene| is_named(scene, name)));
        }
        if let Some(seeds) = overrides.seeds.filter(|seeds| *seeds != self.seeds) {
            let values = seeds.iter().map(|seed| i64::try_from(*seed).unwrap_or(i64::MAX));
            self.changed.insert(SEEDS.into(), values.collect::<Vec<_>>().into());
            self.seeds = seeds;
        }
        for (path, value) in overrides.set {
            let name = path.join(".");
            if self.set.get(&name) != Some(&value) {
                self.changed.insert(name.clone(), value.clone());
            }
            self.by_seed.remove(&name);
            self.by_scene.values_mut().for_each(|set| remove(set, &path));
            self.set.insert(name, value);
        }
        self.check().map_err(Error::Config)
    }

    /// Returns the settings of a scene alone.
    pub(super) fn settings_of_scene(&self, scene: &str) -> impl Iterator<Item = &Table> {
        self.by_scene.iter().filter(move |(name, _)| is_named(scene, name)).map(|(_, set)| set)
    }

    /// Returns the names of settings that go with the scene or the seed.
    pub(super) fn own_settings(&self) -> Vec<String> {
        let of_scenes = self.by_scene.values().flat_map(leaves).map(|(name, _)| name);
        self.by_seed.keys().cloned().chain(of_scenes).collect()
    }

    /// Returns whether the command line named another preset than the file.
    pub fn is_preset_changed(&self) -> bool {
        self.changed.contains_key(PRESET)
    }

    /// Returns where the setting of all rows comes from: the command line or the file.
    pub(super) fn origin_of(&self, name: &str) -> &'static str {
        if self.changed.contains_key(name) { "--set" } else { "[set]" }
    }

    /// Returns the title with the command line's changes: `Ablation, 3,000 steps (with train.steps = 20)`.
    pub(super) fn full_title(&self) -> String {
        match self.changed_text().as_str() {
            "" => self.title.clone(),
            changed => format!("{} (with {changed})", self.title),
        }
    }

    /// Returns the settings that were changed for all rows: `data.width = 24, train.steps = 20`. Tables show their
    /// scenes and seeds.
    pub(super) fn changed_text(&self) -> String {
        let changed = self.changed.iter().filter(|(name, _)| ![SCENES, SEEDS].contains(&name.as_str()));
        changed.map(|(name, value)| format!("{name} = {value}")).collect::<Vec<String>>().join(", ")
    }

    /// Returns the row that a row is compared with, or `None` for a baseline.
    fn baseline_of(&self, row: &Row) -> Option<String> {
        let named = row.baseline.as_ref().or(self.baseline.as_ref())?;
        (*named != row.name).then(|| named.clone())
    }

    /// Returns the axes of a row.
    pub fn axes_of<'a>(&'a self, row: &'a Row) -> &'a [Axis] {
        match (row.axes, row.axis.is_empty()) {
            (false, _) => &[],
            (true, true) => &self.axis,
            (true, false) => &row.axis,
        }
    }

    /// Returns the sweep's axes, then those of rows.
    pub(super) fn all_axes(&self) -> impl Iterator<Item = &Axis> {
        self.axis.iter().chain(self.row.iter().flat_map(|row| &row.axis))
    }

    /// Returns, for each value, its axis (the first with this value) and its position there, in the definition's
    /// order.
    pub(super) fn axis_positions(&self) -> HashMap<AxisValue, (usize, usize)> {
        let mut positions = HashMap::new();
        for (index, axis) in self.all_axes().enumerate() {
            for (place, point) in axis.points().unwrap_or_default().iter().enumerate() {
                positions.entry(axis.named(point)).or_insert((index, place));
            }
        }
        positions
    }

    /// Returns the rows as tables need them, the quoted ones first.
    pub fn rows(&self) -> Vec<RowSpec> {
        let key = |condition: Option<&String>, method: &str| {
            self.published.clone().map(|table| PublishedKey {
                table,
                condition: condition.unwrap_or(&self.condition).clone(),
                method: method.to_string(),
            })
        };
        let quoted = self.quoted.iter().map(|method| RowSpec {
            name: method.clone(),
            quoted: true,
            published: key(None, method),
            ..RowSpec::default()
        });
        let rows = self.row.iter().map(|row| RowSpec {
            name: row.name.clone(),
            baseline: self.baseline_of(row),
            ours: row.ours,
            quoted: false,
            names_device: row.device.is_some(),
            published: key(row.condition.as_ref(), row.published.as_ref().unwrap_or(&row.name)).filter(|_| !row.ours),
        });
        quoted.chain(rows).collect()
    }
}

fn checked(parsed: std::result::Result<Definition, toml::de::Error>, origin: &str) -> Result<Definition> {
    let in_file = |message: String| Error::Config(format!("{origin}: {message}"));
    let definition = parsed.map_err(|e| in_file(e.to_string()))?;
    definition.check().map_err(in_file)?;
    Ok(definition)
}

/// Removes a setting, by its dotted name in quotes or from nested tables.
fn remove(set: &mut Table, path: &[String]) {
    set.remove(&path.join("."));
    if let [first, rest @ ..] = path
        && let Some(Value::Table(inner)) = set.get_mut(first)
    {
        remove(inner, rest);
    }
}

/// Returns whether a scene has this name, in the definition or in tables.
pub(super) fn is_named(scene: &str, name: &str) -> bool {
    scene == name || scene_name(scene) == name
}

/// Returns the name of a scene in tables: the last component of its folder, or the built-in scene's.
pub(super) fn scene_name(scene: &str) -> String {
    match BuiltinScene::named(scene) {
        Some(builtin) if builtin.seed.is_some() => builtin.label(),
        Some(builtin) => builtin.to_string(),
        None => scene.trim_end_matches('/').rsplit('/').next().unwrap_or(scene).to_string(),
    }
}
