//! Everything about a setting besides its documentation, type and default.

use serde::Serialize;
use toml::Value;

use super::types::{Range, is_box};
use crate::SettingError;

/// What a setting can change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect {
    /// A weight or a metric. It counts in a configuration's hash.
    Numbers,
    /// How often a run logs, saves and evaluates. It changes no number.
    Work,
    /// A path.
    Path,
    /// Additional images and measurements.
    Output,
}

impl Effect {
    /// Returns the word in tables.
    pub fn name(self) -> &'static str {
        match self {
            Effect::Numbers => "numbers",
            Effect::Work => "work",
            Effect::Path => "place",
            Effect::Output => "output",
        }
    }
}

/// Everything about a setting besides its documentation, type and default.
#[derive(Clone, Copy, Debug)]
pub struct Rule {
    /// What it can change.
    pub effect: Effect,
    /// The allowed values.
    pub range: Range,
    /// The allowed values in words; empty if the type says all.
    pub allowed: &'static str,
    /// The column of the protocol that holds its value.
    pub column: Option<&'static str>,
    /// Other columns of the protocol that depend on it.
    pub columns: &'static [&'static str],
    /// It does not change the time of a step.
    pub same_time: bool,
    /// Its key, if this is not the field's name.
    pub key: Option<&'static str>,
}

const fn rule(effect: Effect) -> Rule {
    Rule { effect, range: Range::Any, allowed: "", column: None, columns: &[], same_time: false, key: None }
}

/// Returns the rule of a setting that can change a weight or a metric.
pub const fn numbers() -> Rule {
    rule(Effect::Numbers)
}

/// Returns the rule of a setting for how often something is done.
pub const fn work() -> Rule {
    rule(Effect::Work)
}

/// Returns the rule of a setting that is a path.
pub const fn path() -> Rule {
    rule(Effect::Path)
}

/// Returns the rule of a setting for additional output.
pub const fn output() -> Rule {
    rule(Effect::Output)
}

impl Rule {
    /// Allows whole numbers from `least` to `most`.
    pub const fn whole(self, least: u64, most: u64, allowed: &'static str) -> Rule {
        Rule { range: Range::Whole(least, most), allowed, ..self }
    }

    /// Allows finite numbers for which `holds` is true.
    pub const fn real(self, holds: fn(f64) -> bool, allowed: &'static str) -> Rule {
        Rule { range: Range::Real(holds), allowed, ..self }
    }

    /// Allows positive numbers.
    pub const fn positive(self) -> Rule {
        self.real(|number| number > 0.0, "positive")
    }

    /// Allows 0 and positive numbers.
    pub const fn zero_or_positive(self) -> Rule {
        self.real(|number| number >= 0.0, "0 or positive")
    }

    /// Allows 0, which switches something off, and positive numbers.
    pub const fn off_or_positive(self) -> Rule {
        self.real(|number| number >= 0.0, "0 (off) or positive")
    }

    /// Allows shares that are not 0.
    pub const fn share_above_0(self) -> Rule {
        self.real(|share| share > 0.0 && share <= 1.0, "above 0, at most 1")
    }

    /// Allows text for which `holds` is true.
    pub const fn text(self, holds: fn(&str) -> bool, allowed: &'static str) -> Rule {
        Rule { range: Range::Text(holds), allowed, ..self }
    }

    /// Allows values, also lists, for which `holds` is true.
    pub const fn values(self, holds: fn(&Value) -> bool, allowed: &'static str) -> Rule {
        Rule { range: Range::Values(holds), allowed, ..self }
    }

    /// Allows two corners of a box.
    pub const fn corners(self) -> Rule {
        self.values(is_box, "two corners [[x, y, z], [x, y, z]], each number of the first under that of the second")
    }

    /// Names the column of the protocol that holds the value. [`crate::columns::COLUMNS`] says when it does.
    pub const fn column(self, column: &'static str) -> Rule {
        Rule { column: Some(column), ..self }
    }

    /// Names other columns of the protocol that depend on the setting.
    pub const fn columns(self, columns: &'static [&'static str]) -> Rule {
        Rule { columns, ..self }
    }

    /// Iterates over all columns of the protocol that depend on the setting.
    pub fn all_columns(&self) -> impl Iterator<Item = &'static str> {
        self.column.into_iter().chain(self.columns.iter().copied())
    }

    /// Marks the setting as one that does not change the time of a step.
    pub const fn same_time(self) -> Rule {
        Rule { same_time: true, ..self }
    }

    /// Sets the key, if this is not the field's name.
    pub const fn key(self, key: &'static str) -> Rule {
        Rule { key: Some(key), ..self }
    }

    /// Returns an error for a value that is not allowed. `path` names the setting.
    pub fn check(&self, path: &str, value: impl Serialize) -> Result<(), SettingError> {
        let outside = match Value::try_from(value) {
            Ok(value) => self.range.outside(&value),
            Err(_) => Some("a number above 2^63 - 1".into()),
        };
        let allowed = if self.allowed.is_empty() { "at most 2^63 - 1" } else { self.allowed };
        outside.map_or(Ok(()), |value| Err(SettingError { path: path.into(), value, allowed: allowed.into() }))
    }
}
