//! The files that are made from a sweep's points: texts, and figures as SVG with their captions. Each kind has a line in one of
//! three lists.

pub use crate::draw::canvas::File;

use super::plots::{Curve, Figure, Style, axes_figure, curves_figure, rows_figure};
use super::tables::{
    AttackLine, ColumnOf, Constants, PointTiming, Table, attack_csv, points_csv, table_csv, table_latex,
    table_markdown, timing_csv,
};
use super::{Record, TableSpec};

/// The results of a sweep's points.
pub struct Points<'a> {
    /// The definition's description of its table.
    pub spec: &'a TableSpec,
    /// The points, one record for each position in the table.
    pub records: &'a [Record],
    /// Clock times of the points that are done.
    pub timing: &'a [PointTiming],
    /// Add clock times to the tables, which are then no longer reproducible.
    pub with_timing: bool,
    /// The protocol fields that all points share, which are no columns.
    pub constants: Constants,
    /// Columns of settings.
    pub column_of: ColumnOf,
}

/// Points whose rows are comparable, with their table.
pub struct Comparable<'a> {
    /// The points.
    pub points: &'a Points<'a>,
    /// The table.
    pub table: &'a Table,
    /// Training curves by scene.
    pub curves: &'a [(String, Vec<Curve>)],
    /// Effect of the attack, line by line of the table.
    pub attacks: &'a [AttackLine<'a>],
}

/// A text of points.
type PointsText = fn(&Points) -> String;

/// Texts that show points alone: one line a point, and clock times, apart from what is reproducible.
static OF_POINTS: [(&str, PointsText); 2] = [
    ("points.csv", |points| points_csv(points.records, points.joined_timing(), &points.constants, points.column_of)),
    ("timing.csv", |points| timing_csv(points.records, points.timing, &points.constants)),
];

/// Effect of the attack at each site, one line for each attacked row.
const ATTACK: &str = "attack.csv";

/// A text of comparable rows, or `None` if there is nothing to write.
type Text = fn(&Comparable) -> Option<String>;

static OF_TABLE: [(&str, Text); 4] = [
    ("table.csv", |all| {
        let points = all.points;
        Some(table_csv(all.table, points.joined_timing(), &points.constants, points.column_of))
    }),
    (ATTACK, |all| attack_csv(all.attacks)),
    ("table.md", |all| Some(table_markdown(all.table))),
    ("table.tex", |all| Some(table_latex(all.table))),
];

/// `curves_SCENE_psnr`: training against steps.
const CURVES: &str = "curves_";

/// The figures of one kind, by the end of their names.
type Figures = fn(&Comparable, Style) -> Vec<(String, Option<Figure>)>;

/// By the start of their names. `rows_SCENE_METRIC`: the rows of a sweep without axes; a row with its own axes has a line for
/// each value. `axes_SCENE_METRIC`: a metric against the varied setting.
static FIGURES: [(&str, Figures); 3] = [
    ("rows_", |all, style| {
        let records = all.points.records;
        let figure = |scene: &str, metric: &str| rows_figure(style, all.table, records, scene, metric);
        each_metric(all.table, |scene, metric| if style.spec.varied { None } else { figure(scene, metric) })
    }),
    ("axes_", |all, style| {
        each_metric(all.table, |scene, metric| axes_figure(style, all.points.records, scene, metric))
    }),
    (CURVES, |all, style| {
        let figure = |(scene, curves): &(String, Vec<Curve>)| {
            (format!("{scene}_psnr"), without_axes(all, scene, curves_figure(style, scene, curves)))
        };
        all.curves.iter().map(figure).collect()
    }),
];

impl<'a> Points<'a> {
    /// Returns the files that show no rows side by side.
    pub fn files(&self) -> Vec<File> {
        OF_POINTS.iter().map(|(name, text)| (name.to_string(), text(self).into_bytes())).collect()
    }

    /// Returns the clock times that tables show.
    fn joined_timing(&self) -> &'a [PointTiming] {
        if self.with_timing { self.timing } else { &[] }
    }
}

impl Comparable<'_> {
    /// Returns the files that show rows side by side.
    pub fn files(&self) -> Vec<File> {
        let texts = OF_TABLE.iter().filter_map(|(name, text)| Some((name.to_string(), text(self)?.into_bytes())));
        let style = Style { spec: self.points.spec };
        let of_kind = |(kind, figures): &(&str, Figures)| {
            let figures = figures(self, style).into_iter();
            figures.filter_map(|(name, figure)| Some(figure?.files(&format!("{kind}{name}")))).collect::<Vec<_>>()
        };
        texts.chain(FIGURES.iter().flat_map(of_kind).flatten()).collect()
    }
}

/// Returns whether a file of a results folder is one that is made here, to be deleted before it is written again.
pub fn is_made(file: &str) -> bool {
    let mut texts = OF_POINTS.iter().map(|(name, _)| *name).chain(OF_TABLE.iter().map(|(name, _)| *name));
    texts.any(|name| name == file) || FIGURES.iter().any(|(kind, _)| is_figure(file, kind))
}

/// Returns whether it is made of the points' logs, which a results folder may lack.
pub fn is_made_of_logs(file: &str) -> bool {
    file == ATTACK || is_figure(file, CURVES)
}

fn is_figure(file: &str, kind: &str) -> bool {
    file.starts_with(kind) && [".svg", ".txt"].iter().any(|ending| file.ends_with(ending))
}

/// Says in a figure's caption that it has no row with axes, if there are any.
fn without_axes(all: &Comparable, scene: &str, figure: Option<Figure>) -> Option<Figure> {
    let mut figure = figure?;
    if all.points.records.iter().any(|record| record.scene == scene && !record.axes.is_empty()) {
        figure.caption = format!("{} Rows with axes are not drawn.\n", figure.caption.trim_end());
    }
    Some(figure)
}

/// Makes the figure of each scene and metric.
fn each_metric(table: &Table, figure: impl Fn(&str, &str) -> Option<Figure>) -> Vec<(String, Option<Figure>)> {
    let of_scene = |(scene, _)| table.metrics.iter().map(move |metric| (scene, metric));
    let named = |(scene, metric): (&str, &String)| (format!("{scene}_{metric}"), figure(scene, metric));
    table.scenes().into_iter().flat_map(of_scene).map(named).collect()
}
