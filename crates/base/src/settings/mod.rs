//! What sections of settings are made of: a section's fields with documentation, type, default and [`Rule`] in one place,
//! the registry that they fill, and checks of values.

use serde::de::DeserializeOwned;

use crate::{Error, Result, SettingError};

mod idle;
mod rules;
mod types;

pub use crate::section;
pub use idle::{IdleKind, IdleSettings};
pub use rules::{Effect, Rule, numbers, output, path, work};
use types::kind_of;
pub use types::{Range, all_of, name_of, one_or_many, word};

/// A setting in the registry.
#[derive(Clone, Debug)]
pub struct Setting {
    /// Its dotted name, as in files and `--set`.
    pub path: String,
    /// Its text.
    pub doc: String,
    /// Its type in words.
    pub kind: String,
    /// Whether it may be left open.
    pub optional: bool,
    /// Everything else about it.
    pub rule: Rule,
}

impl Setting {
    /// Returns its section; empty for none.
    pub fn section(&self) -> &str {
        self.path.rsplit_once('.').map_or("", |(section, _)| section)
    }

    /// Returns its name in the section.
    pub fn key(&self) -> &str {
        self.path.rsplit_once('.').map_or(&self.path, |(_, key)| key)
    }

    /// Returns the allowed values, in words.
    pub fn values(&self) -> String {
        let words = if self.rule.allowed.is_empty() { &self.kind } else { self.rule.allowed };
        format!("{words}{}", if self.optional { ", or empty" } else { "" })
    }
}

/// A section, or a section in a section.
#[derive(Clone, Debug)]
pub struct SectionRow {
    /// Its dotted name.
    pub path: String,
    /// Its text.
    pub doc: String,
}

/// All settings and sections, in the order of a configuration file.
#[derive(Debug, Default)]
pub struct Registry {
    /// The settings.
    pub settings: Vec<Setting>,
    /// The sections.
    pub sections: Vec<SectionRow>,
}

impl Registry {
    /// Adds the setting of a section's field. `prefix` is empty, or the section with a dot.
    pub fn add<T: DeserializeOwned>(&mut self, prefix: &str, field: &str, doc: &[&str], rule: Rule) {
        let (path, kind) = (format!("{prefix}{}", rule.key.unwrap_or(field)), kind_of::<T>());
        let (kind, optional) = (kind.words, kind.is_optional);
        self.settings.push(Setting { path, doc: one_line(doc), kind, optional, rule });
    }

    /// Adds a section with its settings.
    pub fn add_section<T: Section>(&mut self, prefix: &str, field: &str, doc: &[&str]) {
        let path = format!("{prefix}{field}");
        self.sections.push(SectionRow { path: path.clone(), doc: one_line(doc) });
        T::list(&format!("{path}."), self);
    }

    /// Returns the setting of that name.
    pub fn get(&self, path: &str) -> Option<&Setting> {
        self.settings.iter().find(|setting| setting.path == path)
    }

    /// Returns whether a file may hold the key: a setting or a section.
    pub fn knows(&self, key: &str) -> bool {
        self.settings.iter().any(|setting| setting.path == key) || self.sections.iter().any(|row| row.path == key)
    }
}

/// Joins documentation into one line of text.
fn one_line(doc: &[&str]) -> String {
    doc.iter().map(|line| line.trim()).collect::<Vec<&str>>().join(" ")
}

/// A part of a configuration that lists its settings.
pub trait Section {
    /// Adds the settings to `registry`, with their paths under `prefix` (empty, or ending with a dot).
    fn list(prefix: &str, registry: &mut Registry);
}

/// Declares a section: a struct whose fields have documentation, type, default and [`Rule`], then its inner sections.
#[macro_export]
macro_rules! section {
    (
        $(#[$outer:meta])*
        pub struct $Section:ident {
            $(
                $(#[doc = $doc:literal])+
                $(#[serde($($serde:tt)*)])?
                pub $field:ident: $Type:ty = $default:expr, $rule:expr;
            )*
        }
        sections { $($(#[doc = $about:literal])+ pub $inner:ident: $Inner:ty;)* }
    ) => {
        #[derive(Clone, Debug, PartialEq, ::serde::Serialize, ::serde::Deserialize)]
        #[serde(default, deny_unknown_fields, expecting = "a section of settings, such as [train] in a file")]
        $(#[$outer])*
        pub struct $Section {
            $($(#[doc = $doc])+ $(#[serde($($serde)*)])? pub $field: $Type,)*
            $($(#[doc = $about])+ pub $inner: $Inner,)*
        }

        impl Default for $Section {
            fn default() -> Self {
                $Section { $($field: $default,)* $($inner: <$Inner>::default(),)* }
            }
        }

        impl $crate::settings::Section for $Section {
            fn list(prefix: &str, registry: &mut $crate::settings::Registry) {
                $(registry.add::<$Type>(prefix, stringify!($field), &[$($doc),+], $rule);)*
                $(registry.add_section::<$Inner>(prefix, stringify!($inner), &[$($about),+]);)*
            }
        }
    };
}

/// Returns an error for `path = value` unless `ok`.
///
/// # Errors
/// [`Error::Setting`] with what is `allowed`.
pub fn require(ok: bool, path: &str, value: impl std::fmt::Display, allowed: &str) -> Result<()> {
    if ok {
        return Ok(());
    }
    Err(SettingError { path: path.into(), value: value.to_string(), allowed: allowed.into() }.into())
}

/// Returns an error with a sentence if `wrong`.
///
/// # Errors
/// [`Error::Config`] with the sentence.
pub fn refuse(wrong: bool, message: impl Into<String>) -> Result<()> {
    if wrong { Err(Error::Config(message.into())) } else { Ok(()) }
}
