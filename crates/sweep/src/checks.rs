//! Checks of a definition, before its configurations are built.

use std::collections::HashSet;
use std::hash::Hash;

use super::axes::Axis;
use toml::{Table, Value};

use super::definition::{Budget, BudgetKind, CPU, Combine, Definition, Row, is_named, scene_name};
use super::words::quoted;
use crate::metrics::Metric;
use crate::settings::Method;

/// Most points of a sweep.
const MOST_POINTS: usize = 10_000;

impl Definition {
    /// Checks what can be checked without configurations.
    pub(super) fn check(&self) -> std::result::Result<(), String> {
        // The size first, so that no later check has to handle huge lists.
        self.check_size()?;
        self.check_lists()?;
        self.check_references()?;
        self.check_margins()?;
        self.all_axes().try_for_each(check_axis)?;
        self.check_words()?;
        if let Some(row) = self.row.iter().find(|row| !row.axes && !row.axis.is_empty()) {
            return Err(format!("row '{}' has its own axes and axes = false; remove one", row.name));
        }
        self.check_published()?;
        self.rows()
            .iter()
            .filter_map(|row| Some((row, row.published.as_ref()?)))
            .try_for_each(|(row, key)| key.check().map_err(|message| format!("row '{}': {message}", row.name)))
    }

    /// Returns an error for a row that trains LLFF on its scene and is called the published method.
    fn check_published(&self) -> std::result::Result<(), String> {
        let method = |set: &Table| set.get("method").and_then(Value::as_str).map(str::to_string);
        let common = method(&self.set);
        let is_llff = |row: &Row| method(&row.set).or_else(|| common.clone()).as_deref() == Some(Method::Llff.name());
        match self.row.iter().find(|row| self.published.is_some() && !row.ours && is_llff(row)) {
            Some(row) => Err(format!(
                "row '{}' trains LLFF on this scene, but the published LLFF was trained on others; set ours = true and give it another name \
                 (quoted = [\"LLFF\"] is the paper's)",
                row.name
            )),
            None => Ok(()),
        }
    }

    /// Checks that the product of all lists is not too long.
    fn check_size(&self) -> std::result::Result<(), String> {
        let (count, scenes, seeds) = (self.count(), self.scenes.len(), self.seeds.len());
        match count > MOST_POINTS {
            true => Err(format!(
                "{count} points ({scenes} scenes x {seeds} seeds x rows and axes) are more than {MOST_POINTS}; split the \
                 sweep, or set combine = \"one-at-a-time\""
            )),
            false => Ok(()),
        }
    }

    /// Checks that scenes, seeds, metrics and rows exist, each once.
    fn check_lists(&self) -> std::result::Result<(), String> {
        let scenes: Vec<String> = self.scenes.iter().map(|scene| scene_name(scene)).collect();
        not_empty_and_distinct("scenes", &scenes)?;
        not_empty_and_distinct("seeds", &self.seeds)?;
        if let Some(seed) = self.seeds.iter().find(|seed| i64::try_from(**seed).is_err()) {
            return Err(format!("seeds: {seed} is out of range: a seed is at most 2^63 - 1"));
        }
        if let Some((key, _)) = self.by_seed.iter().find(|(_, values)| values.is_empty()) {
            return Err(format!("by_seed.\"{key}\": the list is empty; give at least one value"));
        }
        if let Some(unknown) = self.by_scene.keys().find(|name| !self.scenes.iter().any(|scene| is_named(scene, name)))
        {
            return Err(format!(
                "by_scene.\"{unknown}\": this is not a scene; the scenes are {}",
                self.scenes.join(", ")
            ));
        }
        if let Some(scene) = self.scenes.iter().find(|scene| self.settings_of_scene(scene).count() > 1) {
            return Err(format!("by_scene has settings of scene '{scene}' under two names; join them"));
        }
        not_empty_and_distinct("metrics", &self.metrics)?;
        let names: Vec<&str> = self.row.iter().map(|row| row.name.as_str()).collect();
        not_empty_and_distinct("rows", &names)?;
        if let Some(row) = names.iter().find(|name| name.trim().is_empty()) {
            return Err(format!("a row's name is blank ('{row}'); give it the name for the table"));
        }
        let exists = |key: &String| Metric::in_tables().any(|metric| metric.key == key);
        if let Some(key) = self.metrics.iter().find(|key| !exists(key)) {
            let known: Vec<&str> = Metric::in_tables().map(|metric| metric.key).collect();
            return Err(format!("unknown metric '{key}'; choose from {}", known.join(", ")));
        }
        Ok(())
    }

    /// Checks that references to rows name existing rows.
    fn check_references(&self) -> std::result::Result<(), String> {
        let names: Vec<&str> = self.row.iter().map(|row| row.name.as_str()).collect();
        let set: HashSet<&str> = names.iter().copied().collect();
        let known = |what: &str, name: &str| match set.contains(name) {
            true => Ok(()),
            false => Err(format!("{what} = '{name}' is not a row; the rows are {}", quoted(&names))),
        };
        if let Some(baseline) = &self.baseline {
            known("baseline", baseline)?;
        }
        if let Some(budget) = &self.budget {
            known("budget.like", &budget.like)?;
        }
        if !self.quoted.is_empty() && self.published.is_none() {
            return Err("quoted needs the table that it quotes; set published, such as published = \"tab1\"".into());
        }
        if let Some(quoted) = self.quoted.iter().find(|quoted| set.contains(quoted.as_str())) {
            return Err(format!("quoted = '{quoted}' is also a row that is run; remove one"));
        }
        for row in &self.row {
            if let Some(baseline) = &row.baseline {
                known(&format!("the baseline of row '{}'", row.name), baseline)?;
            }
            if let Some(budget) = &row.budget {
                known(&format!("budget.like of row '{}'", row.name), &budget.like)?;
            }
            if let Some(device) = row.device.as_ref().filter(|device| *device != CPU) {
                return Err(format!(
                    "row '{}': device = \"{device}\": a row can only name \"{CPU}\"; --device chooses that of the others",
                    row.name
                ));
            }
            let budget = row.budget.as_ref().or(self.budget.as_ref()).filter(|budget| budget.like != row.name);
            if let Some(Budget { kind: BudgetKind::Seconds, like }) = budget
                && let Some(other) =
                    self.row.iter().find(|other| [&row.name, like].contains(&&other.name) && other.device.is_some())
            {
                return Err(format!(
                    "row '{}' gets the seconds of row '{like}', which are measured on the device of the command line, but row \
                     '{}' names its own; remove that device or the budget",
                    row.name, other.name
                ));
            }
        }
        Ok(())
    }

    /// Returns the number of points before equal ones are merged. An empty list, an error of its own, counts as 1.
    fn count(&self) -> usize {
        let of_axes = |axes: &[Axis]| {
            let values = axes.iter().map(|axis| axis.count().max(1));
            match self.combine {
                Combine::Product => values.fold(1, usize::saturating_mul),
                Combine::OneAtATime => values.fold(0, usize::saturating_add).max(1),
            }
        };
        let of_rows = self.row.iter().map(|row| of_axes(self.axes_of(row))).fold(0, usize::saturating_add);
        of_rows.saturating_mul(self.scenes.len().max(1)).saturating_mul(self.seeds.len().max(1))
    }
}

fn check_axis(axis: &Axis) -> std::result::Result<(), String> {
    let panel = if axis.panel.is_empty() { String::new() } else { format!(" of '{}'", axis.panel) };
    let what = format!("axis '{}'{panel}", axis.name);
    not_empty_and_distinct(&format!("keys of {what}"), &axis.keys)?;
    let points = axis.points().map_err(|message| format!("{what}: {message}"))?;
    let labels: Vec<&str> = points.iter().map(|point| point.label.as_str()).collect();
    not_empty_and_distinct(&format!("values of {what}"), &labels)
}

fn not_empty_and_distinct<T: Eq + Hash + std::fmt::Display>(
    what: &str,
    values: &[T],
) -> std::result::Result<(), String> {
    if values.is_empty() {
        return Err(format!("{what}: the list is empty; give at least one"));
    }
    let mut known = HashSet::new();
    let twice = values.iter().find(|value| !known.insert(*value));
    twice.map_or(Ok(()), |value| Err(format!("{what}: '{value}' is named twice")))
}
