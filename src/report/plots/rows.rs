//! A table as points: means with their seeds, and differences to the baseline with intervals.

use super::{Figure, metric_label};
use crate::base::Result;
use crate::draw::canvas::{
    Anchor, BLACK, BLUE, Canvas, GREY, GRID, RED, TEXT, TITLE, number, range, text_width, ticks,
};
use crate::report::tables::{Cell, Comparison, Line, Table, Verdict};
use crate::report::{Record, Status};
use crate::settings::columns::InactiveBy;

const ROW: f64 = 26.0;
const PANEL: f64 = 330.0;
const TOP: f64 = 64.0;

/// A horizontal scale.
struct Scale {
    left: f64,
    range: (f64, f64),
}

impl Scale {
    fn x(&self, value: f64) -> f64 {
        self.left + PANEL * (value - self.range.0) / (self.range.1 - self.range.0)
    }

    fn frame(&self, drawing: &mut Canvas, title: &str, bottom: f64) {
        let (values, step) = ticks(self.range, 5);
        for value in values {
            drawing.line(&[(self.x(value), TOP), (self.x(value), bottom)], GRID, 1.0);
            drawing.text((self.x(value), bottom + 12.0), &number(value, step), TEXT, Anchor::Middle, BLACK);
        }
        drawing.line(&[(self.left, bottom), (self.left + PANEL, bottom)], BLACK, 1.0);
        drawing.text((self.left + PANEL / 2.0, TOP - 14.0), title, TEXT, Anchor::Middle, BLACK);
    }
}

/// One horizontal line for each of the scene's lines; none where nothing is measured, or no line is beside another.
pub fn rows_figure(table: &Table, records: &[Record], scene: &str, metric: &str) -> Result<Option<Figure>> {
    let Some(column) = table.metrics.iter().position(|known| known == metric) else { return Ok(None) };
    let lines: Vec<&Line> = table.lines.iter().filter(|line| line.scene == scene && !line.quoted).collect();
    if lines.len() < 2 {
        return Ok(None);
    }
    let seeds: Vec<Vec<f64>> = lines.iter().map(|line| seeds(line, records, metric)).collect();
    let Some(values) = range(seeds.iter().flatten().copied()) else { return Ok(None) };
    let cells: Vec<&Cell> = lines.iter().map(|line| &line.cells[column]).collect();
    let intervals = cells.iter().filter_map(|cell| cell.comparison.as_ref()?.interval);
    let differences = range(intervals.flat_map(|(low, high)| [low, high]).chain([0.0]));
    let labels: Vec<String> = lines.iter().map(|line| label(line)).collect();
    let label_width = labels.iter().map(|label| text_width(label, TEXT)).fold(80.0, f64::max);
    let bottom = TOP + ROW * lines.len() as f64;
    let left = Scale { left: 20.0 + label_width + 16.0, range: values };
    let right = Scale { left: left.left + PANEL + 40.0, range: differences.unwrap_or((-1.0, 1.0)) };
    let mut drawing = Canvas::new(right.left + PANEL + words_width(&cells) + 30.0, bottom + 30.0);
    let title = format!("{}: {} on {scene}", table.title, metric_label(metric));
    drawing.text((20.0, 20.0), &title, TITLE, Anchor::Left, BLACK);
    left.frame(&mut drawing, metric_label(metric), bottom);
    right.frame(&mut drawing, "difference to the baseline, 95 % interval", bottom);
    drawing.line(&[(right.x(0.0), TOP), (right.x(0.0), bottom)], GREY, 1.5);
    for (index, ((cell, seeds), label)) in cells.iter().zip(&seeds).zip(&labels).enumerate() {
        let y = TOP + ROW * (index as f64 + 0.5);
        drawing.text((left.left - 10.0, y), label, TEXT, Anchor::Right, BLACK);
        draw_mean(&mut drawing, &left, y, cell, seeds);
        draw_difference(&mut drawing, &right, y, cell);
    }
    drawing.caption(&caption(&lines, column));
    drawing.finish().map(Some)
}

fn seeds(line: &Line, records: &[Record], metric: &str) -> Vec<f64> {
    let own =
        |record: &&Record| record.scene == line.scene && record.label() == line.label && record.status == Status::Done;
    records.iter().filter(own).filter_map(|record| record.metric(metric)).filter(|v| v.is_finite()).collect()
}

fn label(line: &Line) -> String {
    if line.inactive_levels.is_empty() { line.label.clone() } else { format!("{} †", line.label) }
}

fn draw_mean(drawing: &mut Canvas, scale: &Scale, y: f64, cell: &Cell, seeds: &[f64]) {
    let Some(mean) = cell.mean else {
        drawing.text((scale.left + 6.0, y), "no data", TEXT, Anchor::Left, GREY);
        return;
    };
    seeds.iter().for_each(|seed| drawing.dot((scale.x(*seed), y), 2.5, BLUE, 0.45));
    drawing.dot((scale.x(mean), y), 4.5, BLUE, 1.0);
}

fn draw_difference(drawing: &mut Canvas, scale: &Scale, y: f64, cell: &Cell) {
    let Some(comparison) = &cell.comparison else { return };
    let Some((low, high)) = comparison.interval else {
        drawing.text((scale.left + PANEL + 10.0, y), "one seed: no interval", TEXT, Anchor::Left, GREY);
        return;
    };
    // Colour and words by the one rule that tables follow.
    let colour = match comparison.verdict() {
        Some(verdict) if verdict.is_difference() => RED,
        _ if comparison.is_equivalent() => BLUE,
        _ => GREY,
    };
    drawing.line(&[(scale.x(low), y), (scale.x(high), y)], colour, 2.0);
    drawing.dot((scale.x(comparison.difference), y), 4.0, colour, 1.0);
    drawing.text((scale.left + PANEL + 10.0, y), &words(comparison), TEXT, Anchor::Left, colour);
}

/// Room for the words beside the differences.
fn words_width(cells: &[&Cell]) -> f64 {
    let words = cells.iter().filter_map(|cell| cell.comparison.as_ref()).map(words);
    words.map(|words| text_width(&words, TEXT)).fold(120.0, f64::max)
}

fn words(comparison: &Comparison) -> String {
    let verdict = comparison.verdict().map(Verdict::name);
    let equivalent = comparison.is_equivalent().then_some("equivalent");
    verdict.into_iter().chain(equivalent).collect::<Vec<&str>>().join(", ")
}

fn caption(lines: &[&Line], column: usize) -> String {
    let mut text = "Large dots are means over seeds, faint dots the seeds. Differences are paired by seed; higher and lower \
                    (red) by Holm's p below 0.05 over the rows of the scene's table, not distinguishable where the interval holds 0, no word \
                    between the two."
        .to_string();
    let comparisons = lines.iter().filter_map(|line| line.cells[column].comparison);
    let margins = comparisons.filter_map(|comparison| comparison.equivalence).map(|equivalence| equivalence.margin);
    if let Some(margin) = margins.reduce(f64::max) {
        text += &format!(" Equivalent: within {margin} of the baseline, by two one-sided tests (Holm).");
    }
    for by in InactiveBy::ALL {
        let sites = lines.iter().filter_map(|line| Some(format!("{} ({})", line.label, line.inactive_sites(by)?)));
        let sites: Vec<String> = sites.collect();
        if !sites.is_empty() {
            text += &format!(" † {}: {}.", by.meaning(), sites.join("; "));
        }
    }
    let mixed: Vec<&str> = lines.iter().filter(|line| !line.mixed.is_empty()).map(|line| line.label.as_str()).collect();
    if !mixed.is_empty() {
        text += &format!(" NOT COMPARABLE, drawn by force: {}.", mixed.join("; "));
    }
    text
}
