//! A metric over two axes that are varied together, as coloured cells.

use super::{Figure, metric_label};
use crate::base::Result;
use crate::draw::canvas::{Anchor, BLACK, Canvas, Colour, GREY, PAPER, RED, TEXT, number, range, text_width, ticks};
use crate::draw::scale_colour;
use crate::metrics::Metric;
use crate::report::tables::{Cell, Line, Table, Verdict};
use crate::report::{AxisValue, Record, label};
use crate::settings::columns::InactiveBy;

const CELL: (f64, f64) = (74.0, 44.0);
const TOP: f64 = 70.0;
/// Width of the colour bar.
const BAR: f64 = 16.0;
/// Boxes of the colour bar.
const BAR_STEPS: usize = 64;

/// The points of one row on two axes, at one value of all further axes.
struct Map<'a> {
    title: String,
    across: &'a AxisValue,
    down: &'a AxisValue,
    columns: Vec<&'a str>,
    rows: Vec<&'a str>,
    /// Column and row of each cell, with its line in the table.
    cells: Vec<((usize, usize), &'a Line)>,
}

/// Draws a figure for each row and pair of axes of a scene that are varied together; empty if there is no such pair.
pub fn heatmap_figures(table: &Table, records: &[Record], scene: &str, metric: &str) -> Result<Vec<Figure>> {
    let Some(index) = table.metrics.iter().position(|known| known == metric) else { return Ok(Vec::new()) };
    let maps = maps(table, records, scene).into_iter().filter(|map| map.columns.len() > 1 && map.rows.len() > 1);
    maps.filter_map(|map| map.figure(table, scene, index).transpose()).collect()
}

fn maps<'a>(table: &'a Table, records: &'a [Record], scene: &str) -> Vec<Map<'a>> {
    let mut maps: Vec<Map> = Vec::new();
    for record in records.iter().filter(|record| record.scene == scene) {
        let [across, down, further @ ..] = record.axes.as_slice() else { continue };
        let title = label(&record.row, further);
        let on = |a: &AxisValue, b: &AxisValue| (&a.axis, &a.panel) == (&b.axis, &b.panel);
        let same = |map: &Map| map.title == title && on(map.across, across) && on(map.down, down);
        let at = maps.iter().position(same).unwrap_or_else(|| {
            let (columns, rows, cells) = (Vec::new(), Vec::new(), Vec::new());
            maps.push(Map { title, across, down, columns, rows, cells });
            maps.len() - 1
        });
        let map = &mut maps[at];
        let cell = (place(&mut map.columns, &across.value), place(&mut map.rows, &down.value));
        let name = record.label();
        let line = table.lines.iter().find(|line| line.scene == scene && line.label == name);
        if map.cells.iter().all(|(known, _)| *known != cell) {
            map.cells.extend(line.map(|line| (cell, line)));
        }
    }
    maps
}

/// Returns the index of a value in a list; a new value is added at the end.
fn place<'a>(values: &mut Vec<&'a str>, value: &'a str) -> usize {
    values.iter().position(|known| *known == value).unwrap_or_else(|| {
        values.push(value);
        values.len() - 1
    })
}

impl Map<'_> {
    fn figure(&self, table: &Table, scene: &str, metric: usize) -> Result<Option<Figure>> {
        let cell = |line: &Line| line.cells[metric].clone();
        let means = self.cells.iter().filter_map(|(_, line)| line.cells[metric].mean);
        let Some(range) = range(means) else { return Ok(None) };
        let key = &table.metrics[metric];
        let words = self.rows.iter().map(|value| text_width(value, TEXT)).fold(40.0, f64::max);
        let left = 20.0 + words.max(text_width(&axis_name(self.down), TEXT)) + 10.0;
        let (right, bottom) = (left + CELL.0 * self.columns.len() as f64, TOP + CELL.1 * self.rows.len() as f64);
        let title = format!("{}: {} on {scene}, {}", table.title, metric_label(key), self.title);
        let mut drawing = Canvas::titled((right + 140.0).max(560.0), bottom + 52.0, &title);
        drawing.text((20.0, TOP - 14.0), &axis_name(self.down), TEXT, Anchor::Left, BLACK);
        let middle = (left + right) / 2.0;
        drawing.text((middle, bottom + 34.0), &axis_name(self.across), TEXT, Anchor::Middle, BLACK);
        for (index, value) in self.columns.iter().enumerate() {
            let at = left + CELL.0 * (index as f64 + 0.5);
            drawing.text((at, bottom + 14.0), value, TEXT, Anchor::Middle, BLACK);
        }
        for (index, value) in self.rows.iter().enumerate() {
            drawing.text((left - 8.0, TOP + CELL.1 * (index as f64 + 0.5)), value, TEXT, Anchor::Right, BLACK);
        }
        for ((column, row), line) in &self.cells {
            let at = (left + CELL.0 * *column as f64, TOP + CELL.1 * *row as f64);
            draw_cell(&mut drawing, at, &cell(line), range);
        }
        draw_bar(&mut drawing, (right + 30.0, TOP), bottom - TOP, range);
        drawing.caption(&caption(self.cells.iter().map(|(_, line)| *line)));
        drawing.finish().map(Some)
    }
}

/// Returns `features: steps`.
fn axis_name(value: &AxisValue) -> String {
    if value.panel.is_empty() { value.axis.clone() } else { format!("{}: {}", value.panel, value.axis) }
}

fn share(value: f64, (low, high): (f64, f64)) -> f32 {
    ((value - low) / (high - low)) as f32
}

fn draw_cell(drawing: &mut Canvas, (x, y): (f64, f64), cell: &Cell, range: (f64, f64)) {
    let (width, height) = (CELL.0 - 2.0, CELL.1 - 2.0);
    let middle = (x + width / 2.0, y + height / 2.0);
    let Some(mean) = cell.mean.filter(|mean| mean.is_finite()) else {
        drawing.outline((x, y), (width, height), GREY, 1.0);
        drawing.text(middle, "no data", TEXT, Anchor::Middle, GREY);
        return;
    };
    let share = share(mean, range);
    box_of(drawing, (x, y), (width, height), share);
    let digits = |value: f64| Metric::find(&cell.metric).map_or_else(|| value.to_string(), |metric| metric.text(value));
    // The map is dark below its middle.
    let ink = if share < 0.55 { PAPER } else { BLACK };
    drawing.text((middle.0, middle.1 - 8.0), &digits(mean), TEXT, Anchor::Middle, ink);
    let spread = cell.deviation.map_or(String::new(), |deviation| format!("± {}", digits(deviation)));
    drawing.text((middle.0, middle.1 + 9.0), &spread, TEXT - 2.0, Anchor::Middle, ink);
    let verdict = cell.comparison.and_then(|comparison| comparison.verdict());
    if verdict.is_some_and(Verdict::is_difference) {
        drawing.outline((x + 1.0, y + 1.0), (width - 2.0, height - 2.0), RED, 3.0);
    }
}

fn box_of(drawing: &mut Canvas, (x, y): (f64, f64), (width, height): (f64, f64), share: f32) {
    let corners = vec![(x, y), (x + width, y), (x + width, y + height), (x, y + height)];
    drawing.area(corners, Colour::of(scale_colour(share)), 1.0);
}

/// Draws the colour bar, from the largest value down.
fn draw_bar(drawing: &mut Canvas, (x, y): (f64, f64), height: f64, range: (f64, f64)) {
    let step = height / BAR_STEPS as f64;
    for index in 0..BAR_STEPS {
        let share = 1.0 - (index as f32 + 0.5) / BAR_STEPS as f32;
        // A little larger, so that no gap is visible between two.
        box_of(drawing, (x, y + step * index as f64), (BAR, step + 0.5), share);
    }
    let (values, step) = ticks(range, (height / 40.0) as usize + 1);
    for value in values {
        let at = y + height * (1.0 - f64::from(share(value, range)));
        drawing.text((x + BAR + 6.0, at), &number(value, step), TEXT, Anchor::Left, BLACK);
    }
}

fn caption<'a>(lines: impl Iterator<Item = &'a Line> + Clone) -> String {
    let mut text =
        "Means over seeds, with standard deviations. Cells in a red frame differ from the baseline by Holm's p \
                    below 0.05, corrected over the rows of the scene's table."
            .to_string();
    for by in InactiveBy::ALL {
        let inactive = lines.clone().filter(|line| line.inactive_sites(by).is_some());
        let inactive: Vec<&str> = inactive.map(|line| line.axes.as_str()).collect();
        match inactive.len() {
            0 => {}
            all if all == lines.clone().count() => text += &format!(" Everywhere there are {}.", by.meaning()),
            _ => text += &format!(" There are {} at: {}.", by.meaning(), inactive.join("; ")),
        }
    }
    text
}
