//! The registry of settings: each setting's path, text, allowed values, effects and protocol columns, stated once.
//! Hashes, checks, known keys, comparability and `docs/settings.md` follow from it. Sections fill it.

use std::sync::LazyLock;

use serde::Serialize;
use strsim::levenshtein;

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
    use crate::settings::{Config, DataKind, Extent};

    /// What a configuration file may hold is what the table lists, each once and with words.
    #[test]
    fn every_key_of_a_file_is_one_entry() {
        let extent = Extent { near: 2.0, far: 6.0, domain: None, pixels: 16 };
        let run = Config::default().resolve(DataKind::BuiltinBlender, extent).unwrap().into_draft().to_table();
        assert!(leaves(&run, "").iter().all(|key| REGISTRY.get(key).is_some()));
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
