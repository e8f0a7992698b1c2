//! A table as points: means with their seeds, and differences to the baseline with intervals.

use super::differences::{PANEL, ROW, Scale, TOP, widest, words};
use super::{Figure, metric_label};
use crate::base::Result;
use crate::draw::canvas::{Anchor, BLACK, BLUE, Canvas, GREY, TEXT, range};
use crate::report::tables::{Cell, Line, Table};
use crate::report::{Record, Status};
use crate::settings::columns::InactiveBy;

/// Draws one horizontal line for each line of the scene. Returns `None` if nothing is measured, or there is only one
/// line.
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
    let label_width = widest(labels.iter().map(String::as_str), 80.0);
    let comparisons = cells.iter().map(|cell| cell.comparison.as_ref());
    let words: Vec<String> = comparisons.map(|comparison| comparison.map_or(String::new(), words)).collect();
    let bottom = TOP + ROW * lines.len() as f64;
    let left = Scale { left: 20.0 + label_width + 16.0, range: values };
    let right = Scale { left: left.left + PANEL + 40.0, range: differences.unwrap_or((-1.0, 1.0)) };
    let title = format!("{}: {} on {scene}", table.title, metric_label(metric));
    let width = right.left + PANEL + widest(words.iter().map(String::as_str), 120.0) + 30.0;
    let mut drawing = Canvas::titled(width, bottom + 30.0, &title);
    left.frame(&mut drawing, metric_label(metric), bottom);
    right.frame(&mut drawing, "difference to the baseline, 95 % interval", bottom);
    right.zero(&mut drawing, bottom);
    for (index, (((cell, seeds), label), words)) in cells.iter().zip(&seeds).zip(&labels).zip(&words).enumerate() {
        let y = TOP + ROW * (index as f64 + 0.5);
        drawing.text((left.left - 10.0, y), label, TEXT, Anchor::Right, BLACK);
        draw_mean(&mut drawing, &left, y, cell, seeds);
        cell.comparison.iter().for_each(|comparison| right.difference(&mut drawing, y, comparison, words));
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
