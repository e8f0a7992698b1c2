//! A sweep as its file describes it: what all points share, named rows, axes, seeds, scenes.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::base::{Error, Result};

use super::axes::Axis;
use super::extends;
use crate::metrics::{Metric, Scope};
use crate::report::{AxisValue, PublishedKey, RowSpec};

/// A sweep file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Definition {
    /// What the table answers, one line.
    pub title: String,
    /// Settings that every point starts from.
    pub preset: String,
    /// Scene folders below the data root, or `builtin`, `builtin-forward`.
    pub scenes: Vec<String>,
    /// Every row is trained once with each.
    pub seeds: Vec<u64>,
    /// What the table shows, best first.
    #[serde(default = "default_metrics")]
    pub metrics: Vec<String>,
    /// The row that others are compared with, seed by seed; a row may name another.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub baseline: Option<String>,
    /// The table of the paper that this one answers: `tab4`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub published: Option<String>,
    /// Condition of the published rows: `clean`, `gaussian_noise`, ...
    #[serde(default = "clean")]
    pub condition: String,
    /// Methods that the published table has and this program has not: their rows carry the paper's numbers alone.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub quoted: Vec<String>,
    /// How axes combine.
    #[serde(default)]
    pub combine: Combine,
    /// Metrics with the largest difference to a baseline that counts as none, in the metric's unit.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub equivalence: BTreeMap<String, f64>,
    /// What rows have in common instead of steps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<Budget>,
    /// Settings of every point over the preset's, by their dotted names.
    #[serde(default)]
    pub set: Table,
    /// Settings that go with the seed, each a list: a seed takes its entry number `seed mod length`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub by_seed: BTreeMap<String, Vec<Value>>,
    /// What of these the command line said, `preset` and settings: the title may speak of what the file says.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub changed: BTreeMap<String, Value>,
    /// The table's rows, in its order.
    #[serde(default)]
    pub row: Vec<Row>,
    /// What is varied besides.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub axis: Vec<Axis>,
}

fn default_metrics() -> Vec<String> {
    ["psnr", "ssim", "lpips_squeeze"].map(String::from).to_vec()
}

fn clean() -> String {
    "clean".into()
}

/// How axes combine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Combine {
    /// Every value of every axis with every other.
    #[default]
    Product,
    /// One axis at a time, the others as the row has them.
    OneAtATime,
}

/// Rows of equal cost: each gets as many steps as `like` costs with its own, and its learning rate
/// falls over them as it would have over the row's own steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Budget {
    /// What is equal.
    #[serde(default)]
    pub kind: BudgetKind,
    /// The row whose `train.steps` sets the budget.
    pub like: String,
}

/// What rows of equal budget have in common.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BudgetKind {
    /// Network evaluations: passes forward or back through a network at one point. The same on every machine and day.
    #[default]
    Evaluations,
    /// Wall time of the steps, as measured on the machine that starts the sweep.
    Seconds,
}

/// One row of the table: a diff from what all points share.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Row {
    /// As the table prints it.
    pub name: String,
    /// Settings that the row starts from instead of the sweep's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub preset: Option<String>,
    /// Settings by their dotted names.
    #[serde(default)]
    pub set: Table,
    /// Not in the paper.
    #[serde(default, skip_serializing_if = "is_false")]
    pub ours: bool,
    /// The paper's name of the row, where it is another.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub published: Option<String>,
    /// Condition of the published row, where it is another than the sweep's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub condition: Option<String>,
    /// Compared with this row instead of the sweep's baseline.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub baseline: Option<String>,
    /// `false`: the row has one point whatever the axes say, as a line to compare with.
    #[serde(default = "yes", skip_serializing_if = "is_true")]
    pub axes: bool,
    /// What is varied of this row, instead of the sweep's axes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub axis: Vec<Axis>,
    /// A budget of its own instead of the sweep's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<Budget>,
}

fn yes() -> bool {
    true
}

fn is_true(value: &bool) -> bool {
    *value
}

fn is_false(value: &bool) -> bool {
    !*value
}

/// What the command line changes in a definition.
#[derive(Clone, Debug, Default)]
pub struct Overrides {
    /// Another preset.
    pub preset: Option<String>,
    /// Other scenes.
    pub scenes: Option<Vec<String>>,
    /// Other seeds.
    pub seeds: Option<Vec<u64>>,
    /// Further settings for all points, under what rows and axes set.
    pub set: Vec<(Vec<String>, Value)>,
}

impl Definition {
    /// The first of the metrics that is measured there.
    pub fn metric_in(&self, scope: Scope) -> Option<&'static Metric> {
        self.metrics.iter().filter_map(|key| Metric::find(key)).find(|metric| metric.scope == scope)
    }

    /// Reads a sweep file, over the one that it extends if it does, and checks it as far as that is
    /// possible without configurations.
    pub fn read(path: &Path) -> Result<Definition> {
        let table = extends::read(path)?;
        checked(Value::Table(table).try_into(), &path.display().to_string())
    }

    /// A definition from text that extends nothing; `origin` names it in messages.
    pub fn parse(text: &str, origin: &str) -> Result<Definition> {
        checked(toml::from_str(text), origin)
    }

    /// The definition as TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a definition is plain data")
    }

    /// Lays what the command line asks for over the file.
    pub fn apply(&mut self, overrides: Overrides) -> Result<()> {
        if let Some(preset) = overrides.preset.filter(|preset| *preset != self.preset) {
            self.changed.insert("preset".into(), preset.as_str().into());
            self.preset = preset;
        }
        if let Some(scenes) = overrides.scenes {
            self.scenes = scenes;
        }
        if let Some(seeds) = overrides.seeds {
            self.seeds = seeds;
        }
        for (path, value) in overrides.set {
            let name = path.join(".");
            if self.set.get(&name) != Some(&value) {
                self.changed.insert(name.clone(), value.clone());
            }
            self.by_seed.remove(&name);
            self.set.insert(name, value);
        }
        self.check().map_err(Error::Config)
    }

    /// The title with what the command line changed: `Ablation, 3,000 steps (with train.steps = 20)`.
    pub(super) fn full_title(&self) -> String {
        if self.changed.is_empty() {
            return self.title.clone();
        }
        let changed: Vec<String> = self.changed.iter().map(|(name, value)| format!("{name} = {value}")).collect();
        format!("{} (with {})", self.title, changed.join(", "))
    }

    /// The row that a row is compared with; none for a baseline.
    fn baseline_of(&self, row: &Row) -> Option<String> {
        let named = row.baseline.as_ref().or(self.baseline.as_ref())?;
        (*named != row.name).then(|| named.clone())
    }

    /// What is varied of a row.
    pub fn axes_of<'a>(&'a self, row: &'a Row) -> &'a [Axis] {
        match (row.axes, row.axis.is_empty()) {
            (false, _) => &[],
            (true, true) => &self.axis,
            (true, false) => &row.axis,
        }
    }

    /// The sweep's axes, then those of rows.
    pub(super) fn all_axes(&self) -> impl Iterator<Item = &Axis> {
        self.axis.iter().chain(self.row.iter().flat_map(|row| &row.axis))
    }

    /// Which axis each value is of, the first one that has it, and where on it: the definition's order.
    pub(super) fn axis_positions(&self) -> HashMap<AxisValue, (usize, usize)> {
        let mut positions = HashMap::new();
        for (index, axis) in self.all_axes().enumerate() {
            for (place, point) in axis.points().unwrap_or_default().iter().enumerate() {
                positions.entry(axis.named(point)).or_insert((index, place));
            }
        }
        positions
    }

    /// The rows as tables know them, those that are quoted first.
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
            scored: false,
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

/// The name of a scene in tables: its folder's last component.
pub(super) fn scene_name(scene: &str) -> &str {
    scene.trim_end_matches('/').rsplit('/').next().unwrap_or(scene)
}
