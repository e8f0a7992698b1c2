//! Training curves.

use super::{Figure, SPREAD_NOTE, Spread};
use crate::base::Result;
use crate::draw::canvas::{
    Anchor, BLACK, Canvas, LINE_HEIGHT, PALETTE, Panel, TEXT, TITLE, number, range, text_width, ticks,
};

/// Log points that a curve's moving average spans.
const WINDOW: usize = 5;

/// One row's training, seed by seed: step and value.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// The row.
    pub label: String,
    /// Log points of each seed.
    pub seeds: Vec<Vec<(f64, f64)>>,
}

impl Curve {
    /// Steps with what the smoothed seeds spread over there.
    fn spreads(&self) -> Vec<(f64, Spread)> {
        let smooth: Vec<Vec<(f64, f64)>> = self.seeds.iter().map(|seed| smoothed(seed)).collect();
        let Some(first) = smooth.first() else { return Vec::new() };
        let at = |index: usize| {
            let values: Vec<f64> = smooth.iter().filter_map(|seed| Some(seed.get(index)?.1)).collect();
            Some((first[index].0, Spread::new(&values)?))
        };
        (0..first.len()).filter_map(at).collect()
    }
}

/// Centred moving average; shorter at the ends.
fn smoothed(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let points: Vec<(f64, f64)> = points.iter().copied().filter(|(_, value)| value.is_finite()).collect();
    let around = |index: usize| {
        let half = (WINDOW / 2).min(index).min(points.len() - 1 - index);
        let window = &points[index - half..=index + half];
        (points[index].0, window.iter().map(|(_, value)| value).sum::<f64>() / window.len() as f64)
    };
    (0..points.len()).map(around).collect()
}

/// Means over seeds against steps, with a legend; none without points.
pub fn curves_figure(title: &str, unit: &str, curves: &[Curve]) -> Result<Option<Figure>> {
    let spreads: Vec<(&Curve, Vec<(f64, Spread)>)> = curves.iter().map(|curve| (curve, curve.spreads())).collect();
    let values = spreads.iter().flat_map(|(_, spread)| {
        spread.iter().flat_map(|(_, s)| s.band.map_or([s.mean, s.mean], |(low, high)| [low, high]))
    });
    let steps = spreads.iter().flat_map(|(_, spread)| spread.iter().map(|(step, _)| *step));
    let (Some(range), Some(last)) = (range(values), steps.reduce(f64::max)) else { return Ok(None) };
    let legend = curves.iter().map(|curve| text_width(&curve.label, TEXT)).fold(60.0, f64::max);
    let panel = Panel { left: 76.0, top: 50.0, width: 560.0, height: 320.0, range };
    let legend_height = 60.0 + curves.len() as f64 * LINE_HEIGHT;
    let mut drawing = Canvas::new(panel.right() + legend + 70.0, (panel.bottom() + 52.0).max(legend_height));
    drawing.text((20.0, 20.0), title, TITLE, Anchor::Left, BLACK);
    panel.frame(&mut drawing, true);
    let x = |step: f64| panel.left + panel.width * step / last.max(1.0);
    let (marks, step) = ticks((0.0, last.max(1.0)), 6);
    for mark in marks {
        drawing.text((x(mark), panel.bottom() + 12.0), &number(mark, step), TEXT, Anchor::Middle, BLACK);
    }
    drawing.text((panel.left + panel.width / 2.0, panel.bottom() + 32.0), "step", TEXT, Anchor::Middle, BLACK);
    drawing.text((panel.left, panel.top - 12.0), unit, TEXT, Anchor::Left, BLACK);
    for (index, (curve, spread)) in spreads.iter().enumerate() {
        let colour = PALETTE[index % PALETTE.len()];
        let banded: Vec<(f64, (f64, f64))> = spread.iter().filter_map(|(step, s)| Some((*step, s.band?))).collect();
        if banded.len() > 1 {
            let upper = banded.iter().map(|(step, (_, high))| (x(*step), panel.y(*high)));
            let lower = banded.iter().rev().map(|(step, (low, _))| (x(*step), panel.y(*low)));
            drawing.area(upper.chain(lower).collect(), colour, 0.12);
        }
        let line: Vec<(f64, f64)> = spread.iter().map(|(step, s)| (x(*step), panel.y(s.mean))).collect();
        let y = panel.top + 8.0 + index as f64 * LINE_HEIGHT;
        let sample = [(panel.right() + 14.0, y), (panel.right() + 42.0, y)];
        // Beyond the palette's end colours come again, dashed.
        if index < PALETTE.len() {
            drawing.line(&line, colour, 1.8);
            drawing.line(&sample, colour, 2.5);
        } else {
            drawing.dashed(&line, colour, 1.8);
            drawing.dashed(&sample, colour, 2.5);
        }
        drawing.text((panel.right() + 48.0, y), &curve.label, TEXT, Anchor::Left, BLACK);
    }
    drawing
        .caption(&format!("{SPREAD_NOTE} Curves are moving averages over {WINDOW} log points, of the training rays."));
    drawing.finish().map(Some)
}
