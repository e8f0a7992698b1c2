//! What is known of a setting besides its documentation, type and default.

use super::types::{Range, Settable};
use crate::base::SettingError;

/// What a setting can change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect {
    /// A weight or a metric: it counts in a configuration's hash.
    Numbers,
    /// How often is logged, saved and evaluated: no number.
    Work,
    /// Where things lie.
    Path,
    /// What is drawn and measured besides.
    Output,
}

impl Effect {
    /// The word in tables.
    pub fn name(self) -> &'static str {
        match self {
            Effect::Numbers => "numbers",
            Effect::Work => "work",
            Effect::Path => "place",
            Effect::Output => "output",
        }
    }
}

/// What is known of a setting besides its documentation, type and default.
#[derive(Clone, Copy, Debug)]
pub struct Rule {
    /// What it can change.
    pub effect: Effect,
    /// What it may hold.
    pub range: Range,
    /// The range in words; empty where the type says all.
    pub allowed: &'static str,
    /// The column of the protocol that holds its value.
    pub column: Option<&'static str>,
    /// Further columns of the protocol that speak of it.
    pub columns: &'static [&'static str],
    /// Younger than runs whose hash is to stay: it counts in a hash where it is not at its default.
    pub later: bool,
    /// A step takes as long whatever it is.
    pub same_time: bool,
    /// Its key, where this is not the field's name.
    pub key: Option<&'static str>,
}

const fn rule(effect: Effect) -> Rule {
    Rule {
        effect,
        range: Range::Any,
        allowed: "",
        column: None,
        columns: &[],
        later: false,
        same_time: false,
        key: None,
    }
}

/// A setting that can change a weight or a metric.
pub const fn numbers() -> Rule {
    rule(Effect::Numbers)
}

/// A setting that says how often something is done.
pub const fn work() -> Rule {
    rule(Effect::Work)
}

/// A setting that says where something lies.
pub const fn path() -> Rule {
    rule(Effect::Path)
}

/// A setting that says what is drawn or measured besides.
pub const fn output() -> Rule {
    rule(Effect::Output)
}

impl Rule {
    /// Whole numbers from `least` to `most`.
    pub const fn whole(self, least: u64, most: u64, allowed: &'static str) -> Rule {
        Rule { range: Range::Whole(least, most), allowed, ..self }
    }

    /// Finite numbers that pass.
    pub const fn real(self, holds: fn(f64) -> bool, allowed: &'static str) -> Rule {
        Rule { range: Range::Real(holds), allowed, ..self }
    }

    /// Text that passes.
    pub const fn text(self, holds: fn(&str) -> bool, allowed: &'static str) -> Rule {
        Rule { range: Range::Text(holds), allowed, ..self }
    }

    /// What its type alone decides, in words.
    pub const fn allowing(self, allowed: &'static str) -> Rule {
        Rule { allowed, ..self }
    }

    /// Two corners of a box.
    pub const fn corners(self) -> Rule {
        let allowed = "two corners [[x, y, z], [x, y, z]], each number of the first under that of the second";
        Rule { range: Range::Box, allowed, ..self }
    }

    /// The column of the protocol that holds its value: [`super::columns::COLUMNS`] says when it does.
    pub const fn column(self, column: &'static str) -> Rule {
        Rule { column: Some(column), ..self }
    }

    /// Columns of the protocol that speak of it.
    pub const fn columns(self, columns: &'static [&'static str]) -> Rule {
        Rule { columns, ..self }
    }

    /// All columns of the protocol that speak of it.
    pub fn all_columns(&self) -> impl Iterator<Item = &'static str> {
        self.column.into_iter().chain(self.columns.iter().copied())
    }

    /// Younger than runs whose hash is to stay.
    pub const fn later(self) -> Rule {
        Rule { later: true, ..self }
    }

    /// A step takes as long whatever it is.
    pub const fn same_time(self) -> Rule {
        Rule { same_time: true, ..self }
    }

    /// Its key, where this is not the field's name.
    pub const fn key(self, key: &'static str) -> Rule {
        Rule { key: Some(key), ..self }
    }

    /// Refuses a value that is not allowed; `path` names it.
    pub fn check(&self, path: impl FnOnce() -> String, value: &impl Settable) -> Result<(), SettingError> {
        match value.outside(&self.range) {
            None => Ok(()),
            Some(value) => {
                let allowed = if self.allowed.is_empty() { "at most 2^63 - 1" } else { self.allowed };
                Err(SettingError { path: path(), value, allowed: allowed.into() })
            }
        }
    }
}
