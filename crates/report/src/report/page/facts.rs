//! The head of the page: what it shows, and what a reader must know before any number.

use std::collections::BTreeSet;

use crate::report::tables::text::{of_rows, warnings as warnings_of};
use crate::report::tables::{Table, epochs_of, is_brief};
use crate::report::{Record, Status, distinct};

/// Most scenes whose names are a fact.
const MOST_SCENES: usize = 6;

/// Returns name and text of each fact.
pub fn facts(table: &Table, records: &[Record]) -> Vec<(&'static str, String)> {
    let ids = |status: Status| {
        let of_status = records.iter().filter(|record| record.status == status);
        distinct(of_status.map(|record| record.id.as_str())).len()
    };
    let counts = Status::ALL.into_iter().map(|status| (status.name(), ids(status))).filter(|(_, count)| *count > 0);
    let counts: Vec<String> = counts.map(|(name, count)| format!("{count} {name}")).collect();
    let of_column = |name: &str| {
        let texts = records.iter().filter(|record| record.status == Status::Done).map(|record| record.protocol(name));
        distinct(texts.filter(|text| !text.is_empty())).join(", ")
    };
    let facts = [
        ("Points", counts.join(", ")),
        ("Seeds", seeds_text(records.iter().filter_map(|record| record.seed).collect())),
        ("Scenes", scene_names(table)),
        ("Held-out views", of_column("views_evaluated")),
        ("Training steps", of_column("steps")),
        ("Each training pixel seen", epochs_of(&table.lines).map_or_else(String::new, |seen| format!("{seen} times"))),
        ("Device", of_column("device")),
        ("Revision", of_column("code_revision")),
        ("Protocol", of_column("protocol")),
    ];
    facts.into_iter().filter(|(_, text)| !text.is_empty()).collect()
}

/// Returns seeds as `--seeds` takes them: `0-99, 200`.
fn seeds_text(seeds: BTreeSet<u64>) -> String {
    let mut ranges: Vec<(u64, u64)> = Vec::new();
    for seed in seeds {
        match ranges.last_mut().filter(|(_, last)| last + 1 == seed) {
            Some((_, last)) => *last = seed,
            None => ranges.push((seed, seed)),
        }
    }
    let text = |(first, last): &(u64, u64)| match last - first {
        0 => first.to_string(),
        1 => format!("{first}, {last}"),
        _ => format!("{first}-{last}"),
    };
    ranges.iter().map(text).collect::<Vec<String>>().join(", ")
}

/// Names of few scenes, and the number of many, which head the tables.
fn scene_names(table: &Table) -> String {
    let scenes: Vec<&str> = table.scenes().iter().map(|(scene, _)| *scene).collect();
    if scenes.len() > MOST_SCENES { scenes.len().to_string() } else { scenes.join(", ") }
}

/// Returns the warnings that come first: rows by their marks, and what holds for the table.
pub fn warnings(table: &Table, records: &[Record]) -> Vec<String> {
    let mut warnings = warnings_of(table);
    let brief = table.lines.iter().filter(|line| is_brief(line)).count();
    if brief > 0 {
        warnings.push(format!("each training pixel seen less than once: {}", of_rows(table, brief)));
    }
    let done = records.iter().filter(|record| record.status == Status::Done);
    if distinct(done.filter_map(|record| record.seed)).len() == 1
        && table.lines.iter().any(|line| line.baseline.is_some())
    {
        warnings.push("one seed: no spread, no interval and no test is known".into());
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_seeds_are_ranges() {
        let texts = [(0..100).collect(), [7, 3, 4].into(), [0, 1, 2, 9].into(), [].into()].map(seeds_text);
        assert_eq!(texts, ["0-99", "3, 4, 7", "0-2, 9", ""]);
    }
}
