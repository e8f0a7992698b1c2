//! What the attack did, row by row and site by site.

use crate::augment::Site;
use crate::report::statistics::mean;
use crate::report::tables::Line;

/// One site of one row.
#[derive(Clone, Debug, PartialEq)]
pub struct AttackLine {
    /// The row.
    pub label: String,
    /// The scene.
    pub scene: String,
    /// The site.
    pub site: &'static str,
    /// Gain, gain over random, share at the bound, shift of colours in 8-bit steps: means over logged steps, then over seeds.
    pub numbers: [Option<f64>; 4],
    /// It was inactive with at least one seed.
    pub inactive: bool,
}

/// Their columns in a run's log.
const COLUMNS: [&str; 4] = ["gain", "gain_over_random", "share_at_bound", "shift"];

impl AttackLine {
    /// The sites of a line that any of its points has logged; `numbers` gives a column of a point's log.
    pub fn of(line: &Line, numbers: impl Fn(&str, &str) -> Vec<f64>) -> Vec<AttackLine> {
        let of_site = |site: &Site| {
            let over_seeds = |column: &str| {
                let name = format!("{column}.{}", site.name());
                let seeds: Vec<f64> = line.ids.iter().filter_map(|id| mean(&numbers(id, &name))).collect();
                mean(&seeds)
            };
            let numbers = COLUMNS.map(over_seeds);
            numbers.iter().any(Option::is_some).then(|| AttackLine {
                label: line.label.clone(),
                scene: line.scene.clone(),
                site: site.name(),
                numbers,
                inactive: line.inactive_levels.iter().any(|level| level == site.name()),
            })
        };
        Site::ALL.iter().filter_map(of_site).collect()
    }
}

/// A line as the page has it: for each number what it is sorted by, and its text.
pub struct Shown<'a> {
    pub label: &'a str,
    pub scene: &'a str,
    pub site: &'static str,
    pub numbers: Vec<(String, String)>,
    pub inactive: bool,
}

pub fn shown(lines: &[AttackLine]) -> Vec<Shown<'_>> {
    let text = |index: usize, value: f64| match index {
        2 => format!("{:.0} %", 100.0 * value),
        3 => format!("{value:.2}"),
        _ => format!("{value:+.2e}"),
    };
    let number = |(index, value): (usize, &Option<f64>)| match value {
        Some(value) => (value.to_string(), text(index, *value)),
        None => Default::default(),
    };
    let shown = lines.iter().map(|line| Shown {
        label: &line.label,
        scene: &line.scene,
        site: line.site,
        numbers: line.numbers.iter().enumerate().map(number).collect(),
        inactive: line.inactive,
    });
    shown.collect()
}
