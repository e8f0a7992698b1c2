//! What there is to know of each setting, once: its path, what it says, what it may hold, what it can change, which
//! columns of the protocol speak of it. Hashes, checks, known keys, comparability and `docs/settings.md` follow from it.
//!
//! A section is declared with `section!`: documentation, type, default and [`Rule`] of a field stand in one place.

use std::sync::LazyLock;

use serde::de::{DeserializeOwned, Deserializer, Visitor, value::Error as Unread};

use crate::base::SettingError;

/// What a setting can change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect {
    /// A weight or a metric: it counts in a configuration's hash.
    Numbers,
    /// How often is logged, saved and evaluated: no number.
    Work,
    /// Where things lie.
    Place,
    /// What is drawn and measured besides.
    Output,
}

impl Effect {
    /// The word in tables.
    pub fn name(self) -> &'static str {
        match self {
            Effect::Numbers => "numbers",
            Effect::Work => "work",
            Effect::Place => "place",
            Effect::Output => "output",
        }
    }
}

/// Values that a setting may have, as far as it alone decides.
#[derive(Clone, Copy, Debug)]
pub enum Range {
    /// All of its type.
    Any,
    /// Whole numbers, both ends included.
    Whole(u64, u64),
    /// Finite numbers that pass.
    Real(fn(f64) -> bool),
    /// Text that passes.
    Text(fn(&str) -> bool),
    /// Two corners, each number of the first under that of the second.
    Box,
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
    /// Columns of the protocol that speak of it.
    pub columns: &'static [&'static str],
    /// Younger than runs whose hash is to stay: it counts in a hash where it is not at its default.
    pub later: bool,
    /// A step takes as long whatever it is.
    pub same_time: bool,
    /// Its key, where this is not the field's name.
    pub key: Option<&'static str>,
}

const fn rule(effect: Effect) -> Rule {
    Rule { effect, range: Range::Any, allowed: "", columns: &[], later: false, same_time: false, key: None }
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
pub const fn place() -> Rule {
    rule(Effect::Place)
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

    /// Two corners of a box.
    pub const fn corners(self) -> Rule {
        let allowed = "two corners [[x, y, z], [x, y, z]], each number of the first under that of the second";
        Rule { range: Range::Box, allowed, ..self }
    }

    /// Columns of the protocol that speak of it.
    pub const fn columns(self, columns: &'static [&'static str]) -> Rule {
        Rule { columns, ..self }
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
            Some(value) => Err(SettingError { path: path(), value, allowed: self.allowed.into() }),
        }
    }
}

/// A type that a setting can have.
pub trait Settable {
    /// It may be left open.
    const OPTIONAL: bool = false;
    /// The type in words, with its choices.
    fn kind() -> String;
    /// The value's text where it is not in the range.
    fn outside(&self, range: &Range) -> Option<String>;
}

macro_rules! whole {
    ($($Type:ty),*) => {$(
        impl Settable for $Type {
            fn kind() -> String {
                "whole number".into()
            }

            fn outside(&self, range: &Range) -> Option<String> {
                let Range::Whole(least, most) = *range else { return None };
                (!(least..=most).contains(&(*self as u64))).then(|| self.to_string())
            }
        }
    )*};
}
whole!(u32, u64, usize);

impl Settable for f64 {
    fn kind() -> String {
        "number".into()
    }

    fn outside(&self, range: &Range) -> Option<String> {
        let Range::Real(holds) = range else { return None };
        (!(self.is_finite() && holds(*self))).then(|| self.to_string())
    }
}

impl Settable for bool {
    fn kind() -> String {
        "true or false".into()
    }

    fn outside(&self, _: &Range) -> Option<String> {
        None
    }
}

impl Settable for String {
    fn kind() -> String {
        "text".into()
    }

    fn outside(&self, range: &Range) -> Option<String> {
        let Range::Text(holds) = range else { return None };
        (!holds(self)).then(|| format!("\"{self}\""))
    }
}

impl Settable for [[f64; 3]; 2] {
    fn kind() -> String {
        "[[x, y, z], [x, y, z]]".into()
    }

    fn outside(&self, _: &Range) -> Option<String> {
        let [lower, upper] = self;
        let is_box = lower.iter().zip(upper).all(|(a, b)| a.is_finite() && b.is_finite() && a < b);
        (!is_box).then(|| format!("{self:?}"))
    }
}

impl<T: Settable> Settable for Option<T> {
    const OPTIONAL: bool = true;

    fn kind() -> String {
        T::kind()
    }

    fn outside(&self, range: &Range) -> Option<String> {
        self.as_ref().and_then(|value| value.outside(range))
    }
}

impl<T: Settable> Settable for Vec<T> {
    fn kind() -> String {
        format!("list of: {}", T::kind())
    }

    fn outside(&self, range: &Range) -> Option<String> {
        self.iter().find_map(|value| value.outside(range))
    }
}

/// The names that serde knows the variants of an enum by.
pub(super) fn choices<T: DeserializeOwned>() -> &'static [&'static str] {
    let mut names: &'static [&'static str] = &[];
    // It always ends with an error: there is nothing to read.
    let _ = T::deserialize(Names(&mut names));
    names
}

/// Reads nothing, but notes what was expected: the variants of an enum, the fields of a struct.
struct Names<'a>(&'a mut &'static [&'static str]);

impl<'de> Deserializer<'de> for Names<'_> {
    type Error = Unread;

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Unread> {
        Err(serde::de::Error::custom("nothing to read"))
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Unread> {
        *self.0 = variants;
        self.deserialize_any(visitor)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Unread> {
        *self.0 = fields;
        self.deserialize_any(visitor)
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option unit unit_struct
        newtype_struct seq tuple tuple_struct map identifier ignored_any
    }
}

/// Makes enums types of settings: one of their names.
macro_rules! choice {
    ($($Type:ty),* $(,)?) => {$(
        impl $crate::settings::registry::Settable for $Type {
            fn kind() -> String {
                $crate::settings::registry::choices::<$Type>().join(", ")
            }

            fn outside(&self, _: &$crate::settings::registry::Range) -> Option<String> {
                None
            }
        }
    )*};
}

/// A setting as it stands in the table of all settings.
#[derive(Clone, Debug)]
pub struct Setting {
    /// Its dotted name, as files and `--set` have it.
    pub path: String,
    /// What it says.
    pub doc: String,
    /// Its type in words.
    pub kind: String,
    /// It may be left open.
    pub optional: bool,
    /// What else is known of it.
    pub rule: Rule,
}

/// A section, or a section in a section.
#[derive(Clone, Debug)]
pub struct SectionRow {
    /// Its dotted name.
    pub path: String,
    /// What it is about.
    pub doc: String,
    /// Younger than runs whose hash is to stay: it counts in a hash where any of it is not at its default.
    pub later: bool,
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
    pub(super) fn add<T: Settable>(&mut self, path: String, doc: &[&str], rule: Rule) {
        self.settings.push(Setting { path, doc: one_line(doc), kind: T::kind(), optional: T::OPTIONAL, rule });
    }

    pub(super) fn add_section(&mut self, path: String, doc: &[&str], later: bool) {
        self.sections.push(SectionRow { path, doc: one_line(doc), later });
    }

    /// The setting of that name.
    pub fn get(&self, path: &str) -> Option<&Setting> {
        self.settings.iter().find(|setting| setting.path == path)
    }

    /// What is younger than runs whose hash is to stay: settings, and sections as a whole.
    pub fn later(&self) -> impl Iterator<Item = &str> {
        let settings = self.settings.iter().filter(|setting| setting.rule.later).map(|setting| setting.path.as_str());
        settings.chain(self.sections.iter().filter(|row| row.later).map(|row| row.path.as_str()))
    }

    /// Whether a file may hold the key: a setting or a section.
    pub fn knows(&self, key: &str) -> bool {
        self.settings.iter().any(|setting| setting.path == key) || self.sections.iter().any(|row| row.path == key)
    }
}

/// Documentation as one line of text.
fn one_line(doc: &[&str]) -> String {
    doc.iter().map(|line| line.trim()).collect::<Vec<&str>>().join(" ")
}

/// A part of a configuration that can list and check its settings.
pub trait Section {
    /// Adds the settings, their paths under `prefix` (empty, or with a dot at its end).
    fn list(prefix: &str, registry: &mut Registry);

    /// Checks each setting by itself.
    fn check(&self, prefix: &str) -> Result<(), SettingError>;

    /// Puts the settings that `chosen` picks back at those of `default`.
    fn reset(&mut self, default: &Self, chosen: fn(&Rule) -> bool);
}

/// Lists the settings of a struct: `describe! { Struct { /// Doc. field: Type, rule; ... } sections { ... } }`. A part that is
/// `flat` lists its own settings among those of the struct.
macro_rules! describe {
    (
        $Section:ident { $($(#[doc = $doc:literal])+ $field:ident: $Type:ty, $rule:expr;)* }
        sections { $($(#[doc = $about:literal])+ $inner:ident: $Inner:ty, $later:expr;)* }
        $(flat { $flat:ident: $Flat:ty })?
    ) => {
        impl $crate::settings::registry::Section for $Section {
            fn list(prefix: &str, registry: &mut $crate::settings::registry::Registry) {
                $({
                    const RULE: $crate::settings::registry::Rule = $rule;
                    let path = format!("{prefix}{}", RULE.key.unwrap_or(stringify!($field)));
                    registry.add::<$Type>(path, &[$($doc),+], RULE);
                })*
                $({
                    let path = format!("{prefix}{}", stringify!($inner));
                    registry.add_section(path.clone(), &[$($about),+], $later);
                    <$Inner as $crate::settings::registry::Section>::list(&format!("{path}."), registry);
                })*
                $(<$Flat as $crate::settings::registry::Section>::list(prefix, registry);)?
                let _ = (prefix, registry);
            }

            fn check(&self, prefix: &str) -> ::std::result::Result<(), $crate::base::SettingError> {
                $({
                    const RULE: $crate::settings::registry::Rule = $rule;
                    RULE.check(|| format!("{prefix}{}", RULE.key.unwrap_or(stringify!($field))), &self.$field)?;
                })*
                $($crate::settings::registry::Section::check(&self.$inner, &format!("{prefix}{}.", stringify!($inner)))?;)*
                $($crate::settings::registry::Section::check(&self.$flat, prefix)?;)?
                let _ = prefix;
                Ok(())
            }

            fn reset(&mut self, default: &Self, chosen: fn(&$crate::settings::registry::Rule) -> bool) {
                $({
                    const RULE: $crate::settings::registry::Rule = $rule;
                    if chosen(&RULE) {
                        self.$field.clone_from(&default.$field);
                    }
                })*
                $($crate::settings::registry::Section::reset(&mut self.$inner, &default.$inner, chosen);)*
                $($crate::settings::registry::Section::reset(&mut self.$flat, &default.$flat, chosen);)?
                let _ = (default, chosen);
            }
        }
    };
}

/// Declares a section: a struct whose fields have documentation, type, default and [`Rule`], then its inner sections and
/// whether they are younger than runs whose hash is to stay.
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
        sections { $($(#[doc = $about:literal])+ pub $inner:ident: $Inner:ty, $later:expr;)* }
        $(flat {
            $(#[doc = $note:literal])+
            $(#[serde($($flatten:tt)*)])?
            pub $flat:ident: $Flat:ty = $value:expr;
        })?
    ) => {
        #[derive(Clone, Debug, PartialEq, ::serde::Serialize, ::serde::Deserialize)]
        #[serde(default, deny_unknown_fields)]
        $(#[$outer])*
        pub struct $Section {
            $($(#[doc = $doc])+ $(#[serde($($serde)*)])? pub $field: $Type,)*
            $($(#[doc = $about])+ pub $inner: $Inner,)*
            $($(#[doc = $note])+ $(#[serde($($flatten)*)])? pub $flat: $Flat,)?
        }

        impl Default for $Section {
            fn default() -> Self {
                $Section { $($field: $default,)* $($inner: <$Inner>::default(),)* $($flat: $value,)? }
            }
        }

        $crate::settings::registry::describe! {
            $Section { $($(#[doc = $doc])+ $field: $Type, $rule;)* }
            sections { $($(#[doc = $about])+ $inner: $Inner, $later;)* }
            $(flat { $flat: $Flat })?
        }
    };
}

pub(super) use {choice, describe, section};

/// The table of all settings.
pub static REGISTRY: LazyLock<Registry> = LazyLock::new(|| {
    let mut registry = Registry::default();
    super::Config::list("", &mut registry);
    registry
});

/// Refuses a value of `flag` that the setting `path`, for which it stands, may not have.
///
/// # Panics
/// Where there is no such setting.
pub fn check_flag(flag: &str, path: &str, value: &impl Settable) -> Result<(), SettingError> {
    let setting = REGISTRY.get(path).expect("the path of a setting");
    setting.rule.check(|| path.to_string(), value).map_err(|error| error.renamed(flag))
}

/// The name that is nearest to a mistaken one, by Levenshtein's distance.
pub(super) fn nearest<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    known.min_by_key(|known| distance(known, name))
}

fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = std::mem::replace(&mut row[0], i + 1);
        for (j, cb) in b.iter().enumerate() {
            let substituted = diagonal + usize::from(ca != *cb);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::layers::leaves;
    use crate::settings::{
        Config, CorruptionConfig, DataConfig, EvalConfig, FieldConfig, MeshConfig, PerturbConfig, RegularizerConfig,
        SamplingConfig, TrainConfig,
    };

    /// What a configuration file may hold is what the table lists, each once and with words.
    #[test]
    fn every_key_of_a_file_is_one_entry() {
        let mut keys: Vec<String> = Vec::new();
        let mut add = |prefix: &str, names: &[&str]| keys.extend(names.iter().map(|name| format!("{prefix}{name}")));
        add("", choices::<Config>());
        add("data.", choices::<DataConfig>());
        add("data.corruption.", choices::<CorruptionConfig>());
        add("field.", choices::<FieldConfig>());
        add("sampling.", choices::<SamplingConfig>());
        add("train.", choices::<TrainConfig>());
        add("regularizer.", choices::<RegularizerConfig>());
        add("eval.", choices::<EvalConfig>());
        add("eval.mesh.", choices::<MeshConfig>());
        // Section perturb is read and written by hand: what it writes, and a key that it only reads.
        let perturb = toml::Table::try_from(PerturbConfig::default().resolve(1.0).into_draft()).unwrap();
        let sites = perturb.iter().filter(|(_, value)| value.is_table()).map(|(site, _)| format!("perturb.{site}"));
        keys.extend(sites.chain(leaves(&perturb, "perturb.")).chain(["perturb.levels".into()]));
        let settings = REGISTRY.settings.iter().map(|setting| (&setting.path, &setting.doc));
        let rows = settings.chain(REGISTRY.sections.iter().map(|row| (&row.path, &row.doc)));
        let (mut listed, docs): (Vec<String>, Vec<&String>) = rows.map(|(path, doc)| (path.clone(), doc)).unzip();
        keys.sort();
        listed.sort();
        assert_eq!(keys, listed);
        assert!(docs.iter().all(|doc| !doc.is_empty()));
    }

    #[test]
    fn a_value_out_of_range_is_named_with_its_range_as_data() {
        let mut config = Config::default();
        config.eval.mesh.points = 3;
        let error = config.check("").unwrap_err();
        assert_eq!((error.path.as_str(), error.value.as_str()), ("eval.mesh.points", "3"));
        let words = "--points = 3 is out of range: it must be 100 to 20000000";
        assert_eq!(error.renamed("--points").to_string(), words);
        assert_eq!(check_flag("--points", "eval.mesh.points", &3usize).unwrap_err().to_string(), words);
        check_flag("--points", "eval.mesh.points", &100usize).unwrap();
    }

    #[test]
    fn defaults_are_in_their_ranges_and_the_ends_of_ranges_count() {
        Config::default().check("").unwrap();
        for (path, inside, outside) in [("train.warmup_share", 1.0, 1.1), ("train.dead_start_share", 0.99, 1.0)] {
            check_flag(path, path, &inside).unwrap();
            check_flag(path, path, &outside).unwrap_err();
        }
        check_flag("seed", "seed", &(i64::MAX as u64)).unwrap();
        check_flag("seed", "seed", &(i64::MAX as u64 + 1)).unwrap_err();
        check_flag("near", "data.near", &Some(f64::INFINITY)).unwrap_err();
    }
}
