//! A table as points: means with their seeds, and differences to the baseline with intervals.

use super::differences::{FOOT, MARKS, NOT_SHOWN, Scale, absent, heights, middles, words};
use super::{Figure, Stroke, Style, canvas, metric_label, range_of};
use crate::base::columns::InactiveBy;
use crate::draw::canvas::{Anchor, Canvas, GREY, LINE_HEIGHT, PAGE, SIDE, TEXT, text_width};
use crate::metrics::Metric;
use crate::report::tables::{Cell, Line, Table};
use crate::report::{Record, Status, distinct};

/// Most room of the names.
const NAMES: f64 = 230.0;
const GAP: f64 = 30.0;

/// Draws one horizontal line for each line of the scene. Returns `None` if nothing is measured, or there is only one
/// line.
pub fn rows_figure(style: Style, table: &Table, records: &[Record], scene: &str, metric: &str) -> Option<Figure> {
    let column = table.metrics.iter().position(|known| known == metric)?;
    let lines: Vec<&Line> = table.lines.iter().filter(|line| line.scene == scene && !line.quoted).collect();
    if lines.len() < 2 {
        return None;
    }
    let seeds: Vec<Vec<f64>> = lines.iter().map(|line| seeds(line, records, metric)).collect();
    let values = range_of(metric, seeds.iter().flatten().copied())?;
    let cells: Vec<&Cell> = lines.iter().map(|line| &line.cells[column]).collect();
    let ends = cells.iter().filter_map(|cell| cell.comparison).flat_map(|comparison| {
        let (low, high) = comparison.interval.unwrap_or((comparison.difference, comparison.difference));
        [low, high]
    });
    let differences = range_of(metric, ends.chain([0.0])).unwrap_or((-1.0, 1.0));
    let names: Vec<String> = lines.iter().map(|line| label(line)).collect();
    let mut drawing = canvas();
    let [mut left, mut right] = scales(&names, &said(&cells), values, differences);
    let heads = [left.head(metric_label(metric)), right.head(&difference_head(&lines, metric))];
    let top = drawing.height + heads.iter().map(Vec::len).max().unwrap_or(1) as f64 * LINE_HEIGHT + 8.0;
    (left.top, right.top) = (top, top);
    let room = left.left - SIDE - 10.0;
    let (middles, bottom) = middles(&heights(&names, room), top);
    left.frame(&mut drawing, &heads[0], bottom);
    right.frame(&mut drawing, &heads[1], bottom);
    right.zero(&mut drawing, bottom);
    for (((line, cell), y), (name, seeds)) in lines.iter().zip(&cells).zip(middles).zip(names.iter().zip(&seeds)) {
        drawing.name((left.left - 10.0, y), room, name);
        draw_mean(&mut drawing, &left, y, (line, cell), seeds, style.stroke(&line.row));
        let Some(comparison) = &cell.comparison else { continue };
        right.difference(&mut drawing, y, metric, comparison);
        drawing.text((right.right() + 8.0, y), &words(metric, comparison), TEXT, Anchor::Left, GREY);
    }
    drawing.height = bottom + FOOT;
    Some(style.finish(drawing, &format!("{} on {scene}", metric_label(metric)), &caption(&lines, column)))
}

/// Places both scales beside the names.
fn scales(names: &[String], said: &[String], values: (f64, f64), differences: (f64, f64)) -> [Scale; 2] {
    let widest = |texts: &[String], least: f64| texts.iter().map(|text| text_width(text, TEXT)).fold(least, f64::max);
    let names = widest(names, 60.0).min(NAMES);
    let left = SIDE + names + 10.0;
    let each = (PAGE - left - GAP - widest(said, 10.0) - 8.0 - SIDE) / 2.0;
    let scale = |left: f64, range: (f64, f64)| Scale { left, width: each, top: 0.0, range };
    [scale(left, values), scale(left + each + GAP, differences)]
}

/// Returns what stands at the end of each line.
fn said(cells: &[&Cell]) -> Vec<String> {
    cells.iter().filter_map(|cell| Some(words(&cell.metric, &cell.comparison?))).collect()
}

/// Returns `difference to NeRF (dB), 95 % interval`.
fn difference_head(lines: &[&Line], metric: &str) -> String {
    let baseline = match distinct(lines.iter().filter_map(|line| line.baseline.as_deref())).as_slice() {
        [only] => only.to_string(),
        _ => "the baseline".into(),
    };
    let unit = Metric::find(metric).map(|metric| metric.unit).filter(|unit| !unit.is_empty());
    format!("difference to {baseline}{}, 95 % interval", unit.map_or(String::new(), |unit| format!(" ({unit})")))
}

fn seeds(line: &Line, records: &[Record], metric: &str) -> Vec<f64> {
    let own =
        |record: &&Record| record.scene == line.scene && record.label() == line.label && record.status == Status::Done;
    records.iter().filter(own).filter_map(|record| record.metric(metric)).filter(|v| v.is_finite()).collect()
}

fn label(line: &Line) -> String {
    let is_marked = InactiveBy::ALL.into_iter().any(|by| line.inactive_sites(by).is_some());
    if is_marked { format!("{} †", line.label) } else { line.label.clone() }
}

fn draw_mean(drawing: &mut Canvas, scale: &Scale, y: f64, (line, cell): (&Line, &Cell), seeds: &[f64], own: Stroke) {
    let Some(mean) = cell.mean else {
        drawing.text((scale.left + 6.0, y), absent(line), TEXT, Anchor::Left, GREY);
        return;
    };
    seeds.iter().for_each(|seed| drawing.dot((scale.x(*seed), y), 2.5, own.colour, 0.45));
    drawing.dot((scale.x(mean), y), 4.5, own.colour, 1.0);
}

fn caption(lines: &[&Line], column: usize) -> String {
    let mut text = format!(
        "Large dots are means over seeds, faint dots the seeds. Differences are paired by seed. {MARKS} the rows of the \
         scene's table. {NOT_SHOWN}"
    );
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
