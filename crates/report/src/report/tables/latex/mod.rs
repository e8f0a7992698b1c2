//! The tables for a paper, as LaTeX with `booktabs`: means with their spread, then differences to baselines with their
//! intervals. Both fit a text width of 17 cm; wider tables are split into parts below one another.

mod columns;
mod escape;
mod floats;

use super::heading::{Heading, is_better};
use super::text::{
    UNKNOWN_BACKBONE, further_notes, interval_of, marked_label, mean_text, protocol_text, published_text, scene_notes,
};
use super::{Cell, Comparison, Line, Table, epochs_note};
use crate::draw::numbers::rounded;
use crate::report::statistics::p_text;
use columns::{Column, Group, Part, parts, row_text};
use escape::{LETTER, escape};
use floats::{Block, floats};

const HEAD: &str =
    "% Needs \\usepackage{booktabs}. Fits a text of 17 cm, as \\usepackage[a4paper,margin=2cm]{geometry} leaves.\n";
const BOLD_MEANS: &str = " Bold: better than the baseline, Holm's p below 0.05.";
const BOLD_DIFFERENCES: &str = "Bold: Holm's p is below 0.05.";
const HOW_TO_READ: &str = "Differences are paired by seed and stand with their 95 % Student t intervals; p is that of the paired t \
     test after Holm's correction over the rows of the scene's table. An interval that holds 0 proves no equality.";
const EQUIVALENT: &str = "≈ behind p: equivalent within the margin that the definition states (two one-sided paired t tests, Holm's p \
     below 0.05)";

/// Returns the table of means, the table of differences if rows are compared, and the notes to both.
pub fn table_latex(table: &Table) -> String {
    let means = Means::new(table);
    let (mut text, mut caption, mut blocks) = (String::new(), means.caption(table), means.blocks(table));
    if table.lines.iter().any(|line| line.baseline.is_some()) {
        text = floats(&caption, blocks);
        caption = format!("{}: differences to the baseline. {BOLD_DIFFERENCES}", table.title);
        let is_compared = |line: &Line| line.cells.iter().any(|cell| cell.comparison.is_some());
        blocks = self::blocks(table, &differences(table), is_compared);
    }
    blocks.extend(Block::of_notes(&notes(table)));
    text += &floats(&caption, blocks);
    let letters = if text.contains("\\augnerfletter") { LETTER } else { "" };
    format!("{HEAD}{letters}{text}")
}

/// The table of means.
struct Means<'a> {
    groups: Vec<Group<'a>>,
    /// Seeds of every cell with numbers, if they are the same.
    seeds: Option<usize>,
}

impl<'a> Means<'a> {
    fn new(table: &'a Table) -> Means<'a> {
        let counts = || table.lines.iter().flat_map(|line| &line.cells).map(|cell| cell.n).filter(|n| *n > 0);
        let seeds = counts().next().filter(|first| counts().all(|n| n == *first));
        let of_metric = |(index, metric): (usize, &'a String)| {
            let heading = Heading::of(metric);
            let own = Column::new(heading.lines_text(), move |line: &Line| mean_cell(&line.cells[index], seeds));
            let paper =
                Column::new("in the paper".into(), move |line: &Line| (published_text(&line.cells[index]), false));
            let published = table.lines.iter().any(|line| line.cells[index].published.is_some());
            Group { name: None, columns: if published { vec![own, paper] } else { vec![own] } }
        };
        let mut groups: Vec<Group> = table.metrics.iter().enumerate().map(of_metric).collect();
        for (name, text) in UNKNOWN_BACKBONE {
            if table.lines.iter().any(|line| !text(line).is_empty()) {
                let name = format!("{name} in the paper, of an unknown backbone");
                groups.push(Group { name: None, columns: vec![Column::new(name, move |line| (text(line), false))] });
            }
        }
        Means { groups, seeds }
    }

    fn caption(&self, table: &Table) -> String {
        let seeds = match self.seeds {
            Some(1) => ", of one seed".into(),
            Some(seeds) => format!(", mean ± standard deviation over {seeds} seeds"),
            None => ", mean ± standard deviation (number of seeds)".into(),
        };
        let compared = table.lines.iter().any(|line| line.baseline.is_some());
        format!("{}{seeds}.{}", table.title, if compared { BOLD_MEANS } else { "" })
    }

    fn blocks(&self, table: &Table) -> Vec<Block> {
        blocks(table, &self.groups, |_| true)
    }
}

/// Returns `25.31 ± 0.12`, followed by the seeds if they differ from the caption's.
fn mean_cell(cell: &Cell, seeds: Option<usize>) -> (String, bool) {
    let text = mean_text(cell);
    let text = match seeds {
        Some(_) => text.rsplit_once(" (").map_or(text.clone(), |(mean, _)| mean.into()),
        None => text,
    };
    (text, is_better(cell))
}

/// Returns two columns a metric: the difference with its interval, and p.
fn differences(table: &Table) -> Vec<Group<'_>> {
    let of_metric = |(index, metric): (usize, &String)| {
        let compared = move |line: &Line| line.cells[index].comparison;
        let difference = Column::new("difference".into(), move |line: &Line| {
            let sure = compared(line).and_then(|c| c.verdict()).is_some_and(|verdict| verdict.is_difference());
            (interval_of(&line.cells[index]), sure)
        });
        let p = Column::new("p".into(), move |line: &Line| (compared(line).map_or(String::new(), p_cell), false));
        Group { name: Some(Heading::of(metric).lines_text()), columns: vec![difference, p] }
    };
    table.metrics.iter().enumerate().map(of_metric).collect()
}

fn p_cell(comparison: Comparison) -> String {
    let p = comparison.p_holm.map_or(String::new(), p_text);
    if comparison.is_equivalent() { format!("{p} ≈") } else { p }
}

/// Returns the parts of a table, each with all lines that `shown` accepts, scene by scene.
fn blocks(table: &Table, groups: &[Group], shown: impl Fn(&Line) -> bool) -> Vec<Block> {
    let lines: Vec<&Line> = table.lines.iter().filter(|line| shown(line)).collect();
    let labels: Vec<String> = lines.iter().map(|line| rounded(&marked_label(line))).collect();
    let mut blocks = Vec::new();
    for part in parts(&labels, groups, &lines) {
        let rows: Vec<f64> = labels.iter().map(|label| part.label_rows(label)).collect();
        let mut at = 0;
        for count in floats::pages(&rows) {
            blocks.push(block(&part, &lines[at..at + count], &labels[at..at + count]));
            at += count;
        }
    }
    blocks
}

fn block(part: &Part, lines: &[&Line], labels: &[String]) -> Block {
    let (mut text, mut rows) = (part.begin(), part.head_rows());
    for (index, (line, label)) in lines.iter().zip(labels).enumerate() {
        if index == 0 || lines[index - 1].scene != line.scene {
            text += &format!(
                "\\midrule\n\\multicolumn{{{}}}{{l}}{{\\emph{{{}}}}} \\\\\n",
                part.count(),
                escape(&line.scene)
            );
            rows += 1.5;
        }
        rows += part.label_rows(label);
        text += &row_text(&part.cells(label, line));
    }
    Block::of_rows(text + "\\bottomrule\n\\end{tabular}\n", rows)
}

/// Returns the notes below the tables.
fn notes(table: &Table) -> Vec<String> {
    let of_scene = |(scene, lines): (&str, Vec<_>)| {
        let protocol = format!("{scene}, all rows: {}", protocol_text(&lines));
        let epochs = epochs_note(&lines, usize::MAX).map(|note| format!("{scene}: {note}"));
        epochs.into_iter().chain([protocol]).chain(scene_notes(&lines, usize::MAX))
    };
    let mut notes = table.notes.clone();
    notes.extend(table.scenes().into_iter().flat_map(of_scene).map(|note| rounded(&note)));
    if table.lines.iter().any(|line| line.baseline.is_some()) {
        notes.push(HOW_TO_READ.into());
    }
    notes.extend(further_notes(table, EQUIVALENT));
    notes
}
