//! The paper's figure: a metric against the varied setting, one panel a level. If several axes are varied together,
//! the first is the x axis, and each value of the others has its own line.

use super::places::Places;
use super::series::{Series, absent, places, series};
use super::{Figure, SPREAD_NOTE, Spread, Stroke, Style, canvas, legend, metric_label, range_of};
use crate::draw::canvas::{
    Anchor, BLACK, Canvas, GREY, GRID, LINE_HEIGHT, PAPER, Panel, SIDE, TEXT, text_width, wrapped,
};
use crate::draw::numbers::number;
use crate::metrics::Metric;
use crate::report::{Record, Status, distinct};

/// Panels side by side, and their height.
const ACROSS: usize = 3;
const HEIGHT: f64 = 170.0;
/// Room at the left for the numbers.
const LEFT: f64 = 62.0;
const GAP: f64 = 22.0;
/// Room that the first number of a scale takes to its left.
const HALF_NUMBER: f64 = 26.0;
/// Height of the label of the best value, and of the gap to its dot.
const LABEL: f64 = 24.0;
const BASELINE: Stroke = Stroke { colour: GREY, dashed: true, width: 1.5 };
/// Height of the numbers' first line below a panel.
const FIRST: f64 = 14.0;

/// Draws the panels of a scene's points with axes, by axis (down) and level (across). Returns `None` if there are no
/// such points.
pub fn axes_figure(style: Style, records: &[Record], scene: &str, metric: &str) -> Option<Figure> {
    let records: Vec<&Record> = records.iter().filter(|record| record.scene == scene).collect();
    let all = series(&records, metric);
    let baseline = baseline(style, &records, metric);
    let drawn = range_of(metric, drawn(&all, baseline.as_ref()));
    let range = drawn.filter(|_| !all.is_empty())?;
    let range = with_label(range, metric);
    let strokes = strokes(style, &all);
    let figure = Axes { style, all: &all, strokes: &strokes, baseline: baseline.as_ref(), metric, range };
    let mut drawing = canvas();
    for axis in distinct(all.iter().map(|series| series.axis)) {
        figure.draw_axis(&mut drawing, axis);
    }
    let baseline = baseline.as_ref().map(|(name, _)| (*name, BASELINE));
    legend::draw(&mut drawing, &strokes.iter().copied().chain(baseline).collect::<Vec<_>>());
    Some(style.finish(drawing, &format!("{} on {scene}", metric_label(metric)), &figure.caption(&records)))
}

/// Returns the range with room for the best value's label, which stands beyond its dot.
fn with_label((low, high): (f64, f64), metric: &str) -> (f64, f64) {
    let room = (high - low) * LABEL / (HEIGHT - LABEL);
    match Metric::find(metric).and_then(|metric| metric.direction.sign()) {
        Some(sign) if sign > 0.0 => (low, high + room),
        Some(_) => (low - room, high),
        None => (low, high),
    }
}

/// What the panels share.
struct Axes<'f, 'a> {
    style: Style<'f>,
    all: &'f [Series<'a>],
    strokes: &'f [(&'f str, Stroke)],
    baseline: Option<&'f (&'f str, Vec<f64>)>,
    metric: &'f str,
    range: (f64, f64),
}

/// One panel: its lines, and what stands below it.
struct Level<'f, 'a> {
    name: &'a str,
    lines: Vec<(&'f Series<'a>, Stroke)>,
    places: Places<'a>,
    ticks: Vec<Vec<String>>,
}

impl<'f, 'a> Axes<'f, 'a> {
    /// Draws the panels of an axis below everything.
    fn draw_axis(&self, drawing: &mut Canvas, axis: &str) {
        let columns = columns(self.all);
        // A single panel is as wide as the figure.
        let across = ACROSS.min(columns.len().max(1));
        let names = distinct(self.all.iter().filter(|s| s.axis == axis).map(|s| s.panel));
        let parts = |name: &str| self.style.spec.parts_of(axis, name);
        let (first, gap) = self.margins();
        let width = (drawing.width - first - SIDE + gap) / across as f64 - gap;
        let place = |index: usize, name: &str| match columns.len() <= across {
            true => columns.iter().position(|column| *column == name).unwrap_or(0),
            false => index % across,
        };
        for line in names.chunks(across) {
            let levels: Vec<Level> = line.iter().map(|name| self.level(axis, name, width)).collect();
            let most = |count: fn(&Level) -> usize| levels.iter().map(count).max().unwrap_or(0) as f64;
            let names: Vec<Vec<String>> = line.iter().map(|name| wrapped(name, width, TEXT)).collect();
            let named = match line.iter().all(|name| name.is_empty()) {
                true => 0.0,
                false => LINE_HEIGHT * names.iter().map(Vec::len).max().unwrap_or(1) as f64,
            };
            let top = drawing.height + LINE_HEIGHT + named + 2.0;
            let leftmost = levels.iter().enumerate().map(|(index, level)| place(index, level.name)).min();
            for (index, level) in levels.iter().enumerate() {
                let column = place(index, level.name);
                let left = first + column as f64 * (width + gap);
                let panel = Panel { left, top, width, height: HEIGHT, range: self.range };
                panel.frame(drawing, Some(column) == leftmost);
                if Some(column) == leftmost {
                    let at = (SIDE, top - named - 12.0);
                    drawing.text(at, metric_label(self.metric), TEXT, Anchor::Left, GREY);
                }
                let above = top - 10.0 - LINE_HEIGHT * (names[index].len() - 1) as f64;
                drawing.lines((left, above), width, level.name, BLACK);
                self.draw_level(drawing, &panel, level, axis, parts(level.name));
            }
            let ticks = most(|level| level.ticks.iter().map(Vec::len).max().unwrap_or(1));
            let named = wrapped(axis, width, TEXT).len() as f64;
            drawing.height = top + HEIGHT + FIRST + LINE_HEIGHT * (ticks + named) + 4.0;
        }
    }

    /// Returns the room at the left of the first panel, and between two: the names of settings that vary together stand
    /// there.
    fn margins(&self) -> (f64, f64) {
        let names = self.style.spec.parts.iter().flat_map(|parts| &parts.names);
        match names.map(|name| text_width(name, TEXT)).fold(0.0, f64::max) {
            0.0 => (LEFT, GAP),
            widest => (LEFT.max(SIDE + widest + HALF_NUMBER), GAP.max(widest + HALF_NUMBER)),
        }
    }

    fn level(&self, axis: &str, name: &'a str, width: f64) -> Level<'f, 'a> {
        let lines: Vec<&Series> = self.all.iter().filter(|s| s.axis == axis && s.panel == name).collect();
        let places = places(self.all, axis, name);
        let room = width / places.values.len() as f64 - 6.0;
        let mut ticks = places.texts();
        if places.is_words() {
            ticks =
                ticks.iter().map(|lines| lines.iter().flat_map(|line| wrapped(line, room, TEXT)).collect()).collect();
        }
        let stroke = |series: &Series| self.strokes.iter().find(|(label, _)| *label == series.label).map(|own| own.1);
        Level {
            name,
            lines: lines.into_iter().filter_map(|series| Some((series, stroke(series)?))).collect(),
            places,
            ticks,
        }
    }

    fn draw_level(&self, drawing: &mut Canvas, panel: &Panel, level: &Level, axis: &str, parts: &[String]) {
        self.draw_baseline(drawing, panel);
        let x = |index: usize| panel.left + panel.width * level.places.share(index);
        draw_ticks(drawing, panel, level, &x);
        let halves = level.ticks.first().into_iter().flatten().map(|text| text_width(text, TEXT) / 2.0);
        let right = (x(0) - halves.fold(0.0, f64::max) - 6.0).min(panel.left - 4.0);
        for (line, part) in parts.iter().enumerate() {
            let at = (right, panel.bottom() + FIRST + LINE_HEIGHT * line as f64);
            drawing.text(at, part, TEXT, Anchor::Right, GREY);
        }
        let lines = level.ticks.iter().map(Vec::len).max().unwrap_or(1) as f64;
        let mut y = panel.bottom() + FIRST + LINE_HEIGHT * lines;
        for line in wrapped(axis, panel.width, TEXT) {
            drawing.text((panel.left + panel.width / 2.0, y), &line, TEXT, Anchor::Middle, BLACK);
            y += LINE_HEIGHT;
        }
        for (series, stroke) in &level.lines {
            draw_series(drawing, panel, series, *stroke, &level.places);
        }
        if let Some((series, _)) = level.lines.first() {
            self.draw_best(drawing, panel, series, &x);
        }
    }

    fn draw_baseline(&self, drawing: &mut Canvas, panel: &Panel) {
        let Some(spread) = self.baseline.and_then(|(_, seeds)| Spread::new(seeds)) else { return };
        if let Some((low, high)) = spread.band {
            let (left, right) = (panel.left, panel.right());
            let (low, high) = (panel.y(low), panel.y(high));
            drawing.area(vec![(left, low), (right, low), (right, high), (left, high)], GREY, 0.15);
        }
        let y = panel.y(spread.mean);
        BASELINE.draw(drawing, &[(panel.left, y), (panel.right(), y)]);
    }

    /// Marks the best mean with its value.
    fn draw_best(&self, drawing: &mut Canvas, panel: &Panel, series: &Series, x: &impl Fn(usize) -> f64) {
        let Some((index, best)) = best(series, self.metric) else { return };
        let (value, _) = series.points[index];
        let (x, y) = (x(places(self.all, series.axis, series.panel).index(value)), panel.y(best.mean));
        drawing.dot((x, y), 5.0, GREY, 1.0);
        let label = number(best.mean, (panel.range.1 - panel.range.0) / 50.0);
        let half = text_width(&label, TEXT) / 2.0;
        let x = x.clamp(panel.left + half + 2.0, panel.right() - half - 2.0);
        let up = Metric::find(self.metric).and_then(|metric| metric.direction.sign()).unwrap_or(1.0);
        let y = y - 14.0 * up;
        // On a white plate, so that no line crosses it.
        let (left, right, top, bottom) = (x - half - 2.0, x + half + 2.0, y - 7.0, y + 7.0);
        drawing.area(vec![(left, top), (right, top), (right, bottom), (left, bottom)], PAPER, 0.75);
        drawing.text((x, y), &label, TEXT, Anchor::Middle, GREY);
    }

    fn caption(&self, records: &[&Record]) -> String {
        let mut text = SPREAD_NOTE.to_string();
        if self.all.iter().any(|series| best(series, self.metric).is_some()) {
            text += " The best mean of each panel's first line is marked with its value; no test says that it differs from \
                     the others.";
        }
        let places = || self.all.iter().map(|s| places(self.all, s.axis, s.panel));
        if places().any(|places| places.has_zero_apart()) {
            text += " On logarithmic axes 0 stands apart.";
        }
        let absent = absent(self.all, records);
        if !absent.is_empty() {
            text += &format!(" Without a number, {}.", absent.join("; "));
        }
        text
    }
}

/// Draws the values below a panel, and their grid lines. Numbers that would touch the one before are not written.
fn draw_ticks(drawing: &mut Canvas, panel: &Panel, level: &Level, x: &impl Fn(usize) -> f64) {
    let mut taken = f64::NEG_INFINITY;
    for (index, lines) in level.ticks.iter().enumerate() {
        drawing.line(&[(x(index), panel.top), (x(index), panel.bottom())], GRID, 1.0);
        let half = lines.iter().map(|line| text_width(line, TEXT)).fold(0.0, f64::max) / 2.0;
        if x(index) - half < taken + 3.0 && !level.places.is_words() {
            continue;
        }
        taken = x(index) + half;
        for (down, line) in lines.iter().enumerate() {
            let at = (x(index), panel.bottom() + FIRST + LINE_HEIGHT * down as f64);
            drawing.text(at, line, TEXT, Anchor::Middle, BLACK);
        }
    }
    if level.places.has_zero_apart() && level.ticks.len() > 1 {
        // The axis is interrupted between 0 and the first positive value.
        let middle = (x(0) + x(1)) / 2.0;
        drawing.line(&[(middle - 4.0, panel.bottom()), (middle + 4.0, panel.bottom())], PAPER, 4.0);
        for at in [middle - 4.0, middle + 4.0] {
            drawing.line(&[(at - 2.0, panel.bottom() + 4.0), (at + 2.0, panel.bottom() - 4.0)], BLACK, 1.0);
        }
    }
}

fn draw_series(drawing: &mut Canvas, panel: &Panel, series: &Series, stroke: Stroke, places: &Places) {
    let at = |index: usize| panel.left + panel.width * places.share(places.index(series.points[index].0));
    let means = series.means();
    // A value without points is a gap; its neighbours are not joined.
    let joined = |a: usize, b: usize| {
        let (a, b) = (places.index(series.points[a].0), places.index(series.points[b].0));
        b == a + 1 && places.is_joined(a)
    };
    for run in means.chunk_by(|(a, _), (b, _)| joined(*a, *b)) {
        let banded: Vec<(f64, (f64, f64))> = run.iter().filter_map(|(i, s)| Some((at(*i), s.band?))).collect();
        match banded.as_slice() {
            [(x, (low, high))] => drawing.line(&[(*x, panel.y(*low)), (*x, panel.y(*high))], stroke.colour, 1.2),
            _ => {
                let upper = banded.iter().map(|(x, (_, high))| (*x, panel.y(*high)));
                let lower = banded.iter().rev().map(|(x, (low, _))| (*x, panel.y(*low)));
                drawing.area(upper.chain(lower).collect(), stroke.colour, 0.15);
            }
        }
        let line: Vec<(f64, f64)> = run.iter().map(|(i, spread)| (at(*i), panel.y(spread.mean))).collect();
        Stroke { width: 2.0, ..stroke }.draw(drawing, &line);
        line.iter().for_each(|at| drawing.dot(*at, 3.5, stroke.colour, 1.0));
    }
    for (index, (_, seeds)) in series.points.iter().enumerate() {
        seeds.iter().for_each(|(_, number)| drawing.dot((at(index), panel.y(*number)), 2.0, stroke.colour, 0.45));
    }
}

/// Returns the line of each label: the row's, or, where one row has several, one a label.
fn strokes<'f>(style: Style, all: &'f [Series]) -> Vec<(&'f str, Stroke)> {
    let lines = distinct(all.iter().map(|series| (series.label.as_str(), series.row)));
    let rows = distinct(lines.iter().map(|(_, row)| *row));
    let of = |(index, (label, row)): (usize, &(&'f str, &str))| match rows.len() == lines.len() {
        true => (*label, style.stroke(row)),
        false => (*label, Stroke::of(index + 1)),
    };
    lines.iter().enumerate().map(of).collect()
}

/// Returns the panels with their own column, from left to right: those that are next to another in some row. A panel
/// that is always alone is drawn in the first column.
fn columns<'a>(series: &[Series<'a>]) -> Vec<&'a str> {
    let panels = |axis: &str| distinct(series.iter().filter(|s| s.axis == axis).map(|s| s.panel)).len();
    let mut names = distinct(series.iter().map(|s| s.panel));
    names.retain(|name| series.iter().any(|s| s.panel == *name && panels(s.axis) > 1));
    names
}

/// Returns all numbers that panels show: those of seeds, and the ends of bands, which may exceed them.
fn drawn<'a>(series: &'a [Series<'a>], baseline: Option<&'a (&str, Vec<f64>)>) -> impl Iterator<Item = f64> {
    let places = series.iter().flat_map(|series| &series.points);
    let places = places.map(|(_, seeds)| seeds.iter().map(|(_, number)| *number).collect::<Vec<f64>>());
    places.chain(baseline.map(|(_, seeds)| seeds.clone())).flat_map(|seeds| {
        let band = Spread::new(&seeds).and_then(|spread| spread.band);
        seeds.into_iter().chain(band.into_iter().flat_map(|(low, high)| [low, high]))
    })
}

/// Returns the first baseline row's name and seeds.
fn baseline<'a>(style: Style<'a>, records: &[&Record], metric: &str) -> Option<(&'a str, Vec<f64>)> {
    let row = style.spec.rows.iter().find(|row| row.baseline.is_none() && !row.quoted)?;
    let done = records.iter().filter(|r| r.row == row.name && r.axes.is_empty() && r.status == Status::Done);
    let seeds: Vec<f64> = done.filter_map(|record| record.metric(metric)).filter(|value| value.is_finite()).collect();
    (!seeds.is_empty()).then_some((row.name.as_str(), seeds))
}

/// Returns the best mean with its index in the series, or `None` if the metric has no better direction.
fn best(series: &Series, metric: &str) -> Option<(usize, Spread)> {
    let sign = Metric::find(metric)?.direction.sign()?;
    series.means().into_iter().max_by(|(_, a), (_, b)| (sign * a.mean).total_cmp(&(sign * b.mean)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_label_of_the_best_value_has_room_beyond_it() {
        assert_eq!(with_label((0.0, 146.0), "psnr"), (0.0, 170.0));
        assert_eq!(with_label((0.0, 146.0), "lpips_vgg"), (-24.0, 146.0));
        assert_eq!(with_label((0.0, 146.0), "occupied"), (0.0, 146.0));
    }

    #[test]
    fn panels_have_room_for_bands() {
        let series = [Series {
            axis: "layer",
            panel: "",
            row: "r",
            label: "r".into(),
            points: vec![("1", vec![(0, 13.5), (1, 19.5), (2, 21.0)])],
        }];
        // The mean is 18, the standard deviation the root of 31.5 / 2.
        let baseline = ("NeRF", vec![12.0, 20.0]);
        let (low, high) = range_of("psnr", drawn(&series, Some(&baseline))).unwrap();
        assert!(low <= 12.0 && high >= 18.0 + 15.75_f64.sqrt(), "{low} to {high}");
    }

    #[test]
    fn a_panel_that_is_alone_in_its_rows_takes_no_column() {
        let at = |axis, panel| Series { axis, panel, row: "r", label: "r".into(), points: Vec::new() };
        let levels =
            [at("steps", "input"), at("steps", "features"), at("layer", "features"), at("lambda", "all levels")];
        assert_eq!(columns(&levels), ["input", "features"]);
        assert!(columns(&[at("layer", "")]).is_empty());
    }

    #[test]
    fn the_best_mean_is_that_of_the_metric_s_direction() {
        let points = vec![("1", vec![(0, 20.0), (1, 22.0)]), ("3", vec![(0, 20.5), (1, 22.5)])];
        let series = Series { axis: "steps", panel: "", row: "r", label: "r".into(), points };
        let best_index = |metric: &str| best(&series, metric).map(|(index, _)| index);
        assert_eq!((best_index("psnr"), best_index("lpips_alex")), (Some(1), Some(0)));
        // For roughness of a reference, occupied space or variation of density, more is neither better nor worse.
        assert_eq!(["normal_roughness_truth", "occupied", "tv"].map(best_index), [None; 3]);
    }
}
