//! Training curves: values of the baseline and the best rows, of the steps' rays and of whole views.

use super::ends::{self, End};
use super::{Figure, Spread, Stroke, Style, canvas};
use crate::draw::canvas::{Anchor, BLACK, Canvas, LINE_HEIGHT, Panel, SIDE, TEXT, tick_texts, wrapped};
use crate::metrics::PSNR;

/// Log points in a curve's moving average.
const WINDOW: usize = 5;
/// Most rows that are all drawn. Of more, the baseline and the best [`BEST`] are.
const MOST: usize = 6;
const BEST: usize = 4;
/// Room for numbers at the left, and for names at the right.
const LEFT: f64 = 62.0;
const NAMES: f64 = 190.0;

/// Log points of each seed: step and value.
pub type Seeds = Vec<Vec<(f64, f64)>>;

/// One row's training, seed by seed: step and value.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curve {
    /// The row.
    pub label: String,
    /// Log points of each seed.
    pub seeds: Seeds,
    /// The same for held-out views, at evaluations; empty if there were none during training.
    pub held_out: Seeds,
    /// The same for training views.
    pub seen: Seeds,
}

/// Steps, with the spread of the values of the seeds that have them.
type Line = Vec<(f64, Spread)>;

fn spreads(seeds: &[Vec<(f64, f64)>]) -> Line {
    let mut steps: Vec<f64> = seeds.iter().flatten().map(|(step, _)| *step).collect();
    steps.sort_by(f64::total_cmp);
    steps.dedup();
    // A seed may lack a log point, of a value that is not finite.
    let value = |seed: &Vec<(f64, f64)>, at: f64| seed.iter().find(|(step, _)| *step == at).map(|(_, value)| *value);
    let values = |at: f64| seeds.iter().filter_map(|seed| value(seed, at)).collect::<Vec<f64>>();
    steps.into_iter().filter_map(|step| Some((step, Spread::new(&values(step))?))).collect()
}

/// Returns a line without bands.
fn means(line: Line) -> Line {
    line.into_iter().map(|(step, spread)| (step, Spread { band: None, ..spread })).collect()
}

/// Returns the centred moving average, over fewer points at the ends.
fn smoothed(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let points = finite(points);
    let around = |index: usize| {
        let half = (WINDOW / 2).min(index).min(points.len() - 1 - index);
        let window = &points[index - half..=index + half];
        (points[index].0, window.iter().map(|(_, value)| value).sum::<f64>() / window.len() as f64)
    };
    (0..points.len()).map(around).collect()
}

/// Returns a line of means at the log points themselves.
fn unsmoothed(seeds: &[Vec<(f64, f64)>]) -> Line {
    spreads(&seeds.iter().map(|seed| finite(seed)).collect::<Vec<_>>())
}

fn finite(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    points.iter().copied().filter(|(_, value)| value.is_finite()).collect()
}

/// Returns the lowest and highest number of lines and their bands.
fn range_of<'a>(lines: impl Iterator<Item = &'a Line>) -> Option<(f64, f64)> {
    super::range_of(
        PSNR.key,
        lines.flatten().flat_map(|(_, s)| s.band.map_or([s.mean, s.mean], |(low, high)| [low, high])),
    )
}

/// A panel over steps.
struct Plot {
    panel: Panel,
    /// The last step.
    end: f64,
}

impl Plot {
    fn x(&self, step: f64) -> f64 {
        self.panel.left + self.panel.width * step / self.end
    }

    /// Draws the numbers of the x axis and the names of both axes; returns the position after them.
    fn axis(&self, drawing: &mut Canvas, title: &[String]) -> f64 {
        let panel = &self.panel;
        for (mark, text) in tick_texts((0.0, self.end), panel.width) {
            drawing.text((self.x(mark), panel.bottom() + 12.0), &text, TEXT, Anchor::Middle, BLACK);
        }
        drawing.text((panel.left + panel.width / 2.0, panel.bottom() + 29.0), "step", TEXT, Anchor::Middle, BLACK);
        for (index, line) in title.iter().enumerate() {
            let above = (title.len() - 1 - index) as f64;
            drawing.text((panel.left, panel.top - 11.0 - LINE_HEIGHT * above), line, TEXT, Anchor::Left, BLACK);
        }
        panel.bottom() + 42.0
    }

    /// Draws a line of means with its band.
    fn line(&self, drawing: &mut Canvas, line: &Line, stroke: Stroke) {
        let banded: Vec<(f64, (f64, f64))> = line.iter().filter_map(|(step, s)| Some((*step, s.band?))).collect();
        if banded.len() > 1 {
            let upper = banded.iter().map(|(step, (_, high))| (self.x(*step), self.panel.y(*high)));
            let lower = banded.iter().rev().map(|(step, (low, _))| (self.x(*step), self.panel.y(*low)));
            drawing.area(upper.chain(lower).collect(), stroke.colour, 0.12);
        }
        stroke.draw(drawing, &self.places(line));
    }

    /// Returns the places of a line's means.
    fn places(&self, line: &Line) -> Vec<(f64, f64)> {
        line.iter().map(|(step, s)| (self.x(*step), self.panel.y(s.mean))).collect()
    }
}

/// A row of the figure.
struct Row<'a> {
    label: &'a str,
    stroke: Stroke,
    /// Moving average of the training rays.
    rays: Line,
    held_out: Line,
    seen: Line,
}

impl<'a> Row<'a> {
    fn new(style: Style, curve: &'a Curve) -> Row<'a> {
        let smooth: Vec<_> = curve.seeds.iter().map(|seed| smoothed(seed)).collect();
        // A row shares its seeds with its baseline: its band would say the same, and hide that.
        let own = |line| if style.baseline_of(&curve.label).is_some() { means(line) } else { line };
        Row {
            label: &curve.label,
            stroke: style.stroke(&curve.label),
            rays: own(spreads(&smooth)),
            held_out: own(unsmoothed(&curve.held_out)),
            seen: means(unsmoothed(&curve.seen)),
        }
    }

    fn last(&self) -> f64 {
        self.rays.last().map_or(0.0, |(step, _)| *step)
    }

    /// Returns the row's last value: of held-out views if they were evaluated.
    fn score(&self) -> f64 {
        self.held_out.last().or(self.rays.last()).map_or(f64::NEG_INFINITY, |(_, spread)| spread.mean)
    }
}

/// Draws means over seeds against steps. If views were evaluated during training, a panel shows held-out and training
/// views. Returns `None` without points.
pub fn curves_figure(style: Style, scene: &str, curves: &[Curve]) -> Option<Figure> {
    let rows = curves.iter().map(|curve| Row::new(style, curve)).filter(|row| !row.rays.is_empty());
    let mut rows: Vec<Row> = rows.collect();
    let all = rows.len();
    keep_best(style, &mut rows);
    // A single log is no curve.
    let has_curve = rows.iter().any(|row| row.rays.len() > 1 || row.held_out.len() > 1);
    if !has_curve || range_of(rows.iter().map(|row| &row.rays)).is_none() {
        return None;
    }
    let end = rows.iter().map(Row::last).fold(1.0, f64::max);
    let mut drawing = canvas();
    let rays = rows.iter().map(|row| (row, vec![(row.rays.clone(), row.stroke)])).collect();
    draw(&mut drawing, "PSNR of the step's rays (dB)", end, rays, 210.0);
    let evaluated = rows.iter().filter(|row| !row.held_out.is_empty() || !row.seen.is_empty()).map(|row| {
        let line = |line: &Line, dashed| (line.clone(), Stroke { dashed, ..row.stroke });
        (row, vec![line(&row.held_out, false), line(&row.seen, true)])
    });
    let title = "PSNR of whole views (dB): held-out, and training (dashed)";
    draw(&mut drawing, title, end, evaluated.collect(), 190.0);
    Some(style.finish(drawing, &format!("Training on {scene}"), &caption(all, rows.len())))
}

/// Keeps the baseline and the best other rows, if there are many.
fn keep_best(style: Style, rows: &mut Vec<Row>) {
    if rows.len() <= MOST {
        return;
    }
    let baseline = rows.iter().position(|row| style.baseline_of(row.label).is_none()).unwrap_or(0);
    let mut kept: Vec<usize> = (0..rows.len()).filter(|index| *index != baseline).collect();
    kept.sort_by(|a, b| rows[*b].score().total_cmp(&rows[*a].score()));
    kept.truncate(BEST);
    let mut indices = 0..;
    rows.retain(|_| indices.next().is_some_and(|index| index == baseline || kept.contains(&index)));
}

/// Draws a panel below everything: the lines of rows, the first of each named at its end; nothing without lines.
fn draw(drawing: &mut Canvas, title: &str, end: f64, rows: Vec<(&Row, Vec<(Line, Stroke)>)>, height: f64) {
    let lines = rows.iter().flat_map(|(_, lines)| lines).map(|(line, _)| line);
    let Some(range) = range_of(lines) else { return };
    let title = wrapped(title, drawing.width - LEFT - SIDE, TEXT);
    let panel = Panel {
        left: LEFT,
        top: drawing.height + LINE_HEIGHT * title.len() as f64 + 4.0,
        width: drawing.width - LEFT - NAMES - SIDE,
        height,
        range,
    };
    let plot = Plot { panel, end };
    plot.panel.frame(drawing, true);
    let foot = plot.axis(drawing, &title);
    let mut named = Vec::new();
    for (row, own) in &rows {
        own.iter().for_each(|(line, stroke)| plot.line(drawing, line, *stroke));
        let end = own.iter().find_map(|(line, _)| plot.places(line).last().copied());
        named.extend(end.map(|at| End { at, stroke: row.stroke, name: row.label }));
    }
    ends::draw(drawing, &plot.panel, NAMES, named);
    drawing.height = foot;
}

fn caption(all: usize, drawn: usize) -> String {
    let mut text = format!(
        "Lines are means over seeds. The baseline has a band: mean ± standard deviation of three and more seeds, from end to \
         end of two. Curves of the step's rays are moving averages over {WINDOW} log points."
    );
    if drawn < all {
        text += &format!(" Of {all} rows: the baseline and the {BEST} with the highest last value.");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_are_averaged_step_by_step() {
        let seeds = [vec![(1.0, 10.0), (2.0, f64::NAN), (3.0, 30.0)], vec![(1.0, 20.0), (2.0, 7.0), (3.0, 40.0)]];
        let means: Vec<(f64, f64)> = unsmoothed(&seeds).into_iter().map(|(step, spread)| (step, spread.mean)).collect();
        assert_eq!(means, [(1.0, 15.0), (2.0, 7.0), (3.0, 35.0)]);
    }
}
