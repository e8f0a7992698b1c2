//! What a reader must know before the numbers of a table.

use super::Line;
use super::text::{few_of_one_colour, joined, most_of_one_colour, status_and_reason, unmeasured_notes};
use crate::report::distinct;
use crate::settings::columns::{INACTIVE_BY, InactiveBy};

/// End of a warning whose details stand in a table of their own.
pub const SEE_ATTACK: &str = " (see Attack)";

/// Returns what a reader must know before the numbers, in one line for each fact: lines that are not comparable,
/// unfinished, without effect of the attack or different between seeds, and metrics without numbers. What heads a page holds
/// for most seeds of a row.
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
            Some(format!("no better than one colour {}", most_of_one_colour(line)?).trim_end().to_string())
        }),
        grouped("points without numbers", &|line| line.unfinished().then(|| status_and_reason(line))),
    ];
    let by_site = InactiveBy::ALL.into_iter().filter_map(|by| inactive_warning(lines, by));
    let differing = grouped("settings differ between seeds", &|line| joined(&line.differs));
    let few = few_of_one_colour(lines, NAMED);
    marked.into_iter().flatten().chain(by_site).chain(differing).chain(few).chain(unmeasured_notes(lines)).collect()
}

/// Returns in how many rows each site was inactive: `view in all 26 rows, t in 25`.
fn inactive_warning(lines: &[&Line], by: InactiveBy) -> Option<String> {
    let own: Vec<&&Line> = lines.iter().filter(|line| line.inactive_sites(by).is_some()).collect();
    let attacked = lines.iter().filter(|line| !line.protocol(INACTIVE_BY).is_empty()).count();
    let sites = |line: &Line| -> Vec<String> {
        let of_most = line.inactive_levels.iter().filter(|(_, seeds)| line.is_most(*seeds));
        of_most.map(|(site, _)| site.clone()).collect()
    };
    let all: Vec<String> = own.iter().flat_map(|line| sites(line)).collect();
    let count = |site: &String| all.iter().filter(|own| *own == site).count();
    let mut counts: Vec<(&String, usize)> = distinct(all.iter()).into_iter().map(|site| (site, count(site))).collect();
    counts.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    let text = |(index, (site, count)): (usize, &(&String, usize))| {
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
