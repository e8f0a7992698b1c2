//! The paper's figure: a metric against the varied setting, one panel a level. If several axes are varied together,
//! the first is the x axis, and each value of the others has its own line.

use super::pairs::Tests;
use super::series::{Series, tick};
use super::{Figure, SPREAD_NOTE, Spread, metric_label};
use crate::base::Result;
use crate::draw::canvas::{
    Anchor, BLACK, Canvas, Colour, GREY, GRID, LINE_HEIGHT, PALETTE, PAPER, Panel, RED, TEXT, number, range, text_width,
};
use crate::metrics::{Direction, Metric};
use crate::report::{AxisValue, Record, Status, TableSpec, distinct, label};

const PANEL: (f64, f64) = (250.0, 190.0);
const GAP: (f64, f64) = (30.0, 92.0);
/// Lines of words that fit into the gap below a panel with one line of values.
const LINES_IN_GAP: usize = 2;
const MARGIN: (f64, f64) = (76.0, 66.0);

/// Draws the panels of a scene's points with axes, by axis (down) and level (across). Returns `None` if there are no
/// such points.
pub fn axes_figure(spec: &TableSpec, records: &[Record], scene: &str, metric: &str) -> Result<Option<Figure>> {
    let records: Vec<&Record> = records.iter().filter(|record| record.scene == scene).collect();
    let series = series(&records, metric);
    let baseline = baseline(spec, &records, metric);
    let Some(range) = range(drawn(&series, baseline.as_ref())) else {
        return Ok(None);
    };
    if series.is_empty() {
        return Ok(None);
    }
    let tests = Tests::new(&series);
    let axes = distinct(series.iter().map(|series| series.axis));
    let columns = columns(&series);
    let width = PANEL.0.max(width_of_words(&series, &tests, metric)) + GAP.0;
    let heights: Vec<f64> = axes.iter().map(|axis| height(&series, axis)).collect();
    let title = format!("{}: {} on {scene}", spec.title, metric_label(metric));
    let whole = ((MARGIN.0 + columns.len().max(1) as f64 * width).max(560.0), MARGIN.1 + heights.iter().sum::<f64>());
    let mut drawing = Canvas::titled(whole.0, whole.1, &title);
    let place = |name: &str| columns.iter().position(|column| *column == name).unwrap_or(0);
    for (down, axis) in axes.iter().enumerate() {
        let panels = panels(&series, axis);
        let leftmost = panels.iter().map(|name| place(name)).min();
        for name in panels {
            let lines: Vec<&Series> = on(&series, axis, name).collect();
            let panel = Panel {
                left: MARGIN.0 + place(name) as f64 * width,
                top: MARGIN.1 + heights[..down].iter().sum::<f64>(),
                width: PANEL.0,
                height: PANEL.1,
                range,
            };
            panel.frame(&mut drawing, Some(place(name)) == leftmost);
            let title = if name.is_empty() { axis.to_string() } else { format!("{name}: {axis}") };
            drawing.text((panel.left, panel.top - 14.0), &title, TEXT, Anchor::Left, BLACK);
            draw_baseline(&mut drawing, &panel, baseline.as_ref());
            draw_values(&mut drawing, &panel, &lines, &tests, metric);
        }
    }
    drawing.caption(&caption(&series, baseline.as_ref().map(|(name, _)| *name), metric));
    drawing.finish().map(Some)
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

/// Groups the points of a scene with axis values by first axis, row and values of further axes.
fn series<'a>(records: &[&'a Record], metric: &str) -> Vec<Series<'a>> {
    let mut all: Vec<Series> = Vec::new();
    for record in records {
        let Some((AxisValue { axis, panel, value }, further)) = record.axes.split_first() else { continue };
        let label = label(&record.row, further);
        let same = |s: &Series| (s.axis, s.panel, &s.label) == (axis.as_str(), panel.as_str(), &label);
        let index = match all.iter().position(same) {
            Some(index) => index,
            None => {
                all.push(Series { axis, panel, label, points: Vec::new() });
                all.len() - 1
            }
        };
        let points = &mut all[index].points;
        if points.iter().all(|(known, _)| known != value) {
            points.push((value, Vec::new()));
        }
        let seeds = points.iter_mut().find(|(known, _)| known == value).expect("just put there");
        let measured = Some(record).filter(|r| r.status == Status::Done).and_then(|r| r.metric(metric));
        seeds
            .1
            .extend(measured.filter(|value| value.is_finite()).map(|value| (record.seed.unwrap_or_default(), value)));
    }
    all
}

/// Returns the words below a panel, one line for each series; several series have their names.
fn words(lines: &[&Series], tests: &Tests, metric: &str) -> Vec<String> {
    let verdict = |series: &&Series| match (lines.len(), tests.verdict(series, metric)) {
        (1, verdict) => verdict,
        (_, verdict) => format!("{}: {verdict}", series.label),
    };
    lines.iter().map(verdict).collect()
}

/// Returns the width of the words below the widest panel.
fn width_of_words(series: &[Series], tests: &Tests, metric: &str) -> f64 {
    let panels = distinct(series.iter().map(|s| (s.axis, s.panel)));
    let lines = panels.into_iter().map(|(axis, panel)| on(series, axis, panel).collect::<Vec<_>>());
    let words = lines.flat_map(|lines| words(&lines, tests, metric));
    words.map(|words| text_width(&words, TEXT)).fold(0.0, f64::max)
}

/// Returns the panels of an axis.
fn panels<'a>(series: &[Series<'a>], axis: &str) -> Vec<&'a str> {
    distinct(series.iter().filter(|s| s.axis == axis).map(|s| s.panel))
}

/// Returns the panels with their own column, from left to right: those that are next to another in some row. A panel
/// that is always alone is drawn in the first column.
fn columns<'a>(series: &[Series<'a>]) -> Vec<&'a str> {
    let mut names = distinct(series.iter().map(|s| s.panel));
    names.retain(|name| series.iter().any(|s| s.panel == *name && panels(series, s.axis).len() > 1));
    names
}

/// Returns the most lines that a value takes below its axis.
fn lines_of_values<'s, 'a: 's>(series: impl IntoIterator<Item = &'s Series<'a>>) -> usize {
    let values = series.into_iter().flat_map(|s| &s.points);
    values.map(|(value, _)| tick(value).len()).max().unwrap_or(1)
}

/// Returns the height of a row of panels, with the words below.
fn height(series: &[Series], axis: &str) -> f64 {
    let words = panels(series, axis).into_iter().map(|panel| {
        let lines = on(series, axis, panel).count();
        lines_of_values(on(series, axis, panel)) - 1 + lines
    });
    PANEL.1 + GAP.1 + words.max().unwrap_or(0).saturating_sub(LINES_IN_GAP) as f64 * LINE_HEIGHT
}

/// Returns the lines of one panel.
fn on<'s, 'a>(series: &'s [Series<'a>], axis: &'s str, panel: &'s str) -> impl Iterator<Item = &'s Series<'a>> {
    series.iter().filter(move |s| s.axis == axis && s.panel == panel)
}

/// Returns the first baseline row's name and seeds.
fn baseline<'a>(spec: &'a TableSpec, records: &[&Record], metric: &str) -> Option<(&'a str, Vec<f64>)> {
    let row = spec.rows.iter().find(|row| row.baseline.is_none() && !row.quoted)?;
    let done = records.iter().filter(|r| r.row == row.name && r.axes.is_empty() && r.status == Status::Done);
    let seeds: Vec<f64> = done.filter_map(|record| record.metric(metric)).filter(|value| value.is_finite()).collect();
    (!seeds.is_empty()).then_some((row.name.as_str(), seeds))
}

fn draw_baseline(drawing: &mut Canvas, panel: &Panel, baseline: Option<&(&str, Vec<f64>)>) {
    let Some((_, seeds)) = baseline else { return };
    let Some(spread) = Spread::new(seeds) else { return };
    if let Some((low, high)) = spread.band {
        let (left, right) = (panel.left, panel.right());
        let (low, high) = (panel.y(low), panel.y(high));
        drawing.area(vec![(left, low), (right, low), (right, high), (left, high)], GREY, 0.15);
    }
    let y = panel.y(spread.mean);
    drawing.dashed(&[(panel.left, y), (panel.right(), y)], GREY, 1.5);
}

fn draw_values(drawing: &mut Canvas, panel: &Panel, lines: &[&Series], tests: &Tests, metric: &str) {
    let names = distinct(lines.iter().flat_map(|series| series.points.iter().map(|(value, _)| *value)));
    let x = |name: &str| {
        let index = names.iter().position(|known| *known == name).expect("from the same list");
        panel.left + panel.width * (index as f64 + 0.5) / names.len() as f64
    };
    for name in &names {
        drawing.line(&[(x(name), panel.top), (x(name), panel.bottom())], GRID, 1.0);
        for (down, words) in tick(name).iter().enumerate() {
            let at = (x(name), panel.bottom() + 12.0 + down as f64 * LINE_HEIGHT);
            drawing.text(at, words, TEXT, Anchor::Middle, BLACK);
        }
    }
    let below = lines_of_values(lines.iter().copied()) - 1;
    // After the last colour of the palette, colours repeat.
    for (series, colour) in lines.iter().zip(PALETTE.into_iter().cycle()) {
        draw_series(drawing, panel, series, colour, &x);
    }
    for (index, text) in words(lines, tests, metric).iter().enumerate() {
        let colour = if lines.len() > 1 { PALETTE[index % PALETTE.len()] } else { GREY };
        drawing.text(
            (panel.left, panel.bottom() + 30.0 + (below + index) as f64 * LINE_HEIGHT),
            text,
            TEXT,
            Anchor::Left,
            colour,
        );
    }
    let Some((index, best)) = lines.first().and_then(|series| best(series, metric)) else { return };
    let (value, _) = lines[0].points[index];
    let (x, y) = (x(value), panel.y(best.mean));
    // Red marks significant differences.
    let colour = if tests.tells_apart(lines[0], value) { RED } else { GREY };
    drawing.dot((x, y), 5.0, colour, 1.0);
    let label = number(best.mean, (panel.range.1 - panel.range.0) / 50.0);
    let half = text_width(&label, TEXT) / 2.0;
    let x = x.clamp(panel.left + half + 2.0, panel.right() - half - 2.0);
    let y = (y - 14.0).max(panel.top + 8.0);
    // On a white plate, so that no line crosses it.
    let (left, right, top, bottom) = (x - half - 2.0, x + half + 2.0, y - 7.0, y + 7.0);
    drawing.area(vec![(left, top), (right, top), (right, bottom), (left, bottom)], PAPER, 0.75);
    drawing.text((x, y), &label, TEXT, Anchor::Middle, colour);
}

fn draw_series(drawing: &mut Canvas, panel: &Panel, series: &Series, colour: Colour, x: &impl Fn(&str) -> f64) {
    let means = series.means();
    // A value without points is a gap; its neighbours are not joined.
    for run in means.chunk_by(|(a, _), (b, _)| b - a == 1) {
        let at = |index: usize| x(series.points[index].0);
        let banded: Vec<(f64, (f64, f64))> = run.iter().filter_map(|(i, s)| Some((at(*i), s.band?))).collect();
        if banded.len() > 1 {
            let upper = banded.iter().map(|(x, (_, high))| (*x, panel.y(*high)));
            let lower = banded.iter().rev().map(|(x, (low, _))| (*x, panel.y(*low)));
            drawing.area(upper.chain(lower).collect(), colour, 0.18);
        }
        let line: Vec<(f64, f64)> = run.iter().map(|(i, spread)| (at(*i), panel.y(spread.mean))).collect();
        drawing.line(&line, colour, 2.0);
        line.iter().for_each(|at| drawing.dot(*at, 3.5, colour, 1.0));
    }
    for (value, seeds) in &series.points {
        seeds.iter().for_each(|(_, number)| drawing.dot((x(value), panel.y(*number)), 2.0, colour, 0.45));
    }
}

/// Returns the best mean with its index on the axis, or `None` if the metric has no better direction.
fn best(series: &Series, metric: &str) -> Option<(usize, Spread)> {
    let sign = match Metric::find(metric)?.direction {
        Direction::Up => 1.0,
        Direction::Down => -1.0,
        Direction::Neither => return None,
    };
    series.means().into_iter().max_by(|(_, a), (_, b)| (sign * a.mean).total_cmp(&(sign * b.mean)))
}

fn caption(series: &[Series], baseline: Option<&str>, metric: &str) -> String {
    let missing = series.iter().flat_map(|s| {
        let empty = s.points.iter().filter(|(_, seeds)| seeds.is_empty());
        empty.map(|(value, _)| format!("{} {} = {} ({})", s.panel, s.axis, tick(value).join(" / "), s.label))
    });
    let missing: Vec<String> = missing.collect();
    let mut text = SPREAD_NOTE.to_string();
    if series.iter().any(|series| best(series, metric).is_some()) {
        text += " The best mean of each panel is marked with its value, in red where it differs from another one.";
    }
    if let Some(baseline) = baseline {
        text += &format!(" Dashed: {baseline}.");
    }
    text += " \"No pair passes\": of no two values of the panel is a difference shown (paired t tests over seeds, Holm's p \
             below 0.05 over all pairs of the figure); in brackets the least one that would have been.";
    if lines_of_values(series) > 1 {
        text += " Values varied together stand below each other, in the order of the sweep's keys.";
    }
    if !missing.is_empty() {
        text += &format!(" Without data: {}.", missing.join("; "));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panels_have_room_for_bands() {
        let series = [Series {
            axis: "layer",
            panel: "",
            label: "r".into(),
            points: vec![("1", vec![(0, 13.5), (1, 19.5), (2, 21.0)])],
        }];
        // The mean is 18, the standard deviation the root of 31.5 / 2.
        let baseline = ("NeRF", vec![12.0, 20.0]);
        let (low, high) = range(drawn(&series, Some(&baseline))).unwrap();
        assert!(low <= 12.0 && high >= 18.0 + 15.75_f64.sqrt(), "{low} to {high}");
    }

    #[test]
    fn values_below_an_axis_are_short() {
        assert_eq!(tick("0.01568627450980392 / 0.18823529411764706"), ["0.0157", "0.188"]);
        assert_eq!(tick("0.0625 / 1.0"), ["0.0625", "1.0"]);
        assert_eq!((tick("0.00003"), tick("0.000125")), (vec!["3e-5".into()], vec!["1.25e-4".into()]));
        assert_eq!((tick("sampling"), tick("1000")), (vec!["sampling".into()], vec!["1000".into()]));
    }

    #[test]
    fn rows_of_panels_have_room_for_what_stands_below_them() {
        let line = |label: &str, value: &'static str| Series {
            axis: "epsilon",
            panel: "",
            label: label.into(),
            points: vec![(value, vec![(0, 20.0)])],
        };
        let rows = |lines: usize, value: &'static str| -> f64 {
            height(&(0..lines).map(|i| line(&i.to_string(), value)).collect::<Vec<_>>(), "epsilon")
        };
        assert_eq!(rows(LINES_IN_GAP, "1"), rows(1, "1"));
        assert_eq!(rows(4, "1") - rows(1, "1"), 2.0 * LINE_HEIGHT);
        assert_eq!(rows(1, "1 / 2 / 3") - rows(1, "1"), LINE_HEIGHT);
    }

    #[test]
    fn a_panel_that_is_alone_in_its_rows_takes_no_column() {
        let at = |axis, panel| Series { axis, panel, label: "r".into(), points: Vec::new() };
        let levels =
            [at("steps", "input"), at("steps", "features"), at("layer", "features"), at("lambda", "all levels")];
        assert_eq!(columns(&levels), ["input", "features"]);
        assert!(columns(&[at("layer", "")]).is_empty());
    }

    #[test]
    fn the_words_follow_the_paired_differences() {
        let verdict = |series: &Series, metric: &str| Tests::new(std::slice::from_ref(series)).verdict(series, metric);
        let series = |points: Vec<(&'static str, Vec<f64>)>| Series {
            axis: "steps",
            panel: "",
            label: "r".into(),
            points: points.into_iter().map(|(value, seeds)| (value, (0..).zip(seeds).collect())).collect(),
        };
        // The seeds are further apart than the values, and agree on the difference.
        let paired = series(vec![("1", vec![20.0, 22.0, 24.0]), ("3", vec![20.5, 22.51, 24.49])]);
        assert_eq!(verdict(&paired, "psnr"), "3 seeds: 1 and 3 differ, p < 0.001");
        let best_index = |metric: &str| best(&paired, metric).map(|(index, _)| index);
        assert_eq!((best_index("psnr"), best_index("lpips_alex")), (Some(1), Some(0)));
        // For roughness of a reference, or occupied space, more is neither better nor worse.
        assert_eq!((best_index("normal_roughness_truth"), best_index("occupied")), (None, None));
        let same = series(vec![("1", vec![20.0, 20.5, 21.0]), ("3", vec![20.3, 20.4, 21.1])]);
        // Pooled over one pair: t(0.975, 2) times the standard error of -0.3, 0.1, -0.1.
        assert_eq!(verdict(&same, "psnr"), "3 seeds: no pair passes (0.50 dB would)");
        // Two seeds that differ by nearly the same: p 0.02 for one pair, and there are three.
        let few = series(vec![("1", vec![20.0, 20.0]), ("3", vec![21.0, 21.06]), ("5", vec![20.5, 20.2])]);
        assert!(verdict(&few, "psnr").starts_with("2 seeds: no pair passes"));
        // A value that is the same training as another makes no further pair.
        let twice =
            series(vec![("1", vec![20.0, 20.0, 20.0]), ("3", vec![20.5, 20.52, 20.6]), ("5", vec![20.5, 20.52, 20.6])]);
        assert_eq!(super::super::pairs::pairs(&twice).iter().map(|pair| pair.values).collect::<Vec<_>>(), [("1", "3")]);
        assert_eq!(verdict(&series(vec![("1", vec![20.0]), ("3", vec![21.0])]), "psnr"), "one seed: no spread known");
        assert_eq!(verdict(&series(vec![("1", vec![])]), "psnr"), "no data");
    }
}
