//! What a reader must know before the numbers of a table.

use super::Line;
use super::text::{joined, seeds_of_one_colour, status_and_reason, unmeasured_notes};
use crate::report::distinct;
use crate::settings::columns::{INACTIVE_BY, InactiveBy};

/// End of a warning whose details stand in a table of their own.
pub const SEE_ATTACK: &str = " (see Attack)";

/// Returns what a reader must know before the numbers, in one line for each fact: lines that are not comparable,
/// unfinished, without effect of the attack or different between seeds, and metrics without numbers.
pub fn warnings(lines: &[&Line]) -> Vec<String> {
    let measured = lines.iter().filter(|line| !line.ids.is_empty()).count();
    let grouped = |start: &str, of: &dyn Fn(&Line) -> Option<String>| -> Option<String> {
        let facts = distinct(lines.iter().filter_map(|line| of(line)));
        let rows = |fact: &String| {
            let labels = lines.iter().filter(|line| of(line).as_ref() == Some(fact)).map(|line| line.label.as_str());
            format!("{}: {fact}", rows_text(&labels.collect::<Vec<&str>>(), measured))
        };
        (!facts.is_empty()).then(|| format!("{start}: {}", facts.iter().map(rows).collect::<Vec<String>>().join("; ")))
    };
    let marked = [
        grouped("NOT COMPARABLE, built by force; differ from the scene's first row", &|line| joined(&line.mixed)),
        grouped("NOTHING LEARNED", &|line| {
            let seeds = seeds_of_one_colour(line)?;
            Some(format!("no better than one colour{}{seeds}", if seeds.is_empty() { "" } else { " with " }))
        }),
        grouped("points without numbers", &|line| line.unfinished().then(|| status_and_reason(line))),
    ];
    let by_site = InactiveBy::ALL.into_iter().filter_map(|by| inactive_warning(lines, by));
    let differing = grouped("settings differ between seeds", &|line| joined(&line.differs));
    marked.into_iter().flatten().chain(by_site).chain(differing).chain(unmeasured_notes(lines)).collect()
}

/// Returns in how many rows each site was inactive: `view in all 26 rows, t in 25`.
fn inactive_warning(lines: &[&Line], by: InactiveBy) -> Option<String> {
    let own: Vec<&&Line> = lines.iter().filter(|line| line.inactive_sites(by).is_some()).collect();
    let attacked = lines.iter().filter(|line| !line.protocol(INACTIVE_BY).is_empty()).count();
    let sites = distinct(own.iter().flat_map(|line| line.inactive_levels.iter().map(String::as_str)));
    let mut counts: Vec<(&str, usize)> = sites
        .into_iter()
        .map(|site| (site, own.iter().filter(|line| line.inactive_levels.iter().any(|own| own == site)).count()))
        .collect();
    counts.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    let text = |(index, (site, count)): (usize, &(&str, usize))| {
        let all = if *count == attacked && attacked > 1 { "all " } else { "" };
        let rows = if index == 0 { if *count == 1 { " row" } else { " rows" } } else { "" };
        format!("{site} in {all}{count}{rows}")
    };
    let said: Vec<String> = counts.iter().enumerate().map(text).collect();
    (!said.is_empty()).then(|| format!("{}: {}{SEE_ATTACK}", by.meaning(), said.join(", ")))
}

/// Most rows that a warning names.
const NAMED: usize = 3;

fn rows_text(labels: &[&str], measured: usize) -> String {
    match labels.len() {
        1 => labels[0].to_string(),
        all if all == measured => "all rows".into(),
        many if many > NAMED => format!("{many} rows"),
        _ => labels.join(", "),
    }
}
