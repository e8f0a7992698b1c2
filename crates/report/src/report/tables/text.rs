//! Texts of the tables for readers before escaping: numbers, marks and notes.

use super::kinds::{is_without_fields, kind_notes, llff_note};
use super::together::number;
pub use super::together::{interval_text, mean_and_spread, mean_text, signed_interval, signed_text};
use super::{Cell, Comparison, Line, Table};
use crate::base::columns::{COLUMNS, CaptionRule, InactiveBy};
use crate::metrics::{DEPTH_MAE, DEPTH_RMSE, DEPTH_ROUGHNESS, Metric, NORMAL_ROUGHNESS, Needs, PSNR};
use crate::report::PUBLISHED_NOTE;
use crate::report::distinct;
use crate::report::statistics::p_text;

const HOW_TO_READ: &str = "difference to the baseline, paired by seed, with its 95 % Student t interval and the p value \
     after Holm's correction over the rows of the scene's table. \"higher\", \"lower\": that p is below 0.05. \"not \
     distinguishable\": the interval holds 0, which proves no equality. No word: neither";
const EQUIVALENCE: &str = "\"equivalent within\" a margin that the definition states: two one-sided paired t tests, with \
     Holm's p below 0.05";

/// Metrics that each row measures over its own pixels.
static OWN_PIXELS: [&Metric; 4] = [&DEPTH_MAE, &DEPTH_RMSE, &DEPTH_ROUGHNESS, &NORMAL_ROUGHNESS];

/// A mark after a row's name. What holds for few seeds has no symbol.
struct Mark {
    symbol: &'static str,
    meaning: &'static str,
    /// Returns the details for a line that has the mark.
    of: fn(&Line) -> Option<String>,
    /// A reader must know it before the numbers: a page begins with it.
    loud: bool,
}

const MARKS: [Mark; 9] = [
    quiet("#", "not run here: the paper's numbers alone", |line| line.quoted.then(String::new)),
    quiet("*", "not in the paper", |line| line.ours.then(String::new)),
    loud("†", InactiveBy::Loss.meaning(), |line| line.inactive_sites(InactiveBy::Loss)),
    loud("†", InactiveBy::Colour.meaning(), |line| line.inactive_sites(InactiveBy::Colour)),
    loud("‡", "NOT COMPARABLE, built by force", |line| {
        joined(&line.mixed).map(|fields| format!("differs from the scene's first row in {fields}"))
    }),
    loud("§", "points without numbers", |line| line.unfinished().then(|| status_and_reason(line))),
    loud("‖", "no better than one colour", most_of_one_colour),
    quiet("", "sites that are inactive with at most half of the seeds", |line| line.inactive(false)),
    loud("¶", "settings that differ between seeds", |line| joined(&line.differs)),
];

const fn quiet(symbol: &'static str, meaning: &'static str, of: fn(&Line) -> Option<String>) -> Mark {
    Mark { symbol, meaning, of, loud: false }
}

const fn loud(symbol: &'static str, meaning: &'static str, of: fn(&Line) -> Option<String>) -> Mark {
    Mark { symbol, meaning, of, loud: true }
}

/// Returns what a reader must know before the numbers: the number of rows of each such mark.
pub fn warnings(table: &Table) -> Vec<String> {
    let warning = |Mark { symbol, meaning, of, .. }: &Mark| {
        let rows = table.lines.iter().filter(|line| of(line).is_some()).count();
        (rows > 0).then(|| format!("{symbol} {meaning}: {}", of_rows(table, rows)))
    };
    MARKS.iter().filter(|mark| mark.loud).filter_map(warning).collect()
}

/// Returns `2 of 5 rows` of all that are run here, or `1 row` of a single one.
pub fn of_rows(table: &Table, count: usize) -> String {
    match table.lines.iter().filter(|line| !line.quoted).count() {
        1 => "1 row".into(),
        all => format!("{count} of {all} rows"),
    }
}

fn joined(names: &[String]) -> Option<String> {
    (!names.is_empty()).then(|| names.join(", "))
}

/// Returns with how many of its seeds a line is no better than one colour, if these are most: nothing to add for all.
fn most_of_one_colour(line: &Line) -> Option<String> {
    let seeds = line.no_better_than_one_colour.len();
    line.is_most(seeds).then(|| line.with_seeds(seeds).trim_start().to_string())
}

/// Returns which seeds learned nothing, for lines of which most did: `1 of 100 seeds learned nothing: NeRF (seed 37)`.
fn few_of_one_colour(lines: &[&Line], most: usize) -> Vec<String> {
    let count = |line: &Line| {
        let seeds = line.no_better_than_one_colour.len();
        let is_few = seeds > 0 && !line.is_most(seeds);
        is_few.then(|| format!("{seeds} of {} seeds learned nothing", line.ids.len()))
    };
    let text = |said: String| {
        let own = lines.iter().filter(|line| count(line).as_ref() == Some(&said));
        let rows: Vec<String> =
            own.map(|line| format!("{} ({})", line.label, line.no_better_than_one_colour.join(", "))).collect();
        let rows = if rows.len() > most { format!("{} rows", rows.len()) } else { rows.join(", ") };
        format!("{said}: {rows}")
    };
    distinct(lines.iter().filter_map(|line| count(line))).into_iter().map(text).collect()
}

fn status_and_reason(line: &Line) -> String {
    match line.reason.as_str() {
        "" => line.status.clone(),
        reason => format!("{}: {reason}", line.status),
    }
}

/// Returns whether a note says what a mark means.
pub fn is_of_mark(note: &str) -> bool {
    note.split_once(' ').is_some_and(|(start, _)| MARKS.iter().any(|mark| mark.symbol == start && !start.is_empty()))
}

/// Returns the line's label with its marks.
pub fn marked_label(line: &Line) -> String {
    let marks: String = MARKS.iter().filter(|mark| (mark.of)(line).is_some()).map(|mark| mark.symbol).collect();
    if marks.is_empty() { line.label.clone() } else { format!("{} {marks}", line.label) }
}

/// Returns a note as a sentence's start.
pub(super) fn capitalized(note: &str) -> String {
    let mut letters = note.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// Returns the protocol columns that follow one of these rules.
fn columns(rules: &[CaptionRule]) -> impl Iterator<Item = &'static str> {
    COLUMNS.iter().filter(|column| rules.contains(&column.caption)).map(|column| column.name)
}

/// Returns the protocol fields that a scene's measured lines share: `dataset llff, width 504, ...`.
pub(super) fn protocol_text(lines: &[&Line]) -> String {
    let measured: Vec<&&Line> = lines.iter().filter(|line| !line.ids.is_empty()).collect();
    if measured.is_empty() {
        return "nothing is measured yet".into();
    }
    let shared = columns(&[CaptionRule::Always]).filter_map(|name| {
        match distinct(measured.iter().map(|line| line.protocol(name))).as_slice() {
            [text] if !text.is_empty() => Some(format!("{name} {text}")),
            _ => None,
        }
    });
    shared.collect::<Vec<String>>().join(", ")
}

type CellText = fn(&Cell) -> String;

/// Head and cells of the table for readers, one row of cells a line.
pub(super) struct Grid {
    pub head: Vec<String>,
    /// In the order of the table's lines.
    pub rows: Vec<Vec<String>>,
}

impl Grid {
    /// Makes one column of means a metric, and columns of differences and published numbers if the table has any.
    pub fn new(table: &Table) -> Grid {
        let mut head = vec!["row".to_string()];
        let mut rows: Vec<Vec<String>> = table.lines.iter().map(|line| vec![marked_label(line)]).collect();
        for (index, metric) in table.metrics.iter().enumerate() {
            let columns: [(&str, CellText); 3] =
                [("", mean_text), (" difference", difference_text), (" in the paper", published_text)];
            for (kind, text) in columns {
                let cells: Vec<String> = table.lines.iter().map(|line| text(&line.cells[index])).collect();
                if kind.is_empty() || cells.iter().any(|cell| !cell.is_empty()) {
                    head.push(format!("{metric}{kind}"));
                    rows.iter_mut().zip(cells).for_each(|(row, cell)| row.push(cell));
                }
            }
        }
        for (name, text) in UNKNOWN_BACKBONE {
            let cells: Vec<String> = table.lines.iter().map(text).collect();
            if cells.iter().any(|cell| !cell.is_empty()) {
                head.push(format!("{name} in the paper, of an unknown backbone"));
                rows.iter_mut().zip(cells).for_each(|(row, cell)| row.push(cell));
            }
        }
        Grid { head, rows }
    }
}

/// A column's name, and its text in a line.
pub type Column = (&'static str, fn(&Line) -> String);

/// The paper's numbers that match none of our metrics: it does not name the backbone of its LPIPS.
pub const UNKNOWN_BACKBONE: [Column; 2] = [
    ("LPIPS", |line| line.published_lpips.map_or(String::new(), |value| format!("{value:.3}"))),
    ("average", |line| line.published_average.map_or(String::new(), |value| format!("{value:.3}"))),
];

/// Returns `+0.31 [+0.10, +0.52], p 0.021, higher`; the last word is the verdict, if there is one.
pub(super) fn difference_text(cell: &Cell) -> String {
    let Some(comparison) = &cell.comparison else { return String::new() };
    let difference = interval_of(cell);
    match comparison.interval {
        Some(_) => format!("{difference}{}", conclusion(cell, comparison)),
        None => format!("{difference}, no interval"),
    }
}

/// Returns `+0.31 [+0.10, +0.52]`, with the number of pairs if a seed has none; empty without a comparison.
pub fn interval_of(cell: &Cell) -> String {
    let Some(comparison) = &cell.comparison else { return String::new() };
    let pairs = if comparison.pairs < cell.n { format!(" ({} pairs)", comparison.pairs) } else { String::new() };
    signed_interval(&cell.metric, comparison.difference, comparison.interval) + &pairs
}

fn conclusion(cell: &Cell, comparison: &Comparison) -> String {
    let p = comparison.p_holm.map_or(String::new(), |p| format!(", p {}", p_text(p)));
    let words = comparison.verdict().map_or(String::new(), |verdict| format!(", {}", verdict.name()));
    let equivalence = comparison.equivalence.filter(|equivalence| equivalence.holds());
    let equivalent = equivalence.map_or(String::new(), |equivalence| {
        format!(", equivalent within {}", number(&cell.metric, equivalence.margin))
    });
    format!("{p}{words}{equivalent}")
}

/// Returns the paper's number with the paper's digits; empty without one.
pub fn published_text(cell: &Cell) -> String {
    cell.published.map_or(String::new(), |value| number(&cell.metric, value))
}

/// Returns the notes below the lines of a scene. Of more rows than `most`, a note says how many they are.
pub fn scene_notes(lines: &[&Line], most: usize) -> Vec<String> {
    let mut notes = baseline_notes(lines, most);
    notes.extend(floor_note(lines));
    notes.extend(corruption_notes(lines));
    notes.extend(varied_notes(lines, most));
    notes.extend(kind_notes(lines));
    notes.extend(MARKS.iter().filter_map(|mark| mark_note(mark, lines, most)));
    notes.extend(few_of_one_colour(lines, most));
    notes.extend(unmeasured_notes(lines));
    notes.extend(published_notes(lines, most));
    notes
}

/// Returns the notes below the table on how to read its cells.
pub(super) fn general_notes(table: &Table) -> Vec<String> {
    let mut notes = table.notes.clone();
    notes.push("mean ± standard deviation (number of seeds)".into());
    if table.lines.iter().any(|line| line.baseline.is_some()) {
        notes.push(HOW_TO_READ.to_string());
    }
    notes.extend(further_notes(table, EQUIVALENCE));
    notes
}

/// Returns the notes below a table in every form; `equivalence` explains the test, if it was made.
pub fn further_notes(table: &Table, equivalence: &str) -> Vec<String> {
    let mut notes = Vec::new();
    let is_own = |metric: &&String| OWN_PIXELS.iter().any(|own| own.key == *metric);
    let has_verdict = |metric: &str| {
        let cells = table.lines.iter().flat_map(|line| &line.cells).filter(|cell| cell.metric == metric);
        cells.filter_map(|cell| cell.comparison).any(|comparison| comparison.verdict().is_some())
    };
    let own: Vec<&str> =
        table.metrics.iter().filter(is_own).map(String::as_str).filter(|metric| has_verdict(metric)).collect();
    if !own.is_empty() {
        notes.push(format!(
            "{}: over the pixels where a row is solid itself, so that rows are compared on different pixels, and one that \
             leaves more out (depth_left_out) on easier ones; metrics named _common are over the pixels that all rows have",
            own.join(", ")
        ));
    }
    let compared = || table.lines.iter().flat_map(|line| &line.cells).filter_map(|cell| cell.comparison);
    if compared().any(|comparison| comparison.equivalence.is_some()) {
        notes.push(equivalence.to_string());
    }
    if table.lines.iter().any(|line| !line.published_protocol.is_empty()) {
        notes.push(PUBLISHED_NOTE.to_string());
    }
    notes.extend(llff_note(table));
    notes
}

fn baseline_notes(lines: &[&Line], most: usize) -> Vec<String> {
    match labels_by(lines, most, |line| line.baseline.clone()).as_slice() {
        [(baseline, _)] => vec![format!("baseline: {baseline}")],
        several => several.iter().map(|(baseline, labels)| format!("baseline of {labels}: {baseline}")).collect(),
    }
}

/// Returns what a picture of one colour would have, beside which PSNR means something.
fn floor_note(lines: &[&Line]) -> Option<String> {
    let floors = || lines.iter().filter_map(|line| line.floor_psnr);
    let ends = [floors().reduce(f64::min)?, floors().reduce(f64::max)?];
    let [first, last] = ends.map(|floor| number(PSNR.key, floor));
    let range = if first == last { first } else { format!("{first} to {last}") };
    Some(format!("PSNR of the best single colour of the training views: {range} dB"))
}

/// Returns the cost of corrupted training views: a line against one of the same method on clean views. If the cost is
/// small, no line of the table tests robustness to the corruption.
fn corruption_notes(lines: &[&Line]) -> Vec<String> {
    let note = |line: &&Line| {
        let baseline = lines.iter().find(|other| Some(&other.label) == line.baseline.as_ref())?;
        let same = |name: &str| line.protocol(name) == baseline.protocol(name);
        let (own, other) = (line.protocol("corruption"), baseline.protocol("corruption"));
        if own.is_empty() == other.is_empty() || !["method", "perturb_kind", "regularizers"].into_iter().all(same) {
            return None;
        }
        // Clean minus corrupted, whichever is the baseline.
        let (sign, what, whom) = if own.is_empty() { (1.0, other, &baseline.label) } else { (-1.0, own, &line.label) };
        let cost = |cell: &Cell| {
            let comparison = cell.comparison?;
            let turned = |(low, high): (f64, f64)| if sign < 0.0 { (-high, -low) } else { (low, high) };
            let text = signed_interval(&cell.metric, sign * comparison.difference, comparison.interval.map(turned));
            Some(format!("{} {text}", cell.metric))
        };
        let costs: Vec<String> = line.cells.iter().filter_map(cost).collect();
        (!costs.is_empty()).then(|| {
            format!(
                "cost of {what} to {whom}: {} (clean minus corrupted, paired by seed, 95 % interval)",
                costs.join(", ")
            )
        })
    };
    lines.iter().filter_map(note).collect()
}

/// Returns the settings that the definition varies between lines and that a reader might think equal.
fn varied_notes(lines: &[&Line], most: usize) -> Vec<String> {
    let value = |line: &Line, name: &str| match line.protocol(name) {
        // A hash grid without occupied cells, beside one with them.
        "" if name == "occupancy" && !line.protocol("hash_grid").is_empty() => Some("none".to_string()),
        "" => None,
        text => Some(text.to_string()),
    };
    let varied = columns(&[CaptionRule::Always, CaptionRule::Differing]).filter_map(|name| {
        let values = labels_by(lines, most, |line| value(line, name));
        let named: Vec<String> = values.iter().map(|(value, labels)| format!("{value} ({labels})")).collect();
        (values.len() > 1).then(|| format!("rows differ in {name}: {}", named.join("; ")))
    });
    varied.collect()
}

fn mark_note(Mark { symbol, meaning, of, .. }: &Mark, lines: &[&Line], most: usize) -> Option<String> {
    let marked = labels_by(lines, most, of).into_iter().map(|(what, labels)| match what.as_str() {
        "" => labels,
        what => format!("{labels} ({what})"),
    });
    let marked: Vec<String> = marked.collect();
    (!marked.is_empty()).then(|| format!("{symbol} {meaning}: {}", marked.join("; ")).trim_start().to_string())
}

/// Returns why a column is empty, for metrics that no line of the scene has.
fn unmeasured_notes(lines: &[&Line]) -> Vec<String> {
    let measured: Vec<&Line> = lines.iter().copied().filter(|line| !line.ids.is_empty()).collect();
    let Some(first) = measured.first() else { return Vec::new() };
    let with_weights = measured.iter().any(|line| !line.protocol("lpips_weights").is_empty());
    let note = |metric: usize| {
        let (empty, filled): (Vec<&Line>, Vec<&Line>) =
            measured.iter().copied().partition(|line| line.cells[metric].n == 0);
        let metric = Metric::find(&first.cells[metric].metric)?;
        if filled.is_empty() {
            return Some(format!("{}: empty, {}", metric.key, why_empty(metric.needs, with_weights)));
        }
        // Some rows have it; others have no field to measure it on.
        let cannot = |line: &&Line| metric.needs == Needs::DerivativesAtPoints && is_without_fields(line);
        let labels: Vec<&str> = empty.into_iter().filter(cannot).map(|line| line.label.as_str()).collect();
        let why = "which are no fields that are queried at points";
        (!labels.is_empty()).then(|| format!("{}: empty of {}, {why}", metric.key, labels.join(", ")))
    };
    (0..first.cells.len()).filter_map(note).collect()
}

fn why_empty(needs: Needs, with_weights: bool) -> &'static str {
    match (needs, with_weights) {
        (Needs::Lpips(_), false) => {
            "no LPIPS weights were given; `sweep run --remeasure` with --lpips-weights measures it from the checkpoints"
        }
        (Needs::Lpips(_), true) => "the weights are of another backbone, or the views are too small for this one",
        (Needs::Depth, _) => "the scene's held-out views have no depth to measure it by",
        (Needs::ExactDepth, _) => "the scene's held-out views have no exact depth to measure it by",
        (Needs::DerivativesAtPoints, _) => "the rows' fields have no derivatives at points",
        (Needs::Mesh, _) => "no surface was compared with a reference mesh",
        (Needs::Nothing, _) => "the program that measured the points did not measure it; `sweep run --remeasure` does",
    }
}

fn published_notes(lines: &[&Line], most: usize) -> Vec<String> {
    let protocol = |line: &Line| {
        let known = Some(&line.published_protocol).filter(|text| !text.is_empty())?;
        Some(match line.protocol_difference.as_str() {
            "" => known.clone(),
            difference => format!("{known}; here {difference}"),
        })
    };
    let notes = labels_by(lines, most, protocol);
    notes.into_iter().map(|(protocol, labels)| format!("in the paper, {labels}: {protocol}")).collect()
}

/// Returns each distinct text with the labels of its lines.
fn labels_by(lines: &[&Line], most: usize, text: impl Fn(&Line) -> Option<String>) -> Vec<(String, String)> {
    let texts = distinct(lines.iter().filter_map(|line| text(line)));
    let labels = |said: &str| {
        let of = lines.iter().filter(|line| text(line).as_deref() == Some(said)).map(|line| line.label.as_str());
        match of.collect::<Vec<&str>>() {
            many if many.len() > most => format!("{} rows", many.len()),
            few => few.join(", "),
        }
    };
    texts.into_iter().map(|said| (said.clone(), labels(&said))).collect()
}

#[cfg(test)]
mod tests {
    use super::super::Equivalence;
    use super::*;

    fn cell(metric: &str, n: usize, comparison: Option<Comparison>) -> Cell {
        Cell { metric: metric.into(), n, mean: Some(1.0), deviation: None, comparison, published: None }
    }

    #[test]
    fn differences_say_how_sure_they_are() {
        let interval = Some((0.25, 0.75));
        let sure = Comparison {
            pairs: 3,
            difference: 0.5,
            deviation: Some(0.1),
            interval,
            p: Some(0.01),
            p_holm: Some(0.0001),
            simultaneous: None,
            equivalence: None,
        };
        assert_eq!(difference_text(&cell("psnr", 3, Some(sure))), "+0.50 [+0.25, +0.75], p < 0.001, higher");
        let below = Comparison { difference: -0.5, interval: Some((-0.75, -0.25)), p_holm: Some(0.0496), ..sure };
        assert_eq!(difference_text(&cell("psnr", 3, Some(below))), "-0.50 [-0.75, -0.25], p 0.04960, lower");
        // The interval excludes 0, but the corrected p is not significant.
        let between = Comparison { p_holm: Some(0.07), ..sure };
        assert_eq!(difference_text(&cell("psnr", 3, Some(between))), "+0.50 [+0.25, +0.75], p 0.070");
        let unsure = Comparison { pairs: 2, interval: Some((-0.25, 1.25)), p_holm: Some(0.5), ..sure };
        let text = "+0.50 [-0.25, +1.25] (2 pairs), p 0.500, not distinguishable";
        assert_eq!(difference_text(&cell("psnr", 3, Some(unsure))), text);
        let tested = |p_holm| Some(Equivalence { margin: 2.0, p: Some(0.01), p_holm });
        let equal = Comparison { equivalence: tested(Some(0.04)), ..unsure };
        assert_eq!(difference_text(&cell("psnr", 3, Some(equal))), format!("{text}, equivalent within 2.00"));
        let unknown = Comparison { equivalence: tested(Some(0.05)), ..unsure };
        assert_eq!(difference_text(&cell("psnr", 3, Some(unknown))), text);
        let single = Comparison { pairs: 1, interval: None, p: None, p_holm: None, ..sure };
        assert_eq!(difference_text(&cell("psnr", 1, Some(single))), "+0.50, no interval");
        assert_eq!(difference_text(&cell("psnr", 1, None)), "");
    }
}
