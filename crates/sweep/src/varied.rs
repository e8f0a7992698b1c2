//! What a sweep varies, as columns of numbers: its axes, and the settings in which its points differ.

use std::collections::HashMap;

use toml::{Table, Value};

use crate::report::AxisValue;
use crate::report::tables::attack_numbers;
use crate::settings::columns::{AXIS, COLUMNS, SETTING, applies};
use crate::settings::registry::{Effect, REGISTRY};
use crate::settings::{Config, value_at};

use super::definition::Definition;
use super::points::Point;

/// Ends of the settings of a site's PGD numbers.
const NUMBERS: [&str; 3] = [".steps", ".step_size", ".epsilon"];

/// The settings in which the points of a sweep differ, but for the scene, the seed and what these bring with them.
///
/// Each with the most values that a point has of it, if it is a list.
pub struct Varied(Vec<(&'static str, usize)>);

impl Varied {
    /// Finds them.
    pub fn of(definition: &Definition, points: &[Point]) -> Varied {
        let tables: Vec<Table> = points.iter().map(|point| point.config.to_table()).collect();
        let differs = |path: &&str| {
            let mut values = tables.iter().map(|table| value_at(table, path));
            let first = values.next().flatten();
            values.any(|value| value != first)
        };
        let of_seed = |path: &str| path == "seed" || definition.by_seed.contains_key(path);
        // A setting of one scene may still be what rows or axes vary.
        let varies_in_scene = |path: &str| {
            let mut firsts = HashMap::new();
            points.iter().zip(&tables).any(|(point, table)| {
                let value = value_at(table, path);
                *firsts.entry(point.scene.as_str()).or_insert(value) != value
            })
        };
        let own = definition.own_settings();
        let of_scene = |path: &str| own.iter().any(|name| name == path) && !varies_in_scene(path);
        let settings = REGISTRY.settings.iter().filter(|setting| setting.rule.effect == Effect::Numbers);
        let paths = settings.map(|setting| setting.path.as_str());
        let paths = paths.filter(|path| !of_seed(path) && !of_scene(path) && *path != "data.name");
        let parts = |path: &'static str| {
            let lengths = tables.iter().filter_map(|table| value_at(table, path)?.as_array().map(Vec::len));
            (path, lengths.max().unwrap_or(0))
        };
        Varied(paths.filter(differs).map(parts).collect())
    }

    /// Returns a point's columns: `axis.weight`, `set.regularizer.weight`. With the `protocol` of its run, settings have the
    /// values that the run used, and none where the run does not read them. Otherwise they are those of the configuration,
    /// empty for defaults.
    pub fn columns(
        &self,
        point: &Point,
        axes: &[AxisValue],
        protocol: Option<&[(String, String)]>,
    ) -> Vec<(String, String)> {
        let axis = |AxisValue { axis, panel, value }: &AxisValue| {
            let space = if panel.is_empty() { "" } else { " " };
            (format!("{AXIS}{panel}{space}{axis}").replace(char::is_whitespace, "_"), value.clone())
        };
        let table = point.config.to_table();
        let setting = |(path, parts): &(&str, usize)| -> Vec<(String, String)> {
            let value = value_at(&table, path);
            match parts {
                0 | 1 => {
                    let used = protocol.and_then(|protocol| used(path, &point.config, protocol));
                    vec![(format!("{SETTING}{path}"), used.unwrap_or_else(|| value.map_or(String::new(), text)))]
                }
                parts => (0..*parts)
                    .map(|part| {
                        let value = value.and_then(Value::as_array).and_then(|values| values.get(part));
                        (format!("{SETTING}{path}.{part}"), value.map_or(String::new(), text))
                    })
                    .collect(),
            }
        };
        axes.iter().map(axis).chain(self.0.iter().flat_map(setting)).collect()
    }
}

/// Returns the value of a setting that a run used, empty if it does not read it, or `None` if that of the configuration is it.
fn used(path: &str, config: &Config, protocol: &[(String, String)]) -> Option<String> {
    let of = |name: &str| protocol.iter().find(|(known, _)| known == name).map(|(_, text)| text.as_str());
    let is_number = path.starts_with("perturb.") && NUMBERS.iter().any(|number| path.ends_with(number));
    if let Some(numbers) = of("attack_numbers").filter(|_| is_number) {
        let own = attack_numbers(numbers).into_iter().find(|(name, _)| name == path);
        return Some(own.map_or(String::new(), |(_, number)| number));
    }
    let setting = REGISTRY.settings.iter().find(|setting| setting.path == path)?;
    let own = setting.rule.column.and_then(of).map(String::from);
    let mut columns = COLUMNS.iter().filter(|column| column.follows(setting)).peekable();
    let is_read = columns.peek().is_none() || columns.any(|column| applies(column, config));
    own.or_else(|| (!is_read).then(String::new))
}

/// A value as a cell: numbers and words as they are; a list of one as its only value, an empty list as nothing.
fn text(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Array(values) if values.len() < 2 => values.first().map_or(String::new(), text),
        other => other.to_string(),
    }
}
