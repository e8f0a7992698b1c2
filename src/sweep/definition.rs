//! A sweep as its file describes it: what all points share, named rows, axes, seeds, scenes.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::base::{Error, Result};

use super::axes::Axis;
use super::extends;
use crate::metrics::{Metric, Scope};
use crate::report::{AxisValue, PublishedKey, RowSpec};

/// More points than anyone means.
const MOST_POINTS: usize = 10_000;

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
    pub kind: BudgetKind,
    /// The row whose `train.steps` sets the budget.
    pub like: String,
}

/// What rows of equal budget have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BudgetKind {
    /// Network evaluations: passes forward or back through a network at one point.
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
        if let Some(preset) = overrides.preset {
            self.preset = preset;
        }
        if let Some(scenes) = overrides.scenes {
            self.scenes = scenes;
        }
        if let Some(seeds) = overrides.seeds {
            self.seeds = seeds;
        }
        for (path, value) in overrides.set {
            self.set.insert(path.join("."), value);
        }
        self.check().map_err(Error::Config)
    }

    fn check(&self) -> std::result::Result<(), String> {
        self.check_lists()?;
        self.check_references()?;
        self.check_margins()?;
        self.all_axes().try_for_each(check_axis)?;
        self.check_words()?;
        if let Some(row) = self.row.iter().find(|row| !row.axes && !row.axis.is_empty()) {
            return Err(format!("row '{}' has axes of its own and axes = false; remove one of them", row.name));
        }
        self.rows()
            .iter()
            .filter_map(|row| Some((row, row.published.as_ref()?)))
            .try_for_each(|(row, key)| key.check().map_err(|message| format!("row '{}' {message}", row.name)))?;
        let count = self.count();
        if count > MOST_POINTS {
            return Err(format!(
                "{count} points ({} scenes x {} seeds x rows and axes) are more than {MOST_POINTS}: split the sweep, or \
                 set combine = \"one-at-a-time\"",
                self.scenes.len(),
                self.seeds.len()
            ));
        }
        Ok(())
    }

    /// Scenes, seeds, metrics and rows are there, each once.
    fn check_lists(&self) -> std::result::Result<(), String> {
        let scenes: Vec<&str> = self.scenes.iter().map(|scene| scene_name(scene)).collect();
        not_empty_and_distinct("scenes", &scenes)?;
        not_empty_and_distinct("seeds", &self.seeds)?;
        if let Some(seed) = self.seeds.iter().find(|seed| i64::try_from(**seed).is_err()) {
            return Err(format!("seeds: {seed} is out of range: a seed is at most 2^63 - 1"));
        }
        not_empty_and_distinct("metrics", &self.metrics)?;
        let names: Vec<&str> = self.row.iter().map(|row| row.name.as_str()).collect();
        not_empty_and_distinct("rows", &names)?;
        if let Some(row) = names.iter().find(|name| name.trim().is_empty()) {
            return Err(format!("a row's name is '{row}'; give it the name that the table prints"));
        }
        let exists = |key: &String| Metric::in_tables().any(|metric| metric.key == key);
        if let Some(key) = self.metrics.iter().find(|key| !exists(key)) {
            let known: Vec<&str> = Metric::in_tables().map(|metric| metric.key).collect();
            return Err(format!("metric '{key}' does not exist; choose from {}", known.join(", ")));
        }
        Ok(())
    }

    /// What is named as a row is one.
    fn check_references(&self) -> std::result::Result<(), String> {
        let names: Vec<&str> = self.row.iter().map(|row| row.name.as_str()).collect();
        let known = |what: &str, name: &str| match names.contains(&name) {
            true => Ok(()),
            false => Err(format!("{what} = '{name}' is no row; the rows are {}", names.join(", "))),
        };
        if let Some(baseline) = &self.baseline {
            known("baseline", baseline)?;
        }
        if let Some(budget) = &self.budget {
            known("budget.like", &budget.like)?;
        }
        if !self.quoted.is_empty() && self.published.is_none() {
            return Err("quoted names methods of a published table; say which with published = \"tab1\"".into());
        }
        if let Some(quoted) = self.quoted.iter().find(|quoted| names.contains(&quoted.as_str())) {
            return Err(format!("quoted = '{quoted}' is a row that is run; remove one of them"));
        }
        for row in &self.row {
            if let Some(baseline) = &row.baseline {
                known(&format!("the baseline of row '{}'", row.name), baseline)?;
            }
            if let Some(budget) = &row.budget {
                known(&format!("budget.like of row '{}'", row.name), &budget.like)?;
            }
        }
        Ok(())
    }

    /// Points before equal ones are merged.
    fn count(&self) -> usize {
        let of_axes = |axes: &[Axis]| {
            let mut values = axes.iter().map(|axis| axis.points().map_or(0, |points| points.len()));
            match self.combine {
                Combine::Product => values.fold(1, usize::saturating_mul),
                Combine::OneAtATime => values.by_ref().sum::<usize>().max(1),
            }
        };
        let of_rows = self.row.iter().map(|row| of_axes(self.axes_of(row))).fold(0, usize::saturating_add);
        of_rows.saturating_mul(self.scenes.len()).saturating_mul(self.seeds.len())
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

    /// Which axis a value is of, and where on it: the definition's order.
    pub(super) fn axis_position(&self, named: &AxisValue) -> Option<(usize, usize)> {
        let on = |axis: &Axis| axis.points().ok()?.iter().position(|point| axis.named(point) == *named);
        self.all_axes().enumerate().find_map(|(index, axis)| Some((index, on(axis)?)))
    }

    /// The rows as tables know them, those that are quoted first.
    pub(super) fn rows(&self) -> Vec<RowSpec> {
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

fn check_axis(axis: &Axis) -> std::result::Result<(), String> {
    let panel = if axis.panel.is_empty() { String::new() } else { format!(" of '{}'", axis.panel) };
    let what = format!("axis '{}'{panel}", axis.name);
    not_empty_and_distinct(&format!("keys of {what}"), &axis.keys)?;
    let points = axis.points().map_err(|message| format!("{what}: {message}"))?;
    let labels: Vec<&str> = points.iter().map(|point| point.label.as_str()).collect();
    not_empty_and_distinct(&format!("values of {what}"), &labels)
}

fn not_empty_and_distinct<T: PartialEq + std::fmt::Display>(
    what: &str,
    values: &[T],
) -> std::result::Result<(), String> {
    if values.is_empty() {
        return Err(format!("{what}: there are none; name at least one"));
    }
    let twice = values.iter().enumerate().find(|(i, value)| values[..*i].contains(value));
    twice.map_or(Ok(()), |(_, value)| Err(format!("{what}: '{value}' is named twice")))
}
