//! A metric over two axes that are varied together, as coloured cells.

use super::places::Places;
use super::{Figure, Style, canvas, metric_label, range_of};
use crate::base::Result;
use crate::draw::canvas::{
    Anchor, BLACK, BLUE, Canvas, Colour, GREY, LINE_HEIGHT, ORANGE, PAPER, SIDE, TEXT, text_width, ticks, wrapped,
};
use crate::draw::numbers::numbers;
use crate::draw::scale_colour;
use crate::metrics::Metric;
use crate::report::tables::{Cell, Judgement, Line, Table};
use crate::report::{AxisValue, Record, label};
use crate::settings::columns::InactiveBy;

use super::differences::absent;

/// Largest cell; narrower ones than [`SPREADS`] have no spread.
const CELL: (f64, f64) = (74.0, 44.0);
const SPREADS: f64 = 52.0;
/// Most room of the values at the left.
const NAMES: (f64, f64) = (160.0, 90.0);
/// Width of the colour bar, and of its numbers.
const BAR: f64 = 16.0;
const NUMBERS: f64 = 50.0;
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
pub fn heatmap_figures(
    style: Style,
    table: &Table,
    records: &[Record],
    scene: &str,
    metric: &str,
) -> Result<Vec<Figure>> {
    let Some(index) = table.metrics.iter().position(|known| known == metric) else { return Ok(Vec::new()) };
    let maps = maps(table, records, scene).into_iter().filter(|map| map.columns.len() > 1 && map.rows.len() > 1);
    maps.filter_map(|map| map.figure(style, table, scene, index).transpose()).collect()
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
    fn figure(&self, style: Style, table: &Table, scene: &str, metric: usize) -> Result<Option<Figure>> {
        let means = self.cells.iter().filter_map(|(_, line)| line.cells[metric].mean);
        let Some(range) = range_of(&table.metrics[metric], means) else { return Ok(None) };
        let (mut drawing, shows) = (canvas(style.width), metric_label(&table.metrics[metric]));
        let [across, down] = [&self.columns, &self.rows].map(|values| Places::new(values));
        let [across_texts, down_texts] = [&across, &down].map(|places| names(places));
        let widest = down_texts.iter().map(|text| text_width(text, TEXT)).fold(40.0, f64::max);
        let room = widest.min(style.width.pick(NAMES.0, NAMES.1));
        let left = SIDE + room + 8.0;
        let cells = drawing.width - left - SIDE - 20.0 - BAR - 6.0 - NUMBERS;
        let cell = ((cells / self.columns.len() as f64).min(CELL.0).max(1.0), CELL.1);
        let right = left + cell.0 * self.columns.len() as f64;
        let heads = drawing.width - 2.0 * SIDE;
        let top = drawing.lines((SIDE, drawing.height + 4.0), heads, &format!("{shows}, {}", self.title), BLACK);
        let top = drawing.lines((SIDE, top), heads, &axis_name(self.down), GREY);
        let bottom = top + cell.1 * self.rows.len() as f64;
        let mut foot = bottom;
        for (index, text) in across_texts.iter().enumerate() {
            let x = left + cell.0 * (index as f64 + 0.5);
            for (line, part) in wrapped(text, cell.0 - 4.0, TEXT).iter().enumerate() {
                let y = bottom + 14.0 + LINE_HEIGHT * line as f64;
                drawing.text((x, y), part, TEXT, Anchor::Middle, BLACK);
                foot = foot.max(y);
            }
        }
        for line in wrapped(&axis_name(self.across), right - left, TEXT) {
            foot += LINE_HEIGHT + 1.0;
            drawing.text(((left + right) / 2.0, foot), &line, TEXT, Anchor::Middle, BLACK);
        }
        for (index, text) in down_texts.iter().enumerate() {
            drawing.name((left - 8.0, top + cell.1 * (index as f64 + 0.5)), room, text);
        }
        for ((column, row), line) in &self.cells {
            let place = (across.index(self.columns[*column]), down.index(self.rows[*row]));
            let at = (left + cell.0 * place.0 as f64, top + cell.1 * place.1 as f64);
            draw_cell(&mut drawing, at, cell, (line, &line.cells[metric]), range);
        }
        draw_bar(&mut drawing, (right + 20.0, top), bottom - top, range);
        drawing.height = foot + 14.0;
        let caption = caption(self.cells.iter().map(|(_, line)| *line));
        style.finish(drawing, &format!("{shows} on {scene}, {}", self.title), &caption)
    }
}

/// Returns what stands at each value.
fn names(places: &Places) -> Vec<String> {
    places.texts().into_iter().map(|lines| lines.join(" / ")).collect()
}

/// Returns `features: steps`.
fn axis_name(value: &AxisValue) -> String {
    if value.panel.is_empty() { value.axis.clone() } else { format!("{}: {}", value.panel, value.axis) }
}

fn share(value: f64, (low, high): (f64, f64)) -> f32 {
    ((value - low) / (high - low)) as f32
}

fn draw_cell(
    drawing: &mut Canvas,
    (x, y): (f64, f64),
    size: (f64, f64),
    (line, cell): (&Line, &Cell),
    range: (f64, f64),
) {
    let (width, height) = (size.0 - 2.0, size.1 - 2.0);
    let middle = (x + width / 2.0, y + height / 2.0);
    let Some(mean) = cell.mean.filter(|mean| mean.is_finite()) else {
        drawing.outline((x, y), (width, height), GREY, 1.0);
        drawing.text(middle, absent(line), TEXT, Anchor::Middle, GREY);
        return;
    };
    let share = share(mean, range);
    box_of(drawing, (x, y), (width, height), share);
    let digits = |value: f64| Metric::find(&cell.metric).map_or_else(|| value.to_string(), |metric| metric.text(value));
    // The map is dark below its middle.
    let ink = if share < 0.55 { PAPER } else { BLACK };
    let spread = cell.deviation.filter(|_| width > SPREADS).map(|deviation| format!("± {}", digits(deviation)));
    let up = if spread.is_some() { 8.0 } else { 0.0 };
    drawing.text((middle.0, middle.1 - up), &digits(mean), TEXT, Anchor::Middle, ink);
    drawing.text((middle.0, middle.1 + 9.0), &spread.unwrap_or_default(), TEXT, Anchor::Middle, ink);
    let frame = match cell.comparison.map(|comparison| Judgement::of(&cell.metric, &comparison)) {
        Some(Judgement::Better) => BLUE,
        Some(Judgement::Worse) => ORANGE,
        Some(Judgement::Higher | Judgement::Lower) => BLACK,
        Some(Judgement::NotShown) | None => return,
    };
    // On white, so that the frame is seen on every colour.
    drawing.outline((x + 1.5, y + 1.5), (width - 3.0, height - 3.0), PAPER, 5.0);
    drawing.outline((x + 1.5, y + 1.5), (width - 3.0, height - 3.0), frame, 3.0);
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
    for (value, text) in values.iter().zip(numbers(&values, step)) {
        let at = y + height * (1.0 - f64::from(share(*value, range)));
        drawing.text((x + BAR + 6.0, at), &text, TEXT, Anchor::Left, BLACK);
    }
}

fn caption<'a>(lines: impl Iterator<Item = &'a Line> + Clone) -> String {
    let mut text =
        "Means over seeds, with standard deviations. Cells in a frame differ from the baseline by Holm's p below 0.05, \
         corrected over the rows of the scene's table: blue is better, orange worse."
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
