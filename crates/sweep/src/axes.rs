//! Axes of a sweep: settings that vary together, and their values.

use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::report::{AxisParts, AxisValue};

/// One setting, or several that vary together. Its values are given by `values` or `zip`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axis {
    /// Name of the varied quantity, used as the x axis of the plot.
    pub name: String,
    /// The part that is varied, such as a site. Each panel of the plot shows one.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub panel: String,
    /// Dotted names of the settings.
    pub keys: Vec<String>,
    /// Settings of all points of this axis, by their dotted names, besides the varied ones.
    #[serde(default, skip_serializing_if = "Table::is_empty")]
    pub set: Table,
    /// The values; all keys take the same one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub values: Option<Vec<Value>>,
    /// One list a point: the values of all keys, in their order.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub zip: Option<Vec<Vec<Value>>>,
}

/// One point of an axis.
#[derive(Clone, Debug, PartialEq)]
pub struct AxisPoint {
    /// The value, as tables and plots print it.
    pub label: String,
    /// Dotted names of settings, with their values.
    pub sets: Vec<(String, Value)>,
}

impl Axis {
    /// Returns the number of values; of several lists, the longest.
    pub(super) fn count(&self) -> usize {
        let lists = [self.values.as_ref().map(Vec::len), self.zip.as_ref().map(Vec::len)];
        lists.into_iter().flatten().max().unwrap_or(0)
    }

    /// Returns the points of the axis, in order.
    ///
    /// # Errors
    /// Says in a sentence what is wrong with the definition.
    pub fn points(&self) -> Result<Vec<AxisPoint>, String> {
        match (&self.values, &self.zip) {
            (Some(values), None) => Ok(values.iter().map(|value| self.all(value)).collect()),
            (None, Some(zip)) => zip.iter().map(|row| self.zipped(row)).collect(),
            _ => Err("give one of values and zip".into()),
        }
    }

    /// Sets all keys to one value.
    fn all(&self, value: &Value) -> AxisPoint {
        let label = text(value);
        AxisPoint { label, sets: self.keys.iter().map(|key| (key.clone(), value.clone())).collect() }
    }

    /// Sets each key to its own value.
    fn zipped(&self, row: &[Value]) -> Result<AxisPoint, String> {
        if row.len() != self.keys.len() {
            return Err(format!(
                "zip has {} values in [{}], but there are {} keys; give each key one value",
                row.len(),
                row.iter().map(text).collect::<Vec<_>>().join(", "),
                self.keys.len()
            ));
        }
        let label = row.iter().map(text).collect::<Vec<String>>().join(" / ");
        Ok(AxisPoint { label, sets: self.keys.iter().cloned().zip(row.iter().cloned()).collect() })
    }

    /// Returns what tells the settings apart that each have their own value: `t`, `xyz`, `view` of
    /// `perturb.t.epsilon`, ... `None` if all settings have one value.
    pub(super) fn parts(&self) -> Option<AxisParts> {
        self.zip.as_ref().filter(|_| self.keys.len() > 1)?;
        let keys: Vec<Vec<&str>> = self.keys.iter().map(|key| key.split('.').collect()).collect();
        let shortest = keys.iter().map(Vec::len).min().unwrap_or(1);
        let is_shared = |at: fn(&[&str], usize) -> usize, i: usize| {
            let part = |key: &Vec<&str>| key[at(key, i)].to_string();
            keys.iter().all(|key| part(key) == part(&keys[0]))
        };
        let start = (0..shortest - 1).take_while(|&i| is_shared(|_, i| i, i)).count();
        let end = (0..shortest - 1 - start).take_while(|&i| is_shared(|key, i| key.len() - 1 - i, i)).count();
        let name = |key: &Vec<&str>| key[start..key.len() - end].join(".");
        Some(AxisParts { axis: self.name.clone(), panel: self.panel.clone(), names: keys.iter().map(name).collect() })
    }

    /// Returns a point of the axis as records name it.
    pub(super) fn named(&self, point: &AxisPoint) -> AxisValue {
        AxisValue { axis: self.name.clone(), panel: self.panel.clone(), value: point.label.clone() }
    }
}

/// Returns a value as tables and plots print it.
pub(super) fn text(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(text: &str) -> Axis {
        toml::from_str(&format!("name = \"n\"\n{text}")).unwrap()
    }

    #[test]
    fn zipped_keys_take_their_own_values() {
        let points = axis("keys = [\"a.x\", \"b\"]\nzip = [[1, \"tv\"], [2, \"l1\"]]").points().unwrap();
        assert_eq!(points[1].label, "2 / l1");
        let sets = [("a.x".to_string(), Value::Integer(2)), ("b".to_string(), Value::String("l1".into()))];
        assert_eq!(points[1].sets, sets);
    }

    #[test]
    fn settings_that_vary_together_are_told_apart_by_what_differs_in_their_names() {
        let parts = |keys: &str| {
            let zip = vec!["1"; keys.split(", ").count()].join(", ");
            axis(&format!("keys = [{keys}]\nzip = [[{zip}]]")).parts().map(|parts| parts.names)
        };
        let sites = "\"perturb.t.epsilon\", \"perturb.xyz.epsilon\", \"perturb.view.epsilon\"";
        assert_eq!(parts(sites).unwrap(), ["t", "xyz", "view"]);
        assert_eq!(parts("\"train.steps\", \"train.rays\"").unwrap(), ["steps", "rays"]);
        assert_eq!(parts("\"seed\", \"train.rays\"").unwrap(), ["seed", "train.rays"]);
        assert_eq!(parts("\"seed\""), None);
    }

    #[test]
    fn wrong_axes_are_refused_in_words() {
        for (text, words) in [
            ("keys = [\"a\"]", "one of values and zip"),
            ("keys = [\"a\"]\nvalues = [1]\nzip = [[1]]", "one of"),
            ("keys = [\"a\", \"b\"]\nzip = [[1]]", "2 keys"),
        ] {
            let error = axis(text).points().unwrap_err();
            assert!(error.contains(words), "{text}: {error}");
        }
    }
}
