//! Training curves.

use super::{Figure, SPREAD_NOTE, Spread};
use crate::base::Result;
use crate::draw::canvas::{
    Anchor, BLACK, Canvas, Colour, LINE_HEIGHT, PALETTE, Panel, TEXT, number, range, text_width, ticks,
};

/// Log points in a curve's moving average.
const WINDOW: usize = 5;

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
    /// Mean seconds of a step over the seeds, or `None` if clock times are not shown.
    pub seconds_per_step: Option<f64>,
}

impl Curve {
    /// Returns the same against seconds of training, or `None` if they are unknown.
    fn in_seconds(&self) -> Option<Curve> {
        let seconds = self.seconds_per_step?;
        let scaled = |seeds: &[Vec<(f64, f64)>]| -> Seeds {
            seeds.iter().map(|seed| seed.iter().map(|(step, value)| (step * seconds, *value)).collect()).collect()
        };
        let [seeds, held_out, seen] = [&self.seeds, &self.held_out, &self.seen].map(|seeds| scaled(seeds));
        Some(Curve { label: self.label.clone(), seeds, held_out, seen, seconds_per_step: None })
    }
}

/// Steps, with the spread of the values of all seeds.
pub(super) type Line = Vec<(f64, Spread)>;

fn spreads(seeds: &[Vec<(f64, f64)>]) -> Line {
    let Some(first) = seeds.first() else { return Vec::new() };
    let at = |index: usize| {
        let values: Vec<f64> = seeds.iter().filter_map(|seed| Some(seed.get(index)?.1)).collect();
        Some((first[index].0, Spread::new(&values)?))
    };
    (0..first.len()).filter_map(at).collect()
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

/// Draws a line of means at the log points themselves.
pub(super) fn unsmoothed(seeds: &[Vec<(f64, f64)>]) -> Line {
    spreads(&seeds.iter().map(|seed| finite(seed)).collect::<Vec<_>>())
}

fn finite(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    points.iter().copied().filter(|(_, value)| value.is_finite()).collect()
}

/// Returns the lowest and highest number of lines and their bands.
fn range_of<'a>(lines: impl Iterator<Item = &'a Line>) -> Option<(f64, f64)> {
    range(lines.flatten().flat_map(|(_, s)| s.band.map_or([s.mean, s.mean], |(low, high)| [low, high])))
}

/// How a line is drawn.
#[derive(Clone, Copy)]
pub(super) struct Stroke {
    pub(super) colour: Colour,
    pub(super) dashed: bool,
    pub(super) width: f64,
}

impl Stroke {
    pub(super) fn draw(self, drawing: &mut Canvas, line: &[(f64, f64)]) {
        match self.dashed {
            true => drawing.dashed(line, self.colour, self.width),
            false => drawing.line(line, self.colour, self.width),
        }
    }
}

/// A panel over steps.
pub(super) struct Plot {
    pub(super) panel: Panel,
    /// The last step.
    pub(super) last: f64,
    /// Quantity of the x axis.
    pub(super) along: &'static str,
}

impl Plot {
    /// End of the x axis.
    fn end(&self) -> f64 {
        if self.last > 0.0 { self.last } else { 1.0 }
    }

    fn x(&self, step: f64) -> f64 {
        self.panel.left + self.panel.width * step / self.end()
    }

    fn frame(&self, drawing: &mut Canvas, unit: &str) {
        self.panel.frame(drawing, true);
        self.axis(drawing, unit);
    }

    /// Draws the numbers of the x axis and the names of both axes.
    pub(super) fn axis(&self, drawing: &mut Canvas, title: &str) {
        let panel = &self.panel;
        let (marks, step) = ticks((0.0, self.end()), (panel.width / 85.0) as usize);
        for mark in marks {
            drawing.text((self.x(mark), panel.bottom() + 12.0), &number(mark, step), TEXT, Anchor::Middle, BLACK);
        }
        drawing.text((panel.left + panel.width / 2.0, panel.bottom() + 32.0), self.along, TEXT, Anchor::Middle, BLACK);
        drawing.text((panel.left, panel.top - 12.0), title, TEXT, Anchor::Left, BLACK);
    }

    pub(super) fn line(&self, drawing: &mut Canvas, line: &Line, stroke: Stroke) {
        let banded: Vec<(f64, (f64, f64))> = line.iter().filter_map(|(step, s)| Some((*step, s.band?))).collect();
        if banded.len() > 1 {
            let upper = banded.iter().map(|(step, (_, high))| (self.x(*step), self.panel.y(*high)));
            let lower = banded.iter().rev().map(|(step, (low, _))| (self.x(*step), self.panel.y(*low)));
            drawing.area(upper.chain(lower).collect(), stroke.colour, 0.12);
        }
        stroke.draw(drawing, &self.places(line));
    }

    /// Draws a line's means.
    fn places(&self, line: &Line) -> Vec<(f64, f64)> {
        line.iter().map(|(step, s)| (self.x(*step), self.panel.y(s.mean))).collect()
    }

    /// Draws an entry of the legend next to the panel.
    pub(super) fn entry(&self, drawing: &mut Canvas, index: usize, label: &str, stroke: Stroke) {
        let y = self.panel.top + 8.0 + index as f64 * LINE_HEIGHT;
        let sample = [(self.panel.right() + 14.0, y), (self.panel.right() + 42.0, y)];
        Stroke { width: 2.5, ..stroke }.draw(drawing, &sample);
        drawing.text((self.panel.right() + 48.0, y), label, TEXT, Anchor::Left, BLACK);
    }
}

/// Returns a row's colour. After the last colour of the palette, colours repeat, dashed.
pub(super) fn stroke(index: usize) -> Stroke {
    Stroke { colour: PALETTE[index % PALETTE.len()], dashed: index >= PALETTE.len(), width: 1.8 }
}

/// Draws means over seeds against steps, with a legend. If views were evaluated during training, a panel below shows
/// held-out and training views. Returns `None` without points.
pub fn curves_figure(title: &str, unit: &str, curves: &[Curve]) -> Result<Option<Figure>> {
    figure(title, unit, "step", curves)
}

/// Draws the same against seconds of training, for the curves whose seconds are known.
pub fn seconds_figure(title: &str, unit: &str, curves: &[Curve]) -> Result<Option<Figure>> {
    let curves: Vec<Curve> = curves.iter().filter_map(Curve::in_seconds).collect();
    figure(title, unit, "seconds of training", &curves)
}

fn figure(title: &str, unit: &str, along: &'static str, curves: &[Curve]) -> Result<Option<Figure>> {
    let smooth = |curve: &Curve| curve.seeds.iter().map(|seed| smoothed(seed)).collect::<Vec<_>>();
    let lines: Vec<Line> = curves.iter().map(|curve| spreads(&smooth(curve))).collect();
    let steps = lines.iter().flatten().map(|(step, _)| *step);
    let (Some(range), Some(last)) = (range_of(lines.iter()), steps.reduce(f64::max)) else { return Ok(None) };
    let legend = curves.iter().map(|curve| text_width(&curve.label, TEXT)).fold(60.0, f64::max);
    let plot = Plot { panel: Panel { left: 76.0, top: 50.0, width: 560.0, height: 320.0, range }, last, along };
    let legend_height = 60.0 + curves.len() as f64 * LINE_HEIGHT;
    let bottom = (plot.panel.bottom() + 52.0).max(legend_height);
    let evaluated = Evaluated::new(curves, bottom, last, along);
    let width = if evaluated.is_some() { legend.max(text_width(SEEN, TEXT)) } else { legend };
    let bottom = evaluated.as_ref().map_or(bottom, |evaluated| evaluated.plot.panel.bottom() + 52.0);
    let mut drawing = Canvas::titled(plot.panel.right() + width + 70.0, bottom, title);
    plot.frame(&mut drawing, unit);
    for (index, (curve, line)) in curves.iter().zip(&lines).enumerate() {
        plot.line(&mut drawing, line, stroke(index));
        plot.entry(&mut drawing, index, &curve.label, stroke(index));
    }
    if let Some(evaluated) = &evaluated {
        evaluated.draw(&mut drawing);
    }
    let above = if evaluated.is_some() { "above are" } else { "are" };
    drawing.caption(&format!(
        "{SPREAD_NOTE} Curves {above} moving averages over {WINDOW} log points, of the training rays."
    ));
    drawing.finish().map(Some)
}

const HELD_OUT: &str = "held-out views";
const SEEN: &str = "training views";

/// The panel of evaluations during training.
struct Evaluated {
    plot: Plot,
    /// Each row's held-out and training views.
    lines: Vec<[Line; 2]>,
}

impl Evaluated {
    /// Returns the panel below `top`, or `None` if nothing was evaluated.
    fn new(curves: &[Curve], top: f64, last: f64, along: &'static str) -> Option<Evaluated> {
        let both = |curve: &Curve| [&curve.held_out, &curve.seen].map(|seeds| unsmoothed(seeds));
        let lines: Vec<[Line; 2]> = curves.iter().map(both).collect();
        let range = range_of(lines.iter().flatten())?;
        let panel = Panel { left: 76.0, top: top + 30.0, width: 560.0, height: 240.0, range };
        Some(Evaluated { plot: Plot { panel, last, along }, lines })
    }

    fn draw(&self, drawing: &mut Canvas) {
        self.plot.frame(drawing, "PSNR of whole views (dB)");
        for (index, [held_out, seen]) in self.lines.iter().enumerate() {
            let solid = Stroke { dashed: false, ..stroke(index) };
            self.plot.line(drawing, held_out, solid);
            self.plot.places(held_out).into_iter().for_each(|at| drawing.dot(at, 2.5, solid.colour, 1.0));
            Stroke { dashed: true, ..solid }.draw(drawing, &self.plot.places(seen));
        }
        for (index, (label, dashed)) in [(HELD_OUT, false), (SEEN, true)].into_iter().enumerate() {
            self.plot.entry(drawing, index, label, Stroke { colour: BLACK, dashed, width: 1.8 });
        }
    }
}
