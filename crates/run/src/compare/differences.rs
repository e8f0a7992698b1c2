//! Differences between runs that are shown together.

use serde::Serialize;

use super::run_view::{RunView, settings};
use crate::draw::numbers::rounded;
use crate::run::{Protocol, columns};
use crate::settings::Config;
use crate::settings::columns::find;
use crate::settings::registry::REGISTRY;

/// A field or setting in which runs differ.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// A field of the protocol, or a setting of `config.toml` without such a field.
    pub name: String,
    /// Each run's value; empty if it has none.
    pub values: Vec<String>,
}

/// The JSON file of runs that are shown together: what they share, what `T` says of all, and what `R` says of each.
#[derive(Serialize)]
pub(super) struct File<'a, T, R> {
    scene: String,
    view: &'a str,
    index: usize,
    #[serde(flatten)]
    facts: T,
    differences: Vec<Difference>,
    runs: Vec<Line<'a, R>>,
}

#[derive(Serialize)]
struct Line<'a, R> {
    run: &'a str,
    #[serde(flatten)]
    facts: R,
    protocol: &'a Protocol,
}

impl<'a, T, R> File<'a, T, R> {
    pub(super) fn new(facts: T, runs: impl Iterator<Item = (&'a RunView, R)>) -> File<'a, T, R> {
        let (shown, facts_of): (Vec<&RunView>, Vec<R>) = runs.unzip();
        let line = |(run, facts): (&&'a RunView, R)| Line { run: &run.label, facts, protocol: &run.protocol };
        let first = shown[0];
        File {
            scene: first.protocol.text("scene"),
            view: &first.view.name,
            index: first.index,
            facts,
            differences: differences(&shown),
            runs: shown.iter().zip(facts_of).map(line).collect(),
        }
    }
}

/// Returns whether a protocol column shows the setting.
fn has_column(setting: &str) -> bool {
    REGISTRY.get(setting).is_some_and(|setting| setting.rule.all_columns().next().is_some())
}

/// Returns whether other columns and settings decide the column.
fn is_derived(column: &str) -> bool {
    find(column).is_some_and(|column| column.is_derived(&REGISTRY))
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

/// Most differences in a line of text, where none of [`FIRST`] differs.
const TOLD: usize = 3;
/// Columns that say most about a run, and whose value says what it is of.
const FIRST: [&str; 5] = ["method", "regularizers", "perturb_kind", "attack", "corruption"];

/// Returns one run's side of the differences that matter most as a line of text: `tv 3e-7`.
pub(super) fn difference_text(differences: &[Difference], run: usize) -> String {
    let told = |difference: &&Difference| !difference.values[run].is_empty();
    let first: Vec<&Difference> =
        FIRST.iter().filter_map(|name| differences.iter().find(|difference| difference.name == *name)).collect();
    if !first.is_empty() {
        let seed = differences.iter().filter(|difference| difference.name == "seed" && told(difference));
        let seed = seed.map(|difference| format!("seed {}", difference.values[run]));
        let values = first.into_iter().filter(told).map(|difference| rounded(&difference.values[run])).chain(seed);
        return values.collect::<Vec<String>>().join("; ");
    }
    let named = differences.iter().filter(told).take(TOLD).map(|Difference { name, values }| {
        // A setting keeps its name for --set; a protocol field becomes words.
        let name = if name.contains('.') { name.clone() } else { name.replace('_', " ") };
        format!("{name} {}", rounded(&values[run]))
    });
    named.collect::<Vec<String>>().join("; ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_differences_is_short_and_says_what_matters_first() {
        let difference = |name: &str, value: &str| Difference { name: name.into(), values: vec![value.into()] };
        let told = ["density_activation", "field_width", "regularizers", "data.near"].map(|name| match name {
            "regularizers" => difference(name, "tv 0.0000003"),
            name => difference(name, "1"),
        });
        assert_eq!(difference_text(&told, 0), "tv 3e-7");
        assert_eq!(difference_text(&told[..2], 0), "density activation 1; field width 1");
        assert_eq!(difference_text(&[], 0), "");
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
