//! The registry of settings: each setting's path, text, allowed values, effects and protocol columns, stated once.
//! Hashes, checks, known keys, comparability and `docs/settings.md` follow from it. Sections fill it.

use std::sync::LazyLock;

use serde::Serialize;
use strsim::levenshtein;

use super::document::our_word;
use crate::base::SettingError;
pub use crate::base::settings::{Effect, Range, Registry, Rule, Section, SectionRow, Setting};

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
pub fn check_flag(flag: &str, path: &str, value: impl Serialize) -> Result<(), SettingError> {
    REGISTRY.get(path).expect("the path of a setting").rule.check(flag, value)
}

/// Largest number of settings that are suggested for a mistaken name.
const MOST_MEANT: usize = 3;

/// Returns the settings whose last part is that of `name`, in the section that it names. `steps` gives `train.steps`, `lr`
/// gives `train.learning_rate`, and `width` both `data.width` and `field.width`. Words for other things, such as epochs, give none.
pub fn settings_called(name: &str) -> Vec<&'static str> {
    let (distance, nearest) = nearest(name);
    let is_name = our_word(name).is_none() || SAME_THINGS.contains(&name);
    if distance == 0 && is_name { nearest } else { Vec::new() }
}

/// Other programs' words for the same things.
const SAME_THINGS: [&str; 4] = ["batch_size", "iterations", "lr", "max_steps"];

/// Returns the settings that a mistaken name may have meant, in words.
pub(super) fn meant(name: &str) -> String {
    in_words(&nearest(name).1)
}

/// Returns the same for a word that need not be a name: `None` if no setting is near.
pub(super) fn nearly(word: &str) -> Option<String> {
    let (distance, nearest) = nearest(word);
    (distance <= 2 * (word.len() / 3)).then(|| in_words(&nearest))
}

fn split(name: &str) -> (&str, &str) {
    name.rsplit_once('.').unwrap_or(("", name))
}

fn in_words(paths: &[&str]) -> String {
    paths.iter().map(|path| format!("'{path}'")).collect::<Vec<_>>().join(" or ")
}

/// Returns the settings nearest to a name, those in the fewest sections, with their distance: twice Levenshtein's of the last
/// parts, and that of the sections. A section around or in that of the setting is at distance 0, and so is none.
fn nearest(name: &str) -> (usize, Vec<&'static str>) {
    let settings = || REGISTRY.settings.iter();
    let is_known = |name: &str| settings().any(|setting| setting.key() == split(name).1);
    let mut name = name.to_lowercase();
    if let Some(ours) = our_word(split(&name).1).filter(|ours| !is_known(&name) && is_known(ours)) {
        name = ours.into();
    }
    let (section, key) = split(&name);
    let rank = |setting: &Setting| {
        let own = setting.section();
        let is_inside = section.is_empty() || format!(".{own}.").contains(&format!(".{section}."));
        let of_sections = if is_inside { 0 } else { levenshtein(own, section) };
        (2 * levenshtein(setting.key(), key) + of_sections, setting.path.matches('.').count())
    };
    let least = settings().map(rank).min().expect("there are settings");
    let nearest = settings().filter(|setting| rank(setting) == least).map(|setting| setting.path.as_str());
    (least.0, nearest.take(MOST_MEANT).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{Config, DataKind, Extent, leaves};

    /// What a configuration file may hold is what the table lists, each once and with words.
    #[test]
    fn every_key_of_a_file_is_one_entry() {
        let extent = Extent { near: 2.0, far: 6.0, domain: None, pixels: 16 };
        let run = Config::default().resolve(DataKind::BuiltinBlender, extent).unwrap().into_draft().to_table();
        assert!(leaves(&run).iter().all(|(key, _)| REGISTRY.get(key).is_some()));
        for Setting { path, doc, .. } in &REGISTRY.settings {
            assert!(!doc.is_empty(), "{path}");
            assert_eq!(REGISTRY.settings.iter().filter(|setting| setting.path == *path).count(), 1, "{path}");
            let refusal = toml::from_str::<Config>(&format!("{path} = {{ }}")).unwrap_err().to_string();
            assert!(!refusal.contains("unknown field"), "{refusal}");
        }
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
            // A setting that a draft leaves open.
            ("eval.mesh.treshold", "'eval.mesh.threshold'"),
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
        assert_eq!(settings_called("train.steps"), ["train.steps"]);
        assert_eq!((settings_called("lr"), settings_called("epochs")), (vec!["train.learning_rate"], vec![]));
        assert!(settings_called("rows").is_empty());
    }

    #[test]
    fn a_value_out_of_range_is_named_with_its_range_as_data() {
        let mut config = Config::default();
        config.eval.mesh.points = 3;
        let words = "eval.mesh.points = 3 is out of range: it must be 100 to 20000000";
        assert_eq!(config.check_ranges().unwrap_err().to_string(), words);
        let words = words.replace("eval.mesh.points", "--points");
        assert_eq!(check_flag("--points", "eval.mesh.points", 3usize).unwrap_err().to_string(), words);
        check_flag("--points", "eval.mesh.points", 100usize).unwrap();
    }

    #[test]
    fn defaults_are_in_their_ranges_and_the_ends_of_ranges_count() {
        Config::default().check_ranges().unwrap();
        for (path, inside, outside) in [("train.warmup_share", 1.0, 1.1), ("train.dead_start_share", 0.99, 1.0)] {
            check_flag(path, path, inside).unwrap();
            check_flag(path, path, outside).unwrap_err();
        }
        check_flag("seed", "seed", i64::MAX as u64).unwrap();
        check_flag("seed", "seed", i64::MAX as u64 + 1).unwrap_err();
        check_flag("near", "data.near", f64::INFINITY).unwrap_err();
        let refusal = Config::from_toml("seed = 9223372036854775808", "config.toml").unwrap_err().to_string();
        assert!(refusal.contains("seed") && refusal.contains("2^63"), "{refusal}");
    }
}
