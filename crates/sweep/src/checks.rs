//! What a definition is refused for before its configurations are built.

use std::collections::HashSet;
use std::hash::Hash;

use super::axes::Axis;
use toml::{Table, Value};

use super::definition::{Combine, Definition, Row, scene_name};
use super::extends::MOST_POINTS;
use crate::metrics::Metric;
use crate::settings::Method;

impl Definition {
    /// Checks a definition as far as that is possible without configurations.
    pub(super) fn check(&self) -> std::result::Result<(), String> {
        // First, so that nothing below looks at more than anyone means.
        self.check_sizes()?;
        self.check_lists()?;
        self.check_references()?;
        self.check_margins()?;
        self.all_axes().try_for_each(check_axis)?;
        self.check_words()?;
        if let Some(row) = self.row.iter().find(|row| !row.axes && !row.axis.is_empty()) {
            return Err(format!("row '{}' has axes of its own and axes = false; remove one of them", row.name));
        }
        self.check_published()?;
        self.rows()
            .iter()
            .filter_map(|row| Some((row, row.published.as_ref()?)))
            .try_for_each(|(row, key)| key.check().map_err(|message| format!("row '{}' {message}", row.name)))
    }

    /// A row that trains LLFF on its scene is not the published method.
    fn check_published(&self) -> std::result::Result<(), String> {
        let method = |set: &Table| set.get("method").and_then(Value::as_str).map(str::to_string);
        let common = method(&self.set);
        let is_llff = |row: &Row| method(&row.set).or_else(|| common.clone()).as_deref() == Some(Method::Llff.name());
        match self.row.iter().find(|row| self.published.is_some() && !row.ours && is_llff(row)) {
            Some(row) => Err(format!(
                "row '{}' trains LLFF on the scene, and the published LLFF was trained on others: set ours = true, and name it otherwise \
                 (quoted = [\"LLFF\"] is the paper's)",
                row.name
            )),
            None => Ok(()),
        }
    }

    /// No list is longer than anyone means, nor is what they come to.
    fn check_sizes(&self) -> std::result::Result<(), String> {
        let (rows, seeds, scenes) = (self.row.len(), self.seeds.len(), self.scenes.len());
        let axes = self.all_axes().count();
        let lists = [
            ("seeds", seeds),
            ("scenes", scenes),
            ("rows", rows),
            ("axes", axes),
            ("metrics", self.metrics.len()),
            ("quoted", self.quoted.len()),
        ];
        if let Some((what, count)) = lists.into_iter().find(|(_, count)| *count > MOST_POINTS) {
            return Err(format!("{what}: {count} are more than {MOST_POINTS}: split the sweep"));
        }
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
        if let Some((key, _)) = self.by_seed.iter().find(|(_, values)| values.is_empty()) {
            return Err(format!("by_seed.\"{key}\": there are no values; list at least one"));
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
        let set: HashSet<&str> = names.iter().copied().collect();
        let known = |what: &str, name: &str| match set.contains(name) {
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
        if let Some(quoted) = self.quoted.iter().find(|quoted| set.contains(quoted.as_str())) {
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
            let values = axes.iter().map(Axis::count);
            match self.combine {
                Combine::Product => values.fold(1, usize::saturating_mul),
                Combine::OneAtATime => values.fold(0, usize::saturating_add).max(1),
            }
        };
        let of_rows = self.row.iter().map(|row| of_axes(self.axes_of(row))).fold(0, usize::saturating_add);
        of_rows.saturating_mul(self.scenes.len()).saturating_mul(self.seeds.len())
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
        return Err(format!("{what}: there are none; name at least one"));
    }
    let mut known = HashSet::new();
    let twice = values.iter().find(|value| !known.insert(*value));
    twice.map_or(Ok(()), |value| Err(format!("{what}: '{value}' is named twice")))
}
