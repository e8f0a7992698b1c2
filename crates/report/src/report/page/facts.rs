//! The head of the page: what it shows, and what a reader must know before any number.

use std::collections::BTreeSet;

use crate::draw::numbers::rounded;
use crate::report::tables::text::{SEE_ATTACK, warnings as warnings_of};
use crate::report::tables::{Line, Table, epochs_note, epochs_of, is_brief};
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

/// Returns the warnings that come first.
pub fn warnings(table: &Table, records: &[Record]) -> Vec<String> {
    let scenes = table.scenes();
    let of_scene = |(scene, lines): &(&str, Vec<&Line>)| {
        let scene = scene.to_string();
        let brief = epochs_note(lines, NAMED).filter(|_| lines.iter().any(|line| is_brief(line)));
        let brief = brief.map(|note| format!("less than one epoch: {note}"));
        brief.into_iter().chain(warnings_of(lines)).map(move |warning| (scene.clone(), rounded(&warning)))
    };
    let mut warnings = by_scenes(scenes.iter().flat_map(of_scene).collect(), scenes.len());
    let done = records.iter().filter(|record| record.status == Status::Done);
    if distinct(done.filter_map(|record| record.seed)).len() == 1
        && table.lines.iter().any(|line| line.baseline.is_some())
    {
        warnings.push("one seed: no spread, no interval and no test is known".into());
    }
    warnings
}

/// Most scenes that a warning names.
const NAMED: usize = 3;

/// Returns the warnings of several scenes, each said once: of the rows that mean nothing first, and then in their order.
fn by_scenes(found: Vec<(String, String)>, scenes: usize) -> Vec<String> {
    if scenes < 2 {
        return found.into_iter().map(|(_, warning)| warning).collect();
    }
    let kind = |warning: &str| warning.split_once(':').map_or(warning, |(kind, _)| kind).to_string();
    let is_loud = |kind: &String| kind.starts_with(|first: char| first.is_uppercase());
    let mut kinds = distinct(found.iter().map(|(_, warning)| kind(warning)));
    kinds.sort_by_key(|kind| !is_loud(kind));
    let of_kind = |of: &String| {
        let own: Vec<&(String, String)> = found.iter().filter(|(_, warning)| kind(warning) == *of).collect();
        let texts = distinct(own.iter().map(|(_, warning)| warning));
        // Sites without effect differ from scene to scene, and have a table.
        if texts.len() > NAMED && texts.iter().all(|text| text.ends_with(SEE_ATTACK)) {
            return vec![format!("{}: {of}{SEE_ATTACK}", scenes_text(&own, scenes))];
        }
        let of_text = |text: &String| {
            let own: Vec<&(String, String)> = own.iter().copied().filter(|(_, own)| own == text).collect();
            format!("{}: {text}", scenes_text(&own, scenes))
        };
        texts.into_iter().map(of_text).collect()
    };
    kinds.iter().flat_map(of_kind).collect()
}

fn scenes_text(own: &[&(String, String)], scenes: usize) -> String {
    match own.len() {
        all if all == scenes => format!("all {scenes} scenes"),
        many if many > NAMED => format!("{many} of {scenes} scenes"),
        _ => own.iter().map(|(scene, _)| scene.as_str()).collect::<Vec<&str>>().join(", "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_seeds_are_ranges() {
        let texts = [(0..100).collect(), [7, 3, 4].into(), [0, 1, 2, 9].into(), [].into()].map(seeds_text);
        assert_eq!(texts, ["0-99", "3, 4, 7", "0-2, 9", ""]);
    }

    #[test]
    fn a_warning_of_many_scenes_is_said_once_and_nothing_learned_first() {
        let of = |scene: usize, warning: &str| (format!("s{scene}"), warning.to_string());
        let mut found: Vec<(String, String)> =
            (0..5).map(|scene| of(scene, &format!("sites: t in {scene} rows (see Attack)"))).collect();
        found.extend((0..5).map(|scene| of(scene, "settings differ between seeds: all rows: views_seed")));
        found.push(of(4, "NOTHING LEARNED: TV: no better than one colour"));
        let said = by_scenes(found.clone(), 5);
        let expected = [
            "s4: NOTHING LEARNED: TV: no better than one colour",
            "all 5 scenes: sites (see Attack)",
            "all 5 scenes: settings differ between seeds: all rows: views_seed",
        ];
        assert_eq!(said, expected);
        let few = by_scenes(found[..2].to_vec(), 5);
        assert_eq!(few, ["s0: sites: t in 0 rows (see Attack)", "s1: sites: t in 1 rows (see Attack)"]);
        assert_eq!(by_scenes(found[..1].to_vec(), 1), ["sites: t in 0 rows (see Attack)"]);
    }
}
