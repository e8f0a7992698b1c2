//! The head of the page: what it shows, and what a reader must know before any number.

use crate::draw::numbers::rounded;
use crate::report::tables::Table;
use crate::report::tables::text::warnings as warnings_of;
use crate::report::{Record, Status, distinct};

/// Returns name and text of each fact.
pub fn facts(table: &Table, records: &[Record]) -> Vec<(&'static str, String)> {
    let ids = |status: Status| {
        let of_status = records.iter().filter(|record| record.status == status);
        distinct(of_status.map(|record| record.id.as_str())).len()
    };
    let counts = Status::ALL.into_iter().map(|status| (status.name(), ids(status))).filter(|(_, count)| *count > 0);
    let counts: Vec<String> = counts.map(|(name, count)| format!("{count} {name}")).collect();
    let seeds: Vec<String> =
        distinct(records.iter().filter_map(|record| record.seed)).iter().map(u64::to_string).collect();
    let of_column = |name: &str| {
        let texts = records.iter().filter(|record| record.status == Status::Done).map(|record| record.protocol(name));
        distinct(texts.filter(|text| !text.is_empty())).join(", ")
    };
    let facts = [
        ("Points", counts.join(", ")),
        ("Seeds", seeds.join(", ")),
        ("Scenes", table.scenes().iter().map(|(scene, _)| *scene).collect::<Vec<&str>>().join(", ")),
        ("Held-out views", of_column("views_evaluated")),
        ("Training steps", of_column("steps")),
        ("Device", of_column("device")),
        ("Revision", of_column("code_revision")),
        ("Protocol", of_column("protocol")),
    ];
    facts.into_iter().filter(|(_, text)| !text.is_empty()).collect()
}

/// Returns the warnings that come first.
pub fn warnings(table: &Table, records: &[Record]) -> Vec<String> {
    let several = table.scenes().len() > 1;
    let of_scene = |(scene, lines): (&str, Vec<_>)| {
        let scene = scene.to_string();
        let named = move |warning: String| rounded(&if several { format!("{scene}: {warning}") } else { warning });
        warnings_of(&lines).into_iter().map(named)
    };
    let mut warnings: Vec<String> = table.scenes().into_iter().flat_map(of_scene).collect();
    let done = records.iter().filter(|record| record.status == Status::Done);
    if distinct(done.filter_map(|record| record.seed)).len() == 1
        && table.lines.iter().any(|line| line.baseline.is_some())
    {
        warnings.push("one seed: no spread, no interval and no test is known".into());
    }
    warnings
}
