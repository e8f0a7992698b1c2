//! The table: one column a metric, with the difference to the baseline below each mean.

use crate::draw::numbers::rounded;
use crate::metrics::{Direction, Metric};
use crate::report::statistics::p_text;
use crate::report::tables::text::{
    UNKNOWN_BACKBONE, further_notes, interval_of, is_of_mark, marked_label, mean_and_spread, published_text,
    scene_notes,
};
use crate::report::tables::{Cell, Heading, Judgement, Line, Table};

const MEANS: &str =
    "Mean ± standard deviation over the seeds; in brackets their number where it is not that of the definition.";
const DIFFERENCES: &str = "Below each mean: the difference to the baseline, paired by seed, with its 95 % Student t interval, \
     and the p value after Holm's correction over the rows of the scene's table. Where p is below 0.05, blue and ▲ are better (bold), \
     orange and ▼ worse. Grey: no difference is shown, which proves no equality.";
const EQUIVALENCE: &str = "\"Equivalent within\" a margin that the definition states: two one-sided paired t tests, with Holm's \
     p below 0.05.";

/// Most rows that a note names; marks are at the rows' names.
const MOST_NAMED: usize = 6;

/// A column.
pub struct Column {
    pub group: usize,
    pub name: String,
    pub unit: String,
    pub arrow: &'static str,
    /// The first click on its head sorts from the largest down.
    pub down: bool,
}

/// The rows of a scene, with the notes below them.
pub struct Scene<'a> {
    pub name: &'a str,
    pub rows: Vec<Row>,
    /// What the marks at rows' names mean.
    pub marks: Vec<String>,
    pub notes: Vec<String>,
}

/// A row of the table.
pub struct Row {
    pub label: String,
    /// Axis values of further lines that are the same training.
    pub same: Vec<String>,
    pub quoted: bool,
    pub cells: Vec<Number>,
}

/// A cell of the table.
#[derive(Default)]
pub struct Number {
    pub group: usize,
    /// Sort key; empty without a number.
    pub value: String,
    pub mean: String,
    pub spread: String,
    pub difference: String,
    pub conclusion: String,
    pub better: bool,
    pub worse: bool,
}

/// Returns whether the paper has numbers of a metric.
fn is_published(table: &Table, metric: usize) -> bool {
    table.lines.iter().any(|line| line.cells[metric].published.is_some())
}

/// Returns the paper's numbers that the table has but that match none of our metrics.
fn unknown_backbone(table: &Table) -> impl Iterator<Item = (&'static str, fn(&Line) -> String)> {
    UNKNOWN_BACKBONE.into_iter().filter(|(_, text)| table.lines.iter().any(|line| !text(line).is_empty()))
}

pub fn columns(table: &Table) -> Vec<Column> {
    let mut columns = Vec::new();
    for (group, key) in table.metrics.iter().enumerate() {
        let heading = Heading::of(key);
        let (name, unit, arrow) = (heading.name.to_string(), heading.unit_text(), heading.arrow);
        let down = Metric::find(key).is_some_and(|metric| metric.direction != Direction::Down);
        columns.push(Column { group, name, unit, arrow, down });
        if is_published(table, group) {
            let (name, unit) = (format!("{}, in the paper", heading.name), String::new());
            columns.push(Column { group, name, unit, arrow: "", down });
        }
    }
    columns.extend(unknown_backbone(table).map(|(name, _)| Column {
        group: table.metrics.len(),
        name: format!("{name}, in the paper"),
        unit: "of an unknown backbone".into(),
        arrow: "",
        down: false,
    }));
    columns
}

/// Returns the scenes with the columns of `shown`, and the notes of `once` to all columns.
pub fn scenes<'a>(once: &'a Table, shown: &Table) -> Vec<Scene<'a>> {
    let scenes = once.scenes().into_iter().zip(shown.scenes()).map(|((name, lines), (_, shown_lines))| {
        let rows = trainings(&shown_lines).into_iter().map(|(line, same)| row(shown, line, &same)).collect();
        let (marks, notes) = scene_notes(&lines, MOST_NAMED).into_iter().partition(|note| is_of_mark(note));
        Scene { name, rows, marks, notes }
    });
    scenes.collect()
}

pub fn notes(table: &Table) -> Vec<String> {
    let compared = table.lines.iter().flat_map(|line| &line.cells).any(|cell| cell.comparison.is_some());
    let how = std::iter::once(MEANS).chain(compared.then_some(DIFFERENCES)).map(String::from);
    table.notes.iter().cloned().chain(how).chain(further_notes(table, EQUIVALENCE)).collect()
}

/// Returns each line with the further lines that are made of the same points: values of several axes can be one
/// configuration.
fn trainings<'a>(lines: &[&'a Line]) -> Vec<(&'a Line, Vec<&'a Line>)> {
    let mut trainings: Vec<(&Line, Vec<&Line>)> = Vec::new();
    for line in lines {
        let same = |(first, _): &&mut (&Line, Vec<&Line>)| {
            !line.ids.is_empty() && (&first.ids, &first.row) == (&line.ids, &line.row)
        };
        match trainings.iter_mut().find(same) {
            Some((_, further)) => further.push(line),
            None => trainings.push((line, Vec::new())),
        }
    }
    trainings
}

/// Returns the table with one line for each training.
pub fn once(table: &Table) -> Table {
    let lines: Vec<&Line> = table.lines.iter().collect();
    Table { lines: trainings(&lines).into_iter().map(|(line, _)| line.clone()).collect(), ..table.clone() }
}

fn row(table: &Table, line: &Line, same: &[&Line]) -> Row {
    let mut cells = Vec::new();
    for (group, cell) in line.cells.iter().enumerate() {
        cells.push(number(group, cell, line.points));
        if is_published(table, group) {
            let value = cell.published.map_or(String::new(), |value| value.to_string());
            cells.push(Number { group, value, mean: published_text(cell), ..Number::default() });
        }
    }
    cells.extend(unknown_backbone(table).map(|(_, text)| Number {
        group: table.metrics.len(),
        value: text(line),
        mean: text(line),
        ..Number::default()
    }));
    let same = same.iter().map(|line| rounded(&line.axes)).collect();
    Row { label: rounded(&marked_label(line)), same, quoted: line.quoted, cells }
}

fn number(group: usize, cell: &Cell, points: usize) -> Number {
    let (mean, mut spread) = mean_and_spread(cell);
    if cell.n != points && cell.mean.is_some() {
        spread += &format!("{}({})", if spread.is_empty() { "" } else { " " }, cell.n);
    }
    let comparison = cell.comparison;
    let p = comparison.and_then(|comparison| comparison.p_holm).map(|p| format!("p {}", p_text(p)));
    let judged = comparison.map(|comparison| Judgement::of(&cell.metric, &comparison));
    let verdict = judged.filter(|judged| *judged != Judgement::NotShown).map(|judged| match judged {
        Judgement::Better => "▲ better".to_string(),
        Judgement::Worse => "▼ worse".into(),
        other => other.name().into(),
    });
    let equivalence =
        comparison.and_then(|comparison| comparison.equivalence).filter(|equivalence| equivalence.holds());
    let equivalent = equivalence.map(|equivalence| {
        let margin = Metric::find(&cell.metric).map_or_else(String::new, |metric| metric.text(equivalence.margin));
        format!("equivalent within {margin}")
    });
    let said: Vec<String> = [p, verdict, equivalent].into_iter().flatten().collect();
    Number {
        group,
        value: cell.mean.map_or(String::new(), |mean| mean.to_string()),
        mean,
        spread,
        difference: interval_of(cell),
        conclusion: said.join(", "),
        better: judged == Some(Judgement::Better),
        worse: judged == Some(Judgement::Worse),
    }
}
