//! Effect of the attack, row by row and site by site.

use crate::report::tables::{AttackLine, AttackSite, Line, Table};

/// One site of one line on the page. Each number has its sort key and its text.
pub struct SiteRow<'a> {
    pub label: &'a str,
    pub scene: &'a str,
    pub site: &'static str,
    pub numbers: Vec<(String, String)>,
    pub inactive: bool,
    /// With most seeds, and with how many if not with all.
    pub judged: String,
}

/// Returns the sites of the lines that a table has.
pub fn site_rows<'a>(lines: &'a [AttackLine], table: &Table) -> Vec<SiteRow<'a>> {
    let text = |index: usize, value: f64| match index {
        2 => format!("{:.0} %", 100.0 * value),
        3 => format!("{value:.2}"),
        _ => format!("{value:+.2e}"),
    };
    let number = |(index, value): (usize, &Option<f64>)| match value {
        Some(value) => (value.to_string(), text(index, *value)),
        None => Default::default(),
    };
    let of_site = |attack: &'a AttackLine, site: &AttackSite| SiteRow {
        label: &attack.line.label,
        scene: &attack.line.scene,
        site: site.site,
        numbers: site.whole.iter().enumerate().map(number).collect(),
        inactive: attack.line.is_most(site.inactive),
        judged: match (site.inactive, attack.line.ids.len()) {
            (0, _) => "active".into(),
            (inactive, seeds) if inactive == seeds => "inactive".into(),
            (inactive, seeds) => format!("inactive with {inactive} of {seeds} seeds"),
        },
    };
    let is_shown = |line: &Line| table.lines.iter().any(|own| (&own.scene, &own.label) == (&line.scene, &line.label));
    lines
        .iter()
        .filter(|attack| is_shown(attack.line))
        .flat_map(|attack| attack.sites.iter().map(move |site| of_site(attack, site)))
        .collect()
}
