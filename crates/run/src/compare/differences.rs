//! Differences between runs that are shown together.

use serde::Serialize;

use super::run_view::{RunView, settings};
use crate::run::columns;
use crate::settings::Config;
use crate::settings::columns::{Column, find};
use crate::settings::registry::REGISTRY;

/// A field or setting in which runs differ.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// A field of the protocol, or a setting of `config.toml` without such a field.
    pub name: String,
    /// Each run's value; empty if it has none.
    pub values: Vec<String>,
}

/// Returns whether a protocol column shows the setting.
fn has_column(setting: &str) -> bool {
    REGISTRY.get(setting).is_some_and(|setting| setting.rule.all_columns().next().is_some())
}

/// Returns whether other columns and settings decide the column.
fn is_derived(column: &str) -> bool {
    find(column).is_some_and(Column::is_derived)
}

/// Returns in what the runs differ: protocol fields first, then settings without such a field.
pub fn differences(runs: &[&RunView]) -> Vec<Difference> {
    let mut found = differing(runs.iter().map(|run| columns(&run.protocol)).collect(), is_derived);
    found.extend(differing(runs.iter().map(|run| run.settings.clone()).collect(), has_column));
    found
}

/// Returns the settings that can change a number in which configurations differ, except for the seed.
pub fn differing_settings(configs: &[&Config]) -> Vec<Difference> {
    differing(configs.iter().map(|config| settings(config)).collect(), |name| name == "seed")
}

/// Returns the names whose values differ between rows, without those to `skip`. A setting of the perturbed pass counts
/// only for rows that have one.
fn differing(rows: Vec<Vec<(String, String)>>, skip: fn(&str) -> bool) -> Vec<Difference> {
    let mut found = Vec::new();
    let names = rows.iter().flatten().map(|(name, _)| name).collect::<Vec<_>>();
    for (index, name) in names.iter().enumerate() {
        if skip(name) || names[..index].contains(name) {
            continue;
        }
        let value = |row: &Vec<(String, String)>| row.iter().find(|(own, _)| own == *name).map(|(_, v)| v.clone());
        let values: Vec<Option<String>> = rows.iter().map(value).collect();
        let mut counted = values.iter().filter(|value| value.is_some() || !name.starts_with("perturb."));
        let first = counted.next();
        if counted.any(|value| Some(value) != first) {
            let values = values.into_iter().map(Option::unwrap_or_default).collect();
            found.push(Difference { name: name.to_string(), values });
        }
    }
    found
}

/// Returns one run's side of the differences as a line of text.
pub(super) fn difference_text(differences: &[Difference], run: usize) -> String {
    let own = differences.iter().filter(|difference| !difference.values[run].is_empty());
    let named = own.map(|difference| {
        let Difference { name, values } = difference;
        // A setting keeps its name for --set; a protocol field becomes words.
        let name = if name.contains('.') { name.clone() } else { name.replace('_', " ") };
        format!("{name} {}", short(&values[run]))
    });
    named.collect::<Vec<String>>().join("; ")
}

/// Rounds long fractions in a text to four digits: 0.8333333333333334 as 0.8333. Files have all digits.
fn short(text: &str) -> String {
    let rounded = |part: &str| {
        let end = part.trim_end_matches([' ', ',', '/', ';']);
        match end.parse::<f64>() {
            Ok(number) if end.len() > 8 && end.contains('.') => {
                let number: f64 = format!("{number:.3e}").parse().expect("written as a number");
                format!("{number}{}", &part[end.len()..])
            }
            _ => part.to_string(),
        }
    };
    text.split_inclusive([' ', ',', '/', ';']).map(rounded).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_fractions_are_rounded_and_nothing_else_is_changed() {
        let text = "t 3/0.8333333333333334/0.25, rgb 1/2.5/0.01568627450980392";
        assert_eq!(short(text), "t 3/0.8333/0.25, rgb 1/2.5/0.01569");
        for same in ["709e22912345", "coarse 0, fine 1", "0.00001", "123456789", ""] {
            assert_eq!(short(same), same);
        }
    }

    #[test]
    fn what_the_protocol_speaks_of_is_not_told_twice() {
        for setting in ["seed", "train.learning_rate", "perturb.t.steps", "perturb.rgb.epsilon", "data.corruption.kind"]
        {
            assert!(has_column(setting), "{setting}");
        }
        for setting in ["train.warmup_share", "perturb.t.norm", "field.encoding", "sampling.jitter"] {
            assert!(has_column(setting), "{setting}");
        }
        for setting in ["train.log_every", "data.recentre", "data.near"] {
            assert!(!has_column(setting), "{setting}");
        }
    }
}
