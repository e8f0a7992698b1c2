//! The table of settings for readers: `docs/settings.md` and `augnerf settings`.

use std::fmt::Write;

use serde::Serialize;
use toml::{Table, Value};

use super::layers::Preset;
use super::registry::{Effect, REGISTRY, Setting, nearly};
use super::{Config, value_at};
use crate::base::{Error, Result};

const HEAD: &str = "\
# Settings

This page lists every setting of an experiment. TOML files (`--config`), `--set section.field=value` and sweep files use
the same names. The page is generated from the program. `augnerf settings WORD` prints its rows in a terminal, and
`augnerf train --print-config` prints the settings that a run would use.

- *Default* applies unless a preset, a method or the scene overrides it. *Empty* is filled from the scene or the attack.
- *Changes* says what a setting can change: **numbers** (a weight or a metric; it counts in the run's hash), **work**
  (how often the run logs, saves and evaluates), **place** (a path) or **output** (additional images and measurements).
- *Protocol* names the columns of `metrics.csv` and of tables that depend on the setting.
";

/// Returns the page `docs/settings.md`.
pub fn settings_page() -> String {
    let mut page = HEAD.to_string();
    let defaults = Config::default().to_table();
    let top = ("", "Experiment", "");
    let sections = REGISTRY.sections.iter().map(|row| (row.path.as_str(), row.path.as_str(), row.doc.as_str()));
    for (path, title, doc) in std::iter::once(top).chain(sections) {
        let own: Vec<&Setting> = REGISTRY.settings.iter().filter(|setting| setting.section() == path).collect();
        if own.is_empty() {
            continue;
        }
        let title = if path.is_empty() { title.to_string() } else { format!("`{title}`") };
        let doc = if doc.is_empty() { String::new() } else { format!("{doc}\n\n") };
        let _ = write!(page, "\n## {title}\n\n{doc}");
        page.push_str("| setting | default | values | what it is | changes | protocol |\n|---|---|---|---|---|---|\n");
        for setting in own {
            let columns: Vec<String> = setting.rule.all_columns().map(|column| format!("`{column}`")).collect();
            let cells = [
                format!("`{}`", setting.key()),
                code(value_at(&defaults, &setting.path)),
                setting.values(),
                setting.doc.clone(),
                setting.rule.effect.name().into(),
                columns.join(", "),
            ];
            let _ = writeln!(page, "| {} |", cells.map(|cell| cell.replace('|', "\\|")).join(" | "));
        }
    }
    page + &presets()
}

/// Returns the section on what each preset sets.
fn presets() -> String {
    let tables: Vec<(&str, Table)> = Preset::all().map(|(name, preset)| (name, preset.table())).collect();
    let mut text =
        "\n## Presets\n\nWhat `--preset` sets over the defaults; an empty cell is the default.\n\n".to_string();
    let names: Vec<&str> = tables.iter().map(|(name, _)| *name).collect();
    let _ = writeln!(text, "| setting | {} |\n|---|{}", names.join(" | "), "---|".repeat(names.len()));
    let is_set = |path: &str| tables.iter().any(|(_, table)| value_at(table, path).is_some());
    for setting in REGISTRY.settings.iter().filter(|setting| is_set(&setting.path)) {
        let value =
            |(_, table): &(&str, Table)| value_at(table, &setting.path).map_or(String::new(), |v| code(Some(v)));
        let cells: Vec<String> = tables.iter().map(value).collect();
        let _ = writeln!(text, "| `{}` | {} |", setting.path, cells.join(" | "));
    }
    text
}

/// Returns what `augnerf settings` prints: every setting whose path or text contains all words of `filter`, or what this
/// program calls them.
///
/// # Errors
/// If no setting contains `filter`.
pub fn settings_text(filter: Option<&str>) -> Result<String> {
    let told = filter.and_then(|word| Some(format!("here '{word}' is '{}':\n", our_word(&word.to_lowercase())?)));
    let entry = |SettingRow { setting, default, values, what, changes, .. }: SettingRow| {
        let default = default.map_or("empty".into(), |default| default.to_string());
        let changes = if changes == Effect::Numbers.name() {
            "changes numbers".into()
        } else if changes == Effect::Path.name() {
            "is a path and changes no numbers".into()
        } else {
            format!("changes {changes}, no numbers")
        };
        format!("{setting} = {default}\n    {what}\n    {values}; {changes}\n")
    };
    Ok(told.into_iter().chain(settings_rows(filter)?.into_iter().map(entry)).collect())
}

/// Returns the same settings as rows for other programs.
///
/// # Errors
/// If no setting contains `filter`.
pub fn settings_rows(filter: Option<&str>) -> Result<Vec<SettingRow>> {
    let defaults = Config::default().to_table();
    let row = |setting: &'static Setting| SettingRow {
        setting: &setting.path,
        default: value_at(&defaults, &setting.path).cloned(),
        values: setting.values(),
        what: &setting.doc,
        changes: setting.rule.effect.name(),
        columns: setting.rule.all_columns().collect(),
    };
    Ok(found(filter)?.into_iter().map(row).collect())
}

/// A setting as another program reads it.
#[derive(Clone, Debug, Serialize)]
pub struct SettingRow {
    /// Its dotted name.
    pub setting: &'static str,
    /// The default. `None` if it is left open.
    pub default: Option<Value>,
    /// The allowed values, in words.
    pub values: String,
    /// What the setting is.
    pub what: &'static str,
    /// What it can change: `numbers`, `work`, `place` or `output`.
    pub changes: &'static str,
    /// The columns of the protocol that depend on it.
    pub columns: Vec<&'static str>,
}

/// Returns the settings whose path or text contains `filter`.
fn found(filter: Option<&str>) -> Result<Vec<&'static Setting>> {
    let filter = filter.unwrap_or_default().to_lowercase();
    let sought: Vec<&str> = std::iter::once(filter.as_str()).chain(our_word(&filter)).collect();
    let holds = |setting: &&Setting| {
        let text = format!("{} {}", setting.path, setting.doc.to_lowercase());
        sought.iter().any(|words| words.split_whitespace().all(|word| text.contains(word)))
    };
    let found: Vec<&Setting> = REGISTRY.settings.iter().filter(holds).collect();
    if found.is_empty() {
        return Err(Error::Config(format!("no setting mentions '{filter}'; {}", advice(&filter))));
    }
    Ok(found)
}

/// Words of other programs or spellings, and the words of settings here.
const OTHER_WORDS: [(&str, &str); 21] = [
    ("aabb", "box"),
    ("adversarial", "perturb"),
    ("augment", "perturb"),
    ("augmentation", "perturb"),
    ("batch_size", "train.rays"),
    ("epochs", "train.steps"),
    ("iterations", "train.steps"),
    ("lr", "learning_rate"),
    ("max_steps", "train.steps"),
    ("pgd", "perturb"),
    ("regularisation", "regularizer"),
    ("regulariser", "regularizer"),
    ("regularization", "regularizer"),
    ("regularizers", "regularizer"),
    ("resolution", "downscale"),
    ("sigma", "density"),
    ("smooth", "regularizer"),
    ("smoothness", "regularizer"),
    ("sparsity", "regularizer"),
    ("total variation", "regularizer"),
    ("tv", "regularizer.weight"),
];

pub(super) fn our_word(word: &str) -> Option<&'static str> {
    OTHER_WORDS.iter().find(|(other, _)| *other == word).map(|(_, ours)| *ours)
}

/// Returns what to search for if no setting mentions `filter`.
fn advice(filter: &str) -> String {
    nearly(filter).map_or("`augnerf settings` lists all".into(), |near| format!("did you mean {near}?"))
}

fn code(value: Option<&Value>) -> String {
    value.map_or("empty".into(), |value| format!("`{value}`"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_word_that_no_setting_mentions_is_answered_with_what_to_try() {
        for (word, answer) in [
            ("train.stepz", "did you mean 'train.steps'?"),
            ("total nothing", "`augnerf settings` lists all"),
            ("zzzz", "`augnerf settings` lists all"),
        ] {
            let message = settings_text(Some(word)).unwrap_err().to_string();
            assert_eq!(message, format!("no setting mentions '{word}'; {answer}"));
        }
        for (word, ours) in OTHER_WORDS {
            let (listed, ours) = (settings_text(Some(word)).unwrap(), settings_rows(Some(ours)).unwrap());
            assert!(ours.iter().all(|row| listed.contains(row.setting)), "{word}");
        }
        let tv = settings_text(Some("tv")).unwrap();
        assert!(tv.contains("regularizer.weight") && tv.contains("tv 3.8e-6"), "{tv}");
        for (setting, changes) in [
            ("train.steps", "; changes numbers\n"),
            ("train.log_every", "; changes work, no numbers\n"),
            ("data.dir", "; is a path and changes no numbers\n"),
            ("eval.pictures", "; changes output, no numbers\n"),
        ] {
            assert!(settings_text(Some(setting)).unwrap().contains(changes), "{setting}");
        }
        let two = settings_text(Some("learning rate")).unwrap();
        assert!(two.contains("train.learning_rate") && !two.contains("train.steps"), "{two}");
    }
}
