//! Axes of a sweep: settings that vary together, and their values.

use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::base::rng::{Random, Stream};
use crate::report::{AxisParts, AxisValue};

/// Limit on the values of an axis; more is an error, found before memory is allocated.
const MOST_VALUES: usize = 10_000;

/// One setting, or several that vary together. Its values are given by one of `values`, `zip`, `log` and `random`.
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
    /// Values evenly spaced in their logarithm, both ends included.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub log: Option<Span>,
    /// Random values, in ascending order.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub random: Option<RandomSpan>,
}

/// `count` values between two numbers. Between integers the values are integers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Span {
    /// The smallest value.
    pub from: Value,
    /// The largest value.
    pub to: Value,
    /// Number of values.
    pub count: usize,
}

/// `count` random values between two numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RandomSpan {
    /// Lower bound.
    pub from: Value,
    /// Upper bound.
    pub to: Value,
    /// Number of values.
    pub count: usize,
    /// The scale on which the values are uniform.
    #[serde(default)]
    pub scale: Scale,
    /// Seed of the random values.
    #[serde(default)]
    pub seed: u64,
}

/// The scale on which random values are uniform.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Scale {
    /// The number itself.
    #[default]
    Linear,
    /// The number's logarithm.
    Log,
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
        let spans = [self.log.as_ref().map(|span| span.count), self.random.as_ref().map(|span| span.count)];
        let lists = [self.values.as_ref().map(Vec::len), self.zip.as_ref().map(Vec::len)];
        spans.into_iter().chain(lists).flatten().max().unwrap_or(0)
    }

    /// Returns the points of the axis, in order.
    ///
    /// # Errors
    /// Says in a sentence what is wrong with the definition.
    pub fn points(&self) -> Result<Vec<AxisPoint>, String> {
        let same = |values: Vec<Value>| -> Vec<AxisPoint> { values.into_iter().map(|value| self.all(value)).collect() };
        let points = match (&self.values, &self.zip, &self.log, &self.random) {
            (Some(values), None, None, None) => same(values.clone()),
            (None, Some(zip), None, None) => zip.iter().map(|row| self.zipped(row)).collect::<Result<_, _>>()?,
            (None, None, Some(span), None) => same(span.values()?),
            (None, None, None, Some(random)) => same(random.values()?),
            _ => return Err("give one of values, zip, log and random".into()),
        };
        Ok(points)
    }

    /// Sets all keys to one value.
    fn all(&self, value: Value) -> AxisPoint {
        let label = text(&value);
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

impl Span {
    fn values(&self) -> Result<Vec<Value>, String> {
        let (from, to) = ends("log", &self.from, &self.to)?;
        if from <= 0.0 {
            return Err(format!("log.from = {} has no logarithm: it must be positive", text(&self.from)));
        }
        if !(2..=MOST_VALUES).contains(&self.count) {
            let allowed = format!("it must be 2, both ends, to {MOST_VALUES}");
            return Err(format!("log.count = {} is out of range: {allowed}", self.count));
        }
        // Each value comes from its own exponent, so that errors do not accumulate.
        let at = |i: usize| match i {
            0 => from,
            i if i + 1 == self.count => to,
            i => from * (to / from).powf(i as f64 / (self.count - 1) as f64),
        };
        distinct("log", numbers((0..self.count).map(at), &self.from, &self.to, [from, to]))
    }
}

impl RandomSpan {
    fn values(&self) -> Result<Vec<Value>, String> {
        let (from, to) = ends("random", &self.from, &self.to)?;
        if self.scale == Scale::Log && from <= 0.0 {
            return Err(format!("random.from = {} has no logarithm: it must be positive", text(&self.from)));
        }
        if !(1..=MOST_VALUES).contains(&self.count) {
            return Err(format!("random.count = {} is out of range: it must be 1 to {MOST_VALUES}", self.count));
        }
        let mut random = Random::new(self.seed, Stream::Axis, 0);
        let mut drawn: Vec<f64> = (0..self.count)
            .map(|_| match self.scale {
                Scale::Linear => from + (to - from) * random.uniform(),
                Scale::Log => from * (to / from).powf(random.uniform()),
            })
            .collect();
        drawn.sort_by(f64::total_cmp);
        distinct("random", numbers(drawn.into_iter(), &self.from, &self.to, [from, to]))
    }
}

/// Returns the two ends as numbers, in order.
fn ends(kind: &str, from: &Value, to: &Value) -> Result<(f64, f64), String> {
    let number = |name: &str, value: &Value| {
        let number = value.as_float().or(value.as_integer().map(|integer| integer as f64));
        number
            .filter(|number| number.is_finite())
            .ok_or_else(|| format!("{kind}.{name} = {} is out of range: it must be a finite number", text(value)))
    };
    let (low, high) = (number("from", from)?, number("to", to)?);
    if low < high {
        return Ok((low, high));
    }
    Err(format!("{kind}.to = {} is out of range: it must be above {kind}.from = {}", text(to), text(from)))
}

/// Rounds numbers to four digits, or to integers between integers. Labels stay short, and show the exact value that is
/// set.
fn numbers(values: impl Iterator<Item = f64>, from: &Value, to: &Value, [low, high]: [f64; 2]) -> Vec<Value> {
    let integers = from.is_integer() && to.is_integer();
    let value = |value: f64| match integers {
        true => Value::Integer(value.round() as i64),
        false => Value::Float(format!("{value:.3e}").parse().expect("a number's own text")),
    };
    // The ends keep their original form.
    let ends = [(from.clone(), low), (to.clone(), high)];
    let exact = |number: f64| ends.iter().find(|(_, end)| number == *end).map(|(given, _)| given.clone());
    values.map(|number| exact(number).unwrap_or_else(|| value(number))).collect()
}

/// Returns the ascending values. Two values that round to the same number would be one point, and are an error.
fn distinct(kind: &str, values: Vec<Value>) -> Result<Vec<Value>, String> {
    let Some([twice, _]) = values.windows(2).find(|pair| pair[0] == pair[1]) else { return Ok(values) };
    let fractions = if twice.is_integer() { " or fractions (1.0 in place of 1)" } else { "" };
    Err(format!("{kind} gives {} more than once; use fewer values, a wider span{fractions}", text(twice)))
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

    fn labels(text: &str) -> Vec<String> {
        axis(text).points().unwrap().into_iter().map(|point| point.label).collect()
    }

    #[test]
    fn log_spacing_has_short_values_and_both_ends() {
        let text = "keys = [\"a\"]\nlog = { from = 1e-5, to = 0.1, count = 5 }";
        assert_eq!(
            labels(text),
            ["0.00001", "0.0001", "0.001", "0.01", "0.1"].map(|t| t.parse::<f64>().unwrap().to_string())
        );
        assert_eq!(labels("keys = [\"a\"]\nlog = { from = 1, to = 100, count = 4 }"), ["1", "5", "22", "100"]);
        assert_eq!(labels("keys = [\"a\"]\nlog = { from = 1.0, to = 3.0, count = 3 }"), ["1.0", "1.732", "3.0"]);
    }

    #[test]
    fn random_values_are_drawn_once_and_for_all() {
        let text = |seed: u64| {
            format!("keys = [\"a\"]\nrandom = {{ from = 1e-3, to = 10.0, count = 40, scale = \"log\", seed = {seed} }}")
        };
        let drawn = labels(&text(1));
        assert_eq!(drawn, labels(&text(1)));
        assert_ne!(drawn, labels(&text(2)));
        let numbers: Vec<f64> = drawn.iter().map(|label| label.parse().unwrap()).collect();
        assert!(numbers.is_sorted() && numbers.iter().all(|n| (1e-3..=10.0).contains(n)));
        // Half of the values are below the geometric mean, 0.1.
        assert!((10..30).contains(&numbers.iter().filter(|n| **n < 0.1).count()), "{numbers:?}");
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
            ("keys = [\"a\"]", "one of values, zip, log and random"),
            ("keys = [\"a\"]\nvalues = [1]\nlog = { from = 1, to = 2, count = 2 }", "one of"),
            ("keys = [\"a\", \"b\"]\nzip = [[1]]", "2 keys"),
            ("keys = [\"a\"]\nlog = { from = 0, to = 2, count = 2 }", "positive"),
            ("keys = [\"a\"]\nlog = { from = 3, to = 2, count = 2 }", "above log.from = 3"),
            ("keys = [\"a\"]\nlog = { from = 1, to = 2, count = 1 }", "2, both ends"),
            ("keys = [\"a\"]\nlog = { from = \"x\", to = 2, count = 3 }", "log.from = x"),
            ("keys = [\"a\"]\nrandom = { from = 1, to = 2, count = 0 }", "1 to 10000"),
            ("keys = [\"a\"]\nlog = { from = 1, to = 4, count = 9 }", "log gives 1 more than once; use fewer"),
            ("keys = [\"a\"]\nlog = { from = 1, to = 2, count = 9000000000000000000 }", "2, both ends, to 10000"),
            ("keys = [\"a\"]\nrandom = { from = 1, to = 9e9, count = 50000 }", "1 to 10000"),
        ] {
            let error = axis(text).points().unwrap_err();
            assert!(error.contains(words), "{text}: {error}");
        }
    }
}
