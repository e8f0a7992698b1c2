//! Effect of the attack, line by line and site by site: means of the points' logs.

use super::Line;
use super::delimited::{PLACE_COLUMNS, place_cells};
use crate::base::columns::SITES;
use crate::base::csv::{csv_number, csv_text};
use crate::report::statistics::mean;

/// Columns of a site in logs, as `COLUMN.SITE`.
const COLUMNS: [&str; 4] = ["gain", "gain_over_random", "share_at_bound", "shift"];

/// Gain, gain over random, fraction at the bound, and shift of colours in 8-bit steps. Means over logged steps, then
/// over the seeds that logged the site; `None` if none did.
pub type SiteMeans = [Option<f64>; COLUMNS.len()];

/// Effect of the attack on one line.
#[derive(Clone, Debug, PartialEq)]
pub struct AttackLine<'a> {
    /// The line.
    pub line: &'a Line,
    /// Number of its points that logged any site.
    pub seeds: usize,
    /// The sites that any of its points logged.
    pub sites: Vec<AttackSite>,
}

/// One site of one line.
#[derive(Clone, Debug, PartialEq)]
pub struct AttackSite {
    /// The site's name.
    pub site: &'static str,
    /// Means over all logged steps.
    pub whole: SiteMeans,
    /// Means over the first quarter of them, at least one.
    pub first: SiteMeans,
    /// Means over the last quarter of them, at least one.
    pub last: SiteMeans,
    /// The number of the line's seeds with which it was inactive.
    pub inactive: usize,
}

impl<'a> AttackLine<'a> {
    /// Returns the effect on a line, or `None` if no point has such logs. `numbers` returns a column of a point's log,
    /// in the order of steps.
    pub fn of(line: &'a Line, numbers: impl Fn(&str, &str) -> Vec<f64>) -> Option<AttackLine<'a>> {
        let sites: Vec<AttackSite> =
            SITES.into_iter().filter_map(|site| AttackSite::of(line, site, &numbers)).collect();
        let has_log = |id: &str| sites.iter().any(|site| columns(site.site).any(|name| !numbers(id, &name).is_empty()));
        let seeds = line.ids.iter().filter(|id| has_log(id)).count();
        (!sites.is_empty()).then_some(AttackLine { line, seeds, sites })
    }
}

impl AttackSite {
    fn of(line: &Line, site: &'static str, numbers: &impl Fn(&str, &str) -> Vec<f64>) -> Option<AttackSite> {
        let logs: Vec<Vec<Vec<f64>>> =
            columns(site).map(|name| line.ids.iter().map(|id| numbers(id, &name)).collect()).collect();
        let means = |part: fn(&[f64]) -> &[f64]| -> SiteMeans {
            std::array::from_fn(|column| {
                let seeds: Vec<f64> = logs[column].iter().filter_map(|log| mean(part(log))).collect();
                mean(&seeds)
            })
        };
        let whole = means(|log| log);
        let inactive = line.inactive_levels.iter().find(|(level, _)| level == site).map_or(0, |(_, seeds)| *seeds);
        whole.iter().any(Option::is_some).then(|| AttackSite {
            site,
            whole,
            first: means(|log| &log[..log.len().div_ceil(4)]),
            last: means(|log| &log[log.len() - log.len().div_ceil(4)..]),
            inactive,
        })
    }

    /// Returns its means, with the prefixes of their columns.
    fn spans(&self) -> [(&'static str, &SiteMeans); 3] {
        [("", &self.whole), ("first.", &self.first), ("last.", &self.last)]
    }

    /// Returns names and numbers of its columns in `attack.csv`.
    fn cells(&self) -> impl Iterator<Item = (String, Option<f64>)> {
        self.spans().into_iter().flat_map(|(span, means)| {
            columns(self.site).zip(means).map(move |(name, mean)| (format!("{span}{name}"), *mean))
        })
    }
}

/// Returns the columns of a site in a log.
fn columns(site: &str) -> impl Iterator<Item = String> {
    COLUMNS.into_iter().map(move |column| format!("{column}.{site}"))
}

/// Returns one line for each attacked line of the table: its position there, its seeds, and the means of each site
/// that any line logged. `None` if no line was attacked.
pub fn attack_csv(lines: &[AttackLine]) -> Option<String> {
    let any = |site: &str| lines.iter().flat_map(|line| &line.sites).find(|of_line| of_line.site == site);
    let columns: Vec<String> =
        SITES.into_iter().filter_map(any).flat_map(AttackSite::cells).map(|(name, _)| name).collect();
    let head = PLACE_COLUMNS.into_iter().chain(["n"]).map(String::from).chain(columns.iter().cloned()).collect();
    let rows = lines.iter().map(|line| {
        let cells: Vec<(String, Option<f64>)> = line.sites.iter().flat_map(AttackSite::cells).collect();
        let mean = |column: &String| cells.iter().find(|(name, _)| name == column).and_then(|(_, mean)| *mean);
        let means = columns.iter().map(|column| csv_number(mean(column)));
        place_cells(line.line).into_iter().chain([line.seeds.to_string()]).chain(means).collect()
    });
    (!lines.is_empty()).then(|| csv_text(std::iter::once(head).chain(rows)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::tables::Table;
    use crate::report::{PointResult, Record, RowSpec, Status, TableSpec};

    /// Two rows of two seeds each, the second's `xyz` inactive.
    fn table() -> Table {
        let names = ["NeRF", "Aug-NeRF"];
        let record = |row: &str, seed: u64| Record {
            id: format!("{row}-{seed}"),
            scene: "fern".into(),
            row: row.into(),
            seed: Some(seed),
            status: Status::Done,
            result: PointResult {
                metrics: vec![("psnr".into(), Some(20.0))],
                inactive_levels: if row == names[1] { vec!["xyz".into()] } else { vec![] },
                ..PointResult::default()
            },
            ..Record::default()
        };
        let row = |name: &&str| RowSpec { name: name.to_string(), ..RowSpec::default() };
        let spec =
            TableSpec { metrics: vec!["psnr".into()], rows: names.iter().map(row).collect(), ..TableSpec::default() };
        let records: Vec<Record> = names.iter().flat_map(|name| [0, 1].map(|seed| record(name, seed))).collect();
        Table::new(&spec, &records, false).unwrap()
    }

    /// Nine logs for one seed, one for the other, which logged no fraction at the bound.
    fn log(id: &str, column: &str) -> Vec<f64> {
        match (id, column) {
            ("Aug-NeRF-0", "shift.xyz") => (1..=9).map(f64::from).collect(),
            ("Aug-NeRF-1", "shift.xyz") => vec![11.0],
            ("Aug-NeRF-0", "share_at_bound.xyz") => vec![0.5, 0.75],
            ("Aug-NeRF-0" | "Aug-NeRF-1", "gain.feature") => vec![0.0],
            _ => vec![],
        }
    }

    #[test]
    fn means_are_over_steps_then_seeds_and_quarters_are_those_of_each_log() {
        let table = table();
        assert_eq!(AttackLine::of(&table.lines[0], log), None);
        let attack = AttackLine::of(&table.lines[1], log).unwrap();
        assert_eq!((attack.seeds, attack.sites.len()), (2, 2));
        let xyz = &attack.sites[0];
        // A quarter of nine logs is three: 1, 2, 3 and 7, 8, 9; of one log it is that one.
        assert_eq!(xyz.whole, [None, None, Some(0.625), Some((5.0 + 11.0) / 2.0)]);
        assert_eq!(xyz.first, [None, None, Some(0.5), Some((2.0 + 11.0) / 2.0)]);
        assert_eq!(xyz.last, [None, None, Some(0.75), Some((8.0 + 11.0) / 2.0)]);
        assert_eq!((xyz.site, xyz.inactive, attack.sites[1].inactive), ("xyz", 2, 0));
    }

    #[test]
    fn what_was_not_logged_is_empty_and_what_was_is_not() {
        let table = table();
        let lines: Vec<AttackLine> = table.lines.iter().filter_map(|line| AttackLine::of(line, log)).collect();
        let csv = attack_csv(&lines).unwrap();
        let lines: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
        let [head, cells] = &lines[..] else { panic!("{csv}") };
        assert_eq!(head[..7], ["scene", "source", "row", "axes", "n", "gain.xyz", "gain_over_random.xyz"]);
        assert_eq!(head.len(), 5 + 2 * 12, "sites that no line has logged have no columns");
        assert_eq!(cells[..5], ["fern", "run", "Aug-NeRF", "", "2"]);
        let cell = |name: &str| cells[head.iter().position(|column| *column == name).unwrap()];
        assert_eq!([cell("shift.xyz"), cell("first.shift.xyz"), cell("last.shift.xyz")], ["8", "6.5", "9.5"]);
        assert_eq!([cell("gain.xyz"), cell("last.gain.xyz"), cell("shift.feature")], [""; 3]);
        assert_eq!([cell("gain.feature"), cell("first.gain.feature")], ["0"; 2]);
    }

    #[test]
    fn a_table_without_an_attack_has_no_file() {
        let table = table();
        let lines: Vec<AttackLine> =
            table.lines.iter().filter_map(|line| AttackLine::of(line, |_, _| vec![])).collect();
        assert_eq!(attack_csv(&lines), None);
    }
}
