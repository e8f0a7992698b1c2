//! The registry of settings: each setting's path, text, allowed values, effects and protocol columns, stated once.
//! Hashes, checks, known keys, comparability and `docs/settings.md` follow from it.
//!
//! A section is declared with `section!`: documentation, type, default and [`Rule`] of a field are in one place.

use std::sync::LazyLock;

use strsim::levenshtein;

pub use super::rules::{Effect, Rule, numbers, output, path, work};
pub(super) use super::types::choice;
pub use super::types::{Range, Settable};
use crate::base::SettingError;

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
    pub(super) fn add<T: Settable>(&mut self, path: String, doc: &[&str], rule: Rule) {
        self.settings.push(Setting { path, doc: one_line(doc), kind: T::kind(), optional: T::OPTIONAL, rule });
    }

    pub(super) fn add_section(&mut self, path: String, doc: &[&str]) {
        self.sections.push(SectionRow { path, doc: one_line(doc) });
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

/// A part of a configuration that can list and check its settings.
pub trait Section {
    /// Adds the settings to `registry`, with their paths under `prefix` (empty, or ending with a dot).
    fn list(prefix: &str, registry: &mut Registry);

    /// Checks each setting by itself.
    fn check(&self, prefix: &str) -> Result<(), SettingError>;

    /// Resets the settings that `chosen` picks to those of `default`.
    fn reset(&mut self, default: &Self, chosen: fn(&Rule) -> bool);
}

/// Lists the settings of a struct: `describe! { Struct { /// Doc. field: Type, rule; ... } sections { ... } }`. A
/// `flat` part lists its own settings among those of the struct.
macro_rules! describe {
    (
        $Section:ident { $($(#[doc = $doc:literal])+ $field:ident: $Type:ty, $rule:expr;)* }
        sections { $($(#[doc = $about:literal])+ $inner:ident: $Inner:ty;)* }
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
                    registry.add_section(path.clone(), &[$($about),+]);
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

/// Declares a section: a struct whose fields have documentation, type, default and [`Rule`], then its inner sections.
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
        $(flat {
            $(#[doc = $note:literal])+
            $(#[serde($($flatten:tt)*)])?
            pub $flat:ident: $Flat:ty = $value:expr;
        })?
    ) => {
        #[derive(Clone, Debug, PartialEq, ::serde::Serialize, ::serde::Deserialize)]
        #[serde(default, deny_unknown_fields, expecting = "a section of settings, such as [train] in a file")]
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
            sections { $($(#[doc = $about])+ $inner: $Inner;)* }
            $(flat { $flat: $Flat })?
        }
    };
}

pub(super) use {describe, section};

/// The table of all settings.
pub static REGISTRY: LazyLock<Registry> = LazyLock::new(|| {
    let mut registry = Registry::default();
    super::Config::list("", &mut registry);
    registry
});

/// Returns an error if the setting `path`, for which `flag` stands, may not have the value.
///
/// # Panics
/// If there is no such setting.
pub fn check_flag(flag: &str, path: &str, value: &impl Settable) -> Result<(), SettingError> {
    let setting = REGISTRY.get(path).expect("the path of a setting");
    setting.rule.check(|| path.to_string(), value).map_err(|error| error.renamed(flag))
}

/// Largest number of settings that are suggested for a mistaken name.
const MOST_MEANT: usize = 3;

/// Returns the settings whose last part is that of `name`, or what it is short for, in the fewest sections. `steps` gives
/// `train.steps`, `lr` gives `train.learning_rate`, and `width` both `data.width` and `field.width`.
pub fn settings_called(name: &str) -> Vec<&'static str> {
    shallowest(REGISTRY.settings.iter().map(|setting| setting.path.as_str()).filter(|path| is_called(path, name)))
}

/// Returns whether the last part of `name` is that of `path`, its initials, or the beginnings of its words.
fn is_called(path: &str, name: &str) -> bool {
    let (own, short) = (last_part(path), last_part(name).to_lowercase());
    let words: Vec<&str> = own.split('_').collect();
    let begin = |parts: &[&str]| {
        let pairs = || words.iter().zip(parts);
        words.len() == parts.len() && pairs().all(|(word, part)| !part.is_empty() && word.starts_with(part))
    };
    let initials = || words.iter().filter_map(|word| word.chars().next()).eq(short.chars());
    own == short || words.len() > 1 && (initials() || begin(&short.split('_').collect::<Vec<&str>>()))
}

/// Returns what a mistaken name may have meant, in words: settings of that last part, otherwise the nearest by Levenshtein's
/// distance. A setting of the section that is named comes first.
pub(super) fn meant(name: &str) -> String {
    in_words(&candidates(name))
}

/// Returns the same for a word that need not be a name: `None` if no setting is near.
pub(super) fn nearly(word: &str) -> Option<String> {
    let near = |path: &&'static str| {
        is_called(path, word) || levenshtein(path, word).min(levenshtein(last_part(path), word)) <= word.len() / 3
    };
    let near: Vec<&str> = candidates(word).into_iter().filter(near).collect();
    (!near.is_empty()).then(|| in_words(&near))
}

fn in_words(paths: &[&str]) -> String {
    paths.iter().map(|path| format!("'{path}'")).collect::<Vec<_>>().join(" or ")
}

/// Largest Levenshtein distance of a misspelt key in the named section.
const TYPOS: usize = 2;

fn candidates(name: &str) -> Vec<&'static str> {
    let known = || REGISTRY.settings.iter().map(|setting| setting.path.as_str());
    if let Some(same) = known().find(|path| path.eq_ignore_ascii_case(name)) {
        return vec![same];
    }
    let nearest = |among: &[&'static str]| among.iter().copied().min_by_key(|path| levenshtein(path, name));
    let called: Vec<&str> = known().filter(|path| is_called(path, name)).collect();
    let section = |path: &str| path.rsplit_once('.').map(|(section, _)| section.to_string());
    let beside = known().filter(|path| name.contains('.') && section(path) == section(name));
    let beside: Vec<&str> = beside.filter(|path| levenshtein(last_part(path), last_part(name)) <= TYPOS).collect();
    if let Some(nearest) = nearest(&beside) {
        return vec![nearest];
    }
    // `perturb.steps` stands in the section of each site.
    let below: Vec<&str> = section(name).map_or(Vec::new(), |section| {
        called.iter().copied().filter(|path| path.starts_with(&format!("{section}."))).collect()
    });
    if below.len() > 1 {
        return below;
    }
    match (name.contains('.'), called.is_empty()) {
        // A section is named: the one that comes nearest.
        (true, false) => nearest(&called).into_iter().collect(),
        (true, true) => nearest(&known().collect::<Vec<_>>()).into_iter().collect(),
        (false, false) => settings_called(name),
        (false, true) => {
            let away = |path: &&str| levenshtein(last_part(path), name);
            let least = known().map(|path| away(&path)).min();
            shallowest(known().filter(|path| Some(away(path)) == least))
        }
    }
}

fn last_part(path: &str) -> &str {
    path.rsplit('.').next().expect("split gives one")
}

/// Those in the fewest sections, the first few.
fn shallowest(paths: impl Iterator<Item = &'static str>) -> Vec<&'static str> {
    let depth = |path: &str| path.matches('.').count();
    let paths: Vec<&str> = paths.collect();
    let least = paths.iter().map(|path| depth(path)).min();
    paths.into_iter().filter(|path| Some(depth(path)) == least).take(MOST_MEANT).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::layers::leaves;
    use crate::settings::types::choices;
    use crate::settings::{
        Config, CorruptionConfig, DataConfig, EvalConfig, FieldConfig, HashConfig, MeshConfig, PerturbConfig,
        PlanesConfig, RegularizerConfig, SamplingConfig, SrnConfig, TrainConfig, VolumeConfig,
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
        add("field.hash.", choices::<HashConfig>());
        add("sampling.", choices::<SamplingConfig>());
        add("train.", choices::<TrainConfig>());
        add("regularizer.", choices::<RegularizerConfig>());
        add("eval.", choices::<EvalConfig>());
        add("eval.mesh.", choices::<MeshConfig>());
        add("srn.", choices::<SrnConfig>());
        add("nv.", choices::<VolumeConfig>());
        add("llff.", choices::<PlanesConfig>());
        // Section perturb is read and written by hand: what it writes, and a key that it only reads.
        let perturb = toml::Table::try_from(PerturbConfig::default().resolve(1.0, 1, 256).into_draft()).unwrap();
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
    fn mistaken_names_are_answered_with_what_they_mean() {
        for (mistake, right) in [
            ("steps", "'train.steps' or 'srn.steps'"),
            ("stepz", "'train.steps' or 'srn.steps' or 'nv.step'"),
            ("train.step", "'train.steps'"),
            ("data.rays", "'train.rays'"),
            ("learning_rate", "'train.learning_rate'"),
            ("optimizer.learning_rate", "'train.learning_rate'"),
            ("width", "'data.width' or 'field.width' or 'srn.width'"),
            ("sed", "'seed'"),
            ("perturb.q.epsilon", "'perturb.t.epsilon'"),
            ("perturb.rgb.epsilom", "'perturb.rgb.epsilon'"),
            ("trian.steps", "'train.steps'"),
            ("train.lr", "'train.learning_rate'"),
            ("lr", "'train.learning_rate'"),
            ("optim.LR", "'train.learning_rate'"),
            ("train.learn_rate", "'train.learning_rate'"),
        ] {
            assert_eq!(meant(mistake), right, "{mistake}");
        }
        assert_eq!(nearly("train.stepz").as_deref(), Some("'train.steps'"));
        assert_eq!((nearly("sigma"), nearly("lr").as_deref()), (None, Some("'train.learning_rate'")));
        assert_eq!(settings_called("train.steps"), ["train.steps", "srn.steps"]);
        assert!(settings_called("rows").is_empty());
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
