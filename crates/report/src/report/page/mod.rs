//! `report.html`: the results of a sweep or of runs, on one page that needs no other file and no network.
//!
//! The page is `templates/report.html`, with its style and script. Names of rows and scenes, and reasons, are escaped
//! there. The page's policy allows only its own script, by hash, and forbids every fetch.

mod attack;
mod facts;
mod figures;
mod films;
mod over;
mod points;
mod protocol;
mod results;
mod views;

use askama::Template;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use sha2::{Digest, Sha256};

use crate::base::{Error, Result};
use crate::report::Record;
use crate::report::tables::{AttackLine, Heading, PointTiming, Table, table_latex};

pub use films::Film;
pub use views::{ShownScene, ViewOfRow, ViewOfScene};

const STYLE: &str = include_str!("../../../templates/report.css");
const SCRIPT: &str = include_str!("../../../templates/report.js");

/// Inputs of the page.
pub struct Page<'a> {
    /// The table to show.
    pub table: &'a Table,
    /// The points.
    pub records: &'a [Record],
    /// Names and bytes of files; the page uses the SVGs and their captions.
    pub files: &'a [(String, Vec<u8>)],
    /// First held-out views, scene by scene.
    pub views: Vec<ShownScene>,
    /// Videos of rows.
    pub films: Vec<Film>,
    /// Images of the rows' meshes.
    pub meshes: Vec<Film>,
    /// Effect of the attack.
    pub attacks: Vec<AttackLine<'a>>,
    /// Clock times, if the page shows them; it is then not reproducible.
    pub timing: &'a [PointTiming],
    /// Returns a run's path relative to the page, or `None` if unknown.
    pub link: &'a dyn Fn(&str) -> Option<String>,
}

#[derive(Template)]
#[template(path = "report.html")]
struct Html<'a> {
    title: &'a str,
    name: &'a str,
    script_hash: String,
    style: &'static str,
    script: &'static str,
    warnings: Vec<String>,
    facts: Vec<(&'static str, String)>,
    groups: Vec<(usize, String)>,
    over: Option<over::Over>,
    columns: Vec<results::Column>,
    scenes: Vec<results::Scene<'a>>,
    notes: Vec<String>,
    latex: String,
    figures: Vec<figures::Drawn>,
    views: &'a [ShownScene],
    views_note: &'static str,
    films: &'a [Film],
    meshes: &'a [Film],
    attacks: Vec<attack::SiteRow<'a>>,
    points: Vec<points::Point<'a>>,
    protocols: Vec<protocol::Scene<'a>>,
    clocks: Vec<String>,
    costs: Vec<protocol::Cost<'a>>,
}

impl Page<'_> {
    /// Returns the page's text.
    pub fn html(&self) -> Result<String> {
        // A note says why a metric has no number.
        let is_filled = |index: &usize| {
            self.table.lines.iter().any(|line| line.cells[*index].n > 0 || line.cells[*index].published.is_some())
        };
        let filled = (0..self.table.metrics.len()).filter(is_filled).map(|index| self.table.metrics[index].as_str());
        let shown = &self.table.with_metrics(&filled.collect::<Vec<&str>>());
        // Values of several axes can be one training, which is one row.
        let (table, once) = (self.table, &results::once(self.table));
        let groups = (0..).zip(shown.metrics.iter().map(|key| Heading::of(key).name.to_string())).collect();
        let html = Html {
            title: &table.title,
            name: &table.name,
            script_hash: format!("sha256-{}", STANDARD.encode(Sha256::digest(SCRIPT.as_bytes()))),
            style: STYLE,
            script: SCRIPT,
            warnings: facts::warnings(once, self.records),
            facts: facts::facts(table, self.records),
            groups,
            over: over::over(table)?,
            columns: results::columns(shown),
            scenes: results::scenes(once, shown),
            notes: results::notes(table),
            latex: table_latex(table),
            figures: figures::figures(table, self.files)?,
            views: &self.views,
            views_note: views::NOTE,
            films: &self.films,
            meshes: &self.meshes,
            attacks: attack::site_rows(&self.attacks, once),
            points: points::points(shown, self.records, self.link),
            protocols: protocol::scenes(once),
            clocks: protocol::clocks(self.timing),
            costs: protocol::costs(once, self.timing),
        };
        html.render().map_err(|e| Error::Output(format!("cannot make the page: {e}")))
    }
}
