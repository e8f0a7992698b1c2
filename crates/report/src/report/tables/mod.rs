//! Tables of a sweep: one line for each row of the definition and its axis values, over the seeds.
//!
//! Replicates are seeds, never views. A line is compared with its baseline seed by seed. Missing numbers are skipped,
//! and `n` counts the others. Published numbers are next to ours, with the known differences in protocol, and are
//! never subtracted.

mod attack;
mod checks;
mod comparison;
mod delimited;
mod epochs;
mod heading;
mod kinds;
mod latex;
mod markdown;
mod read;
mod sheet;
mod terminal;
pub mod text;
mod together;

pub use attack::{AttackLine, AttackSite, SiteMeans, attack_csv};
pub use checks::disagreements;
pub use comparison::{Comparison, Equivalence, Verdict};
pub(super) use comparison::{correct, firsts};
pub use delimited::{PointTiming, constants, points_csv, table_columns, table_csv, timing_csv};
pub(super) use epochs::{epochs_head, joint};
pub use epochs::{epochs_note, epochs_of, epochs_text, is_brief};
pub use heading::{Heading, Judgement, is_better};
pub use latex::table_latex;
pub use markdown::escape;
pub use markdown::table_markdown;
pub use read::{PlaceText, read_points, read_timing};
pub(super) use sheet::text as cell_text;
pub use sheet::{Column, ColumnOf, Constants, attack_numbers};
pub use terminal::table_terminal;

use crate::base::Result;
use crate::base::columns::{INACTIVE_BY, InactiveBy, is_per_seed};
use crate::metrics::{FLOOR_PSNR, PSNR};
use crate::report::statistics::{mean, paired_differences, standard_deviation};
use crate::report::{AxisValue, PublishedRow, Record, RowSpec, Status, TableSpec, distinct};

/// A table, ready to be rendered.
///
/// ```
/// # mod augnerf { pub use augnerf_base as base; pub use augnerf_report::*; }
/// use augnerf::report::tables::{Table, table_markdown};
/// use augnerf::report::{PointResult, Record, RowSpec, Status, TableSpec};
///
/// let record = |row: &str, seed: u64, psnr| Record {
///     id: format!("{row}-{seed}"),
///     scene: "fern".into(),
///     row: row.into(),
///     seed: Some(seed),
///     status: Status::Done,
///     result: PointResult { metrics: vec![("psnr".into(), Some(psnr))], ..PointResult::default() },
///     ..Record::default()
/// };
/// let row = |name: &str, baseline: Option<&str>| RowSpec {
///     name: name.into(),
///     baseline: baseline.map(String::from),
///     ..RowSpec::default()
/// };
/// let spec = TableSpec {
///     metrics: vec!["psnr".into()],
///     rows: vec![row("NeRF", None), row("Aug-NeRF", Some("NeRF"))],
///     ..TableSpec::default()
/// };
/// let records =
///     [record("NeRF", 0, 20.0), record("NeRF", 1, 21.0), record("Aug-NeRF", 0, 22.0), record("Aug-NeRF", 1, 23.5)];
/// let table = Table::new(&spec, &records, false)?;
/// let difference = table.lines[1].cells[0].comparison.unwrap();
/// assert_eq!((table.lines[0].cells[0].mean, difference.difference), (Some(20.5), 2.25));
/// assert!(table_markdown(&table).contains("| NeRF |"));
/// # Ok::<(), augnerf::base::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// The sweep's name.
    pub name: String,
    /// The question that the table answers.
    pub title: String,
    /// Keys of the printed metrics, in the order of the columns.
    pub metrics: Vec<String>,
    /// By scene, then row, then axes.
    pub lines: Vec<Line>,
    /// Further notes below the table.
    pub notes: Vec<String>,
}

/// Points that differ only in their seed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Line {
    /// The scene's name.
    pub scene: String,
    /// The row's name without axis values.
    pub row: String,
    /// The axis values: `features steps = 3, output step size = 1e-5`; empty for a plain row.
    pub axes: String,
    /// Row and axis values.
    pub label: String,
    /// Label of the line that this one is compared with, or `None` for a baseline.
    pub baseline: Option<String>,
    /// The paper does not have this row.
    pub ours: bool,
    /// Only the paper's numbers; not run here.
    pub quoted: bool,
    /// Folder names of the measured points.
    pub ids: Vec<String>,
    /// Number of points in the definition.
    pub points: usize,
    /// Counts of points by status: `done 2, failed 1`.
    pub status: String,
    /// Why the first point without numbers has none; empty otherwise.
    pub reason: String,
    /// Sites that were inactive, each with the number of seeds with which it was.
    pub inactive_levels: Vec<(String, usize)>,
    /// PSNR of the best single colour of the training views, the mean over the seeds that have it.
    pub floor_psnr: Option<f64>,
    /// The seeds with a PSNR that is no higher than theirs: `seed 3`.
    pub no_better_than_one_colour: Vec<String>,
    /// One cell for each of the table's metrics.
    pub cells: Vec<Cell>,
    /// The paper's LPIPS, of an unnamed backbone, or `None` if the table has no LPIPS.
    pub published_lpips: Option<f64>,
    /// The same for its average.
    pub published_average: Option<f64>,
    /// How the paper's numbers were measured; empty without any.
    pub published_protocol: String,
    /// Known differences of the measured points from that.
    pub protocol_difference: String,
    /// Lowest and highest over the seeds of how often a training pixel was seen; `None` if it is unknown.
    pub epochs: Option<(f64, f64)>,
    /// The same of the paper's own run.
    pub published_epochs: Option<f64>,
    /// Protocol fields that are equal over the seeds.
    pub protocol: Vec<(String, String)>,
    /// Protocol fields that differ over the seeds, except those that every seed has of its own.
    pub differs: Vec<String>,
    /// Fields of `must_match` that differ from the scene's first line; only in forced tables.
    pub mixed: Vec<String>,
}

/// One metric of a line.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cell {
    /// The metric's name.
    pub metric: String,
    /// Number of seeds with the metric.
    pub n: usize,
    /// Mean over them.
    pub mean: Option<f64>,
    /// Sample standard deviation over them.
    pub deviation: Option<f64>,
    /// Comparison with the baseline, or `None` if no seed has both.
    pub comparison: Option<Comparison>,
    /// The paper's number.
    pub published: Option<f64>,
}

impl Table {
    /// Returns the table with those of its metrics that `keys` names, or with all if it has none of them.
    pub fn with_metrics(&self, keys: &[&str]) -> Table {
        let kept: Vec<usize> = (0..self.metrics.len()).filter(|i| keys.contains(&self.metrics[*i].as_str())).collect();
        if kept.is_empty() {
            return self.clone();
        }
        let mut table = self.clone();
        table.metrics = kept.iter().map(|&index| self.metrics[index].clone()).collect();
        for line in &mut table.lines {
            line.cells = kept.iter().map(|&index| line.cells[index].clone()).collect();
        }
        table
    }

    /// Makes the table of a definition's points. If lines of a scene differ in a field of `must_match`, returns an
    /// error that names it; with `force`, marks them instead.
    pub fn new(spec: &TableSpec, records: &[Record], force: bool) -> Result<Table> {
        checks::check_definition(spec, records)?;
        let groups = groups(spec, records);
        if !force {
            checks::check_controlled(spec, &groups)?;
        }
        let mut lines: Vec<Line> = Vec::new();
        for scene in distinct(groups.iter().map(|group| group.scene)) {
            lines.extend(spec.rows.iter().filter(|row| row.quoted).filter_map(|row| quoted_line(spec, row, scene)));
            lines.extend(groups.iter().filter(|group| group.scene == scene).map(|group| line(spec, group, &groups)));
        }
        comparison::correct_scenes(&mut lines);
        let TableSpec { name, title, metrics, notes, .. } = spec.clone();
        Ok(Table { name, title, metrics, lines, notes })
    }

    /// Returns each scene with its lines.
    pub fn scenes(&self) -> Vec<(&str, Vec<&Line>)> {
        let names = distinct(self.lines.iter().map(|line| line.scene.as_str()));
        names.into_iter().map(|name| (name, self.lines.iter().filter(|line| line.scene == name).collect())).collect()
    }
}

impl Cell {
    /// Returns the test of equivalence with the baseline, if it was made.
    fn equivalence(&self) -> Option<Equivalence> {
        self.comparison?.equivalence
    }
}

impl Line {
    /// Returns whether it lacks a point of the definition.
    pub fn unfinished(&self) -> bool {
        self.ids.len() < self.points
    }

    /// Returns whether so many seeds are more than half of them. Of fewer, nothing is said of the row without their number.
    pub fn is_most(&self, seeds: usize) -> bool {
        2 * seeds > self.ids.len()
    }

    /// Returns the sites that are inactive with most seeds, `rgb, density with 2 of 3 seeds`, if judged by that measure, or
    /// `None` if there are none.
    pub fn inactive_sites(&self, by: InactiveBy) -> Option<String> {
        self.inactive(true).filter(|_| InactiveBy::of_name(self.protocol(INACTIVE_BY)) == by)
    }

    /// Returns the sites that are inactive with most seeds, or those that are with fewer.
    fn inactive(&self, most: bool) -> Option<String> {
        let own = self.inactive_levels.iter().filter(|(_, seeds)| self.is_most(*seeds) == most);
        let sites: Vec<String> = own.map(|(site, seeds)| format!("{site}{}", self.with_seeds(*seeds))).collect();
        (!sites.is_empty()).then(|| sites.join(", "))
    }

    /// Returns ` with 2 of 3 seeds`; empty for all.
    fn with_seeds(&self, seeds: usize) -> String {
        let all = self.ids.len();
        if seeds == all { String::new() } else { format!(" with {seeds} of {all} seeds") }
    }

    /// Returns the text of a protocol field; empty if it is missing or differs between the seeds.
    pub fn protocol(&self, name: &str) -> &str {
        self.protocol.iter().find(|(known, _)| known == name).map_or("", |(_, text)| text)
    }
}

/// The points of a line.
struct Group<'a> {
    row: &'a RowSpec,
    scene: &'a str,
    axes: &'a [AxisValue],
    points: Vec<&'a Record>,
}

impl<'a> Group<'a> {
    fn done(&self) -> impl Iterator<Item = &'a Record> {
        self.points.iter().copied().filter(|point| point.status == Status::Done)
    }

    /// Returns the value of each measured point with the metric.
    fn values(&self, metric: &str) -> Vec<f64> {
        self.done().filter_map(|point| point.metric(metric)).collect()
    }

    /// Returns seed and value of each measured point that has both. Others are not compared.
    fn by_seed(&self, metric: &str) -> Vec<(u64, f64)> {
        self.done().filter_map(|point| Some((point.seed?, point.metric(metric)?))).collect()
    }

    /// Returns the row's baseline at the same axis values, or the one without axis values.
    fn baseline<'g>(&self, groups: &'g [Group<'a>]) -> Option<&'g Group<'a>> {
        let name = self.row.baseline.as_ref()?;
        let at = |axes: &[AxisValue]| {
            groups.iter().find(|other| other.scene == self.scene && other.row.name == *name && other.axes == axes)
        };
        at(self.axes).or_else(|| at(&[]))
    }
}

/// Groups points by scene, then row of the definition, then axis values, in order of appearance.
fn groups<'a>(spec: &'a TableSpec, records: &'a [Record]) -> Vec<Group<'a>> {
    let mut groups = Vec::new();
    for scene in distinct(records.iter().map(|record| record.scene.as_str())) {
        for row in &spec.rows {
            let of_row: Vec<&Record> = records.iter().filter(|r| r.scene == scene && r.row == row.name).collect();
            for axes in distinct(of_row.iter().map(|record| record.axes.as_slice())) {
                let points = of_row.iter().copied().filter(|record| record.axes == axes).collect();
                groups.push(Group { row, scene, axes, points });
            }
        }
    }
    groups
}

fn line(spec: &TableSpec, group: &Group, groups: &[Group]) -> Line {
    let (first, measured) = (group.points[0], group.done().next());
    let label = first.label();
    let baseline = group.baseline(groups);
    let published = group.row.published.as_ref().and_then(|key| key.find(group.scene));
    let differences = published.as_ref().zip(measured).map(|(row, point)| row.difference(point));
    let (protocol, differs) = shared_protocol(group);
    let floors: Vec<f64> =
        group.done().filter_map(|point| point.metric(PSNR.key).and(point.metric(FLOOR_PSNR.key))).collect();
    Line {
        scene: group.scene.into(),
        row: group.row.name.clone(),
        axes: axes_text(first),
        label,
        baseline: baseline.map(|baseline| baseline.points[0].label()),
        ours: group.row.ours,
        quoted: false,
        ids: group.done().map(|point| point.id.clone()).collect(),
        points: group.points.len(),
        status: status_text(&group.points),
        reason: group.points.iter().map(|point| &point.reason).find(|r| !r.is_empty()).cloned().unwrap_or_default(),
        inactive_levels: inactive_levels(group),
        floor_psnr: mean(&floors),
        no_better_than_one_colour: group
            .done()
            .filter(|point| point.is_no_better_than_one_colour() == Some(true))
            .map(Record::seed_text)
            .collect(),
        cells: spec.metrics.iter().map(|metric| cell(spec, metric, group, baseline, published.as_ref())).collect(),
        published_lpips: published.as_ref().map(|row| row.lpips).filter(|_| spec.has_any("lpips_")),
        published_average: published.as_ref().map(|row| row.average).filter(|_| spec.has_any("average_")),
        published_protocol: published.as_ref().map(|row| row.protocol()).unwrap_or_default(),
        protocol_difference: differences.unwrap_or_default(),
        epochs: joint(group.done().filter_map(Record::epochs).map(|own| (own, own))),
        published_epochs: published.as_ref().and_then(|row| row.epochs()),
        protocol,
        differs,
        mixed: checks::mixed_fields(spec, group, groups),
    }
}

/// Returns the sites that were inactive, and with how many seeds.
fn inactive_levels(group: &Group) -> Vec<(String, usize)> {
    let sites = distinct(group.done().flat_map(|point| point.result.inactive_levels.iter()));
    let seeds = |site: &String| group.done().filter(|point| point.result.inactive_levels.contains(site)).count();
    sites.into_iter().map(|site| (site.clone(), seeds(site))).collect()
}

/// Returns a line for a method that is not run here, or `None` if the paper has no number for the scene.
fn quoted_line(spec: &TableSpec, row: &RowSpec, scene: &str) -> Option<Line> {
    let published = row.published.as_ref()?.find(scene)?;
    let cell =
        |metric: &String| Cell { metric: metric.clone(), published: published.metric(metric), ..Cell::default() };
    Some(Line {
        scene: scene.into(),
        row: row.name.clone(),
        label: row.name.clone(),
        quoted: true,
        cells: spec.metrics.iter().map(cell).collect(),
        published_lpips: Some(published.lpips).filter(|_| spec.has_any("lpips_")),
        published_average: Some(published.average).filter(|_| spec.has_any("average_")),
        published_protocol: published.protocol(),
        published_epochs: published.epochs(),
        ..Line::default()
    })
}

fn cell(
    spec: &TableSpec,
    metric: &str,
    group: &Group,
    baseline: Option<&Group>,
    published: Option<&PublishedRow>,
) -> Cell {
    let values = group.values(metric);
    let differences = baseline.map(|baseline| paired_differences(&group.by_seed(metric), &baseline.by_seed(metric)));
    Cell {
        metric: metric.into(),
        n: values.len(),
        mean: mean(&values),
        deviation: standard_deviation(&values),
        comparison: differences.and_then(|differences| Comparison::new(&differences, spec.margin(metric))),
        published: published.and_then(|row| row.metric(metric)),
    }
}

/// Returns the protocol fields that are equal over the measured points, and the names of the others.
fn shared_protocol(group: &Group) -> (Vec<(String, String)>, Vec<String>) {
    let (mut shared, mut differs) = (Vec::new(), Vec::new());
    for name in distinct(group.done().flat_map(protocol_names)).into_iter().filter(|name| !is_per_seed(name)) {
        match distinct(group.done().map(|point| point.protocol(name))).as_slice() {
            [text] => shared.push((name.to_string(), text.to_string())),
            _ => differs.push(name.to_string()),
        }
    }
    (shared, differs)
}

/// Returns the names of a point's protocol fields, without the scene.
fn protocol_names(point: &Record) -> impl Iterator<Item = &str> {
    point.result.protocol.iter().map(|(name, _)| name.as_str()).filter(|name| *name != "scene")
}

/// Returns a record's label without its row.
fn axes_text(record: &Record) -> String {
    record.label()[record.row.len()..].trim_start_matches(", ").into()
}

fn status_text(points: &[&Record]) -> String {
    let counts = distinct(points.iter().map(|point| point.status)).into_iter().map(|status| {
        let count = points.iter().filter(|point| point.status == status).count();
        format!("{} {count}", status.name())
    });
    counts.collect::<Vec<String>>().join(", ")
}
