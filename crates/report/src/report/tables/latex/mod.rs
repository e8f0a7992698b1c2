//! The tables for a paper, as LaTeX with `booktabs`: means with their spread, then differences to baselines with their
//! intervals. By few rules both fit a text of 17 cm, at names and numbers of a usual length: labels wrap in a first column of one
//! width, a part has few metrics side by side, and rows are counted by letters.

mod escape;

use super::heading::{Heading, is_better};
use super::text::{
    UNKNOWN_BACKBONE, further_notes, interval_of, marked_label, mean_text, protocol_text, published_text, scene_notes,
};
use super::{Cell, Comparison, Line, Table, epochs_note};
use crate::draw::numbers::rounded;
use crate::report::statistics::p_text;
use escape::{LETTER, escape};

const HEAD: &str =
    "% Needs \\usepackage{booktabs}. Fits a text of 17 cm, as \\usepackage[a4paper,margin=2cm]{geometry} leaves.\n";
const BOLD_MEANS: &str = " Bold: better than the baseline, Holm's p below 0.05.";
const BOLD_DIFFERENCES: &str = "Bold: Holm's p is below 0.05.";
const HOW_TO_READ: &str = "Differences are paired by seed and stand with their 95 % Student t intervals; p is that of the paired t \
     test after Holm's correction over the rows of the scene's table. An interval that holds 0 proves no equality.";
const EQUIVALENT: &str = "≈ behind p: equivalent within the margin that the definition states (two one-sided paired t tests, Holm's p \
     below 0.05)";

/// Width of the first column, and how many letters surely fit into one of its lines.
const LABEL: &str = "38mm";
const LABEL_LETTERS: usize = 22;
/// Letters that surely fit into a line of the notes.
const NOTE_LETTERS: usize = 105;
/// Metrics side by side: means, and differences with their intervals.
const MEANS: usize = 3;
const DIFFERENCES: usize = 2;
/// Rows of an environment: a page with margins of 2 cm has more, for captions and rules.
const ROWS: usize = 62;
/// Environments in a row that LaTeX surely holds: of more than 52 it gives up.
const FLOATS: usize = 20;
/// Rows of a part besides those of its lines.
const HEAD_ROWS: usize = 6;

/// The text of a line in a column, and whether it is bold.
type LineText<'a> = Box<dyn Fn(&Line) -> (String, bool) + 'a>;

/// A column: its head, the room in which the head wraps, and its text in a line.
struct Column<'a> {
    head: String,
    room: &'static str,
    cell: LineText<'a>,
}

impl<'a> Column<'a> {
    fn new(head: &str, room: &'static str, cell: impl Fn(&Line) -> (String, bool) + 'a) -> Column<'a> {
        Column { head: head.into(), room, cell: Box::new(cell) }
    }

    fn text(&self, line: &Line) -> String {
        match (self.cell)(line) {
            (text, true) if !text.is_empty() => format!("{{\\textbf{{\\boldmath {}}}}}", escape(&text)),
            (text, _) => format!("{{{}}}", escape(&text)),
        }
    }
}

/// LaTeX that stays on one page, with its height in rows.
type Block = (String, usize);

/// Returns the table of means, the table of differences if rows are compared, and the notes to both.
pub fn table_latex(table: &Table) -> String {
    let lines: Vec<&Line> = table.lines.iter().collect();
    let (mut text, mut caption, mut blocks) = (String::new(), caption(table), parts(&lines, &means(table), MEANS));
    if is_compared(table) {
        text = environments(&caption, &blocks);
        caption = format!("{}: differences to the baseline. {BOLD_DIFFERENCES}", table.title);
        let is_compared = |line: &&Line| line.cells.iter().any(|cell| cell.comparison.is_some());
        let lines: Vec<&Line> = lines.into_iter().filter(is_compared).collect();
        blocks = parts(&lines, &differences(table), DIFFERENCES);
    }
    blocks.extend(note_blocks(&notes(table)));
    text += &environments(&caption, &blocks);
    let letters = if text.contains("\\augnerfletter") { LETTER } else { "" };
    format!("{HEAD}{letters}{text}")
}

fn is_compared(table: &Table) -> bool {
    table.lines.iter().any(|line| line.baseline.is_some())
}

/// Returns the seeds of every cell with numbers, if they are the same.
fn seeds(table: &Table) -> Option<usize> {
    let counts = || table.lines.iter().flat_map(|line| &line.cells).map(|cell| cell.n).filter(|n| *n > 0);
    counts().next().filter(|first| counts().all(|n| n == *first))
}

fn caption(table: &Table) -> String {
    let seeds = match seeds(table) {
        Some(1) => ", of one seed".into(),
        Some(seeds) => format!(", mean ± standard deviation over {seeds} seeds"),
        None => ", mean ± standard deviation (number of seeds)".into(),
    };
    format!("{}{seeds}.{}", table.title, if is_compared(table) { BOLD_MEANS } else { "" })
}

/// Returns the columns of each metric: its mean, and the paper's number if it has one.
fn means(table: &Table) -> Vec<Vec<Column<'_>>> {
    let seeds = seeds(table);
    let of_metric = |(index, metric): (usize, &String)| {
        let cell = move |line: &Line| mean_cell(&line.cells[index], seeds);
        let mut columns = vec![Column::new(&Heading::of(metric).lines_text(), "21mm", cell)];
        if table.lines.iter().any(|line| line.cells[index].published.is_some()) {
            let cell = move |line: &Line| (published_text(&line.cells[index]), false);
            columns.push(Column::new("in the paper", "11mm", cell));
        }
        columns
    };
    let unknown =
        UNKNOWN_BACKBONE.into_iter().filter(|(_, text)| table.lines.iter().any(|line| !text(line).is_empty()));
    let unknown = unknown.map(|(name, text)| {
        let head = format!("{name} in the paper, of an unknown backbone");
        vec![Column::new(&head, "28mm", move |line| (text(line), false))]
    });
    table.metrics.iter().enumerate().map(of_metric).chain(unknown).collect()
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
fn differences(table: &Table) -> Vec<Vec<Column<'_>>> {
    let of_metric = |(index, metric): (usize, &String)| {
        let compared = move |line: &Line| line.cells[index].comparison;
        let difference = move |line: &Line| {
            let sure = compared(line).and_then(|c| c.verdict()).is_some_and(|verdict| verdict.is_difference());
            (interval_of(&line.cells[index]), sure)
        };
        let p = move |line: &Line| (compared(line).map_or(String::new(), p_cell), false);
        vec![Column::new(&Heading::of(metric).lines_text(), "32mm", difference), Column::new("p", "8mm", p)]
    };
    table.metrics.iter().enumerate().map(of_metric).collect()
}

fn p_cell(comparison: Comparison) -> String {
    let p = comparison.p_holm.map_or(String::new(), p_text);
    if comparison.is_equivalent() { format!("{p} ≈") } else { p }
}

/// A line of the table, with its height in rows.
type Tall<'t> = (&'t Line, usize);

/// Returns the parts of a table, of as many metrics side by side as `across`; each fits on a page.
fn parts(lines: &[&Line], metrics: &[Vec<Column>], across: usize) -> Vec<Block> {
    let rows = |index: usize| {
        let begins_scene = index == 0 || lines[index - 1].scene != lines[index].scene;
        label_rows(lines[index]) + if begins_scene { 2 } else { 0 }
    };
    let lines: Vec<Tall> = lines.iter().enumerate().map(|(index, line)| (*line, rows(index))).collect();
    let mut blocks = Vec::new();
    for metrics in metrics.chunks(across) {
        let columns: Vec<&Column> = metrics.iter().flatten().collect();
        blocks.extend(runs(&lines, ROWS - HEAD_ROWS, |(_, rows)| *rows).map(|lines| tabular(&columns, lines)));
    }
    blocks
}

fn label_rows(line: &Line) -> usize {
    marked_label(line).chars().count().div_ceil(LABEL_LETTERS)
}

fn tabular(columns: &[&Column], lines: &[Tall]) -> Block {
    let head = |column: &&Column| format!("\\parbox[b]{{{}}}{{\\raggedleft {}}}", column.room, escape(&column.head));
    let heads: Vec<String> = columns.iter().map(head).collect();
    let mut text = format!("\\begin{{tabular}}{{p{{{LABEL}}}{}}}\n\\toprule\n", "r".repeat(columns.len()));
    text += &format!("{{}} & {} \\\\\n", heads.join(" & "));
    for lines in lines.chunk_by(|(a, _), (b, _)| a.scene == b.scene) {
        let across = columns.len() + 1;
        text += &format!("\\midrule\n\\multicolumn{{{across}}}{{l}}{{\\emph{{{}}}}} \\\\\n", escape(&lines[0].0.scene));
        for (line, _) in lines {
            // Braces or a paragraph's end would double the height of the row.
            let label = format!("\\raggedright {}", escape(&rounded(&marked_label(line))));
            let cells: Vec<String> = std::iter::once(label).chain(columns.iter().map(|c| c.text(line))).collect();
            text += &format!("{} \\\\\n", cells.join(" & "));
        }
    }
    let rows: usize = lines.iter().map(|(_, rows)| rows).sum();
    (text + "\\bottomrule\n\\end{tabular}\n", rows + HEAD_ROWS)
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
    if is_compared(table) {
        notes.push(HOW_TO_READ.into());
    }
    notes.extend(further_notes(table, EQUIVALENT));
    notes
}

/// Returns notes, one paragraph each, in blocks of at most half a page unless a note is longer.
fn note_blocks(notes: &[String]) -> Vec<Block> {
    let rows = |note: &String| note.chars().count().div_ceil(NOTE_LETTERS);
    let block = |notes: &[String]| {
        let text: String = notes.iter().map(|note| format!("{}\\par\n", escape(note))).collect();
        let text = format!("\\begin{{minipage}}{{\\linewidth}}\n\\raggedright\n{text}\\end{{minipage}}\n");
        (text, 1 + notes.iter().map(rows).sum::<usize>())
    };
    runs(notes, ROWS / 2, rows).map(block).collect()
}

/// Puts the blocks into as many environments as their rows need, each with the caption.
fn environments(caption: &str, blocks: &[Block]) -> String {
    let environment = |(index, blocks): (usize, &[Block])| {
        let again = if index == 0 { "" } else { " (continued)" };
        let clear = if (index + 1).is_multiple_of(FLOATS) { "\\clearpage\n" } else { "" };
        let blocks: Vec<&str> = blocks.iter().map(|(text, _)| text.as_str()).collect();
        format!(
            "\\begin{{table}}\n\\centering\n\\setlength{{\\abovecaptionskip}}{{0pt}}\n\\setlength{{\\belowcaptionskip}}{{6pt}}\n\
             \\caption{{{}{again}}}\n\\footnotesize\n\\setlength{{\\tabcolsep}}{{4pt}}\n{}\\end{{table}}\n{clear}",
            escape(caption),
            blocks.join("\n\\medskip\n")
        )
    };
    runs(blocks, ROWS, |(_, rows)| *rows).enumerate().map(environment).collect()
}

/// Splits items into runs of at most `most` rows, or of one item.
fn runs<T>(items: &[T], most: usize, rows: impl Fn(&T) -> usize) -> impl Iterator<Item = &[T]> {
    let mut taken = 0;
    items.chunk_by(move |before, after| {
        taken += rows(before);
        let fits = taken + rows(after) <= most;
        taken = if fits { taken } else { 0 };
        fits
    })
}
