//! How far the attack moves colours during training, site by site.

use super::curves::{Line, Plot, Seeds, Stroke, stroke, unsmoothed};
use super::differences::widest;
use super::{Figure, SPREAD_NOTE, Spread};
use crate::augment::Site;
use crate::base::Result;
use crate::draw::canvas::{Anchor, BLACK, Canvas, GREY, LINE_HEIGHT, Panel, SIDE, TEXT};
use crate::settings::columns::LEAST_SHIFT;

const PANEL: (f64, f64) = (260.0, 190.0);
const GAP: (f64, f64) = (40.0, 72.0);
const MARGIN: (f64, f64) = (76.0, 84.0);
/// Number of panels side by side.
const COLUMNS: usize = 3;
const INACTIVE: &str = "1/2: inactive below";

/// How far one row's deltas move the rendered colours, in 8-bit steps.
#[derive(Clone, Debug, PartialEq)]
pub struct Shifts {
    /// The row.
    pub label: String,
    /// The sites that were logged.
    pub sites: Vec<(Site, Seeds)>,
}

impl Shifts {
    fn line(&self, site: Site) -> Line {
        self.sites.iter().find(|(own, _)| *own == site).map_or(Line::new(), |(_, seeds)| unsmoothed(seeds))
    }
}

/// Draws a panel for each site of any row, on one logarithmic scale: means over seeds against steps. Returns `None` if
/// no colour moved.
pub fn shifts_figure(title: &str, rows: &[Shifts]) -> Result<Option<Figure>> {
    let lines = |site: Site| (site, rows.iter().map(|row| row.line(site)).collect::<Vec<Line>>());
    let sites: Vec<(Site, Vec<Line>)> =
        Site::ALL.into_iter().map(lines).filter(|(_, lines)| lines.iter().any(|line| !line.is_empty())).collect();
    let points = || sites.iter().flat_map(|(_, lines)| lines).flatten();
    let last = points().map(|(step, _)| *step).reduce(f64::max);
    let (Some(range), Some(last)) = (decades(points()), last) else { return Ok(None) };
    let panel = |index: usize| Panel {
        left: MARGIN.0 + (index % COLUMNS) as f64 * (PANEL.0 + GAP.0),
        top: MARGIN.1 + (index / COLUMNS) as f64 * (PANEL.1 + GAP.1),
        width: PANEL.0,
        height: PANEL.1,
        range,
    };
    let plot = |index: usize| Plot { panel: panel(index), last, along: "step" };
    let beside = plot(sites.len().min(COLUMNS) - 1);
    let legend = widest(rows.iter().map(|row| row.label.as_str()).chain([INACTIVE]), 60.0);
    let width = beside.panel.right() + legend + 70.0;
    let below_legend = MARGIN.1 + (rows.len() + 1) as f64 * LINE_HEIGHT;
    let height = (panel(sites.len() - 1).bottom() + 52.0).max(below_legend);
    let mut drawing = Canvas::titled(width, height, title);
    drawing.text((SIDE, 44.0), "shift of the rendered colours (8-bit steps)", TEXT, Anchor::Left, BLACK);
    for (index, (site, lines)) in sites.iter().enumerate() {
        draw_site(&mut drawing, &plot(index), *site, lines, index % COLUMNS == 0);
    }
    for (index, row) in rows.iter().enumerate() {
        beside.entry(&mut drawing, index, &row.label, stroke(index));
    }
    beside.entry(&mut drawing, rows.len(), INACTIVE, BOUND);
    drawing.caption(&caption(points().any(|(_, shift)| shift.mean <= 0.0)));
    drawing.finish().map(Some)
}

const BOUND: Stroke = Stroke { colour: GREY, dashed: true, width: 1.2 };

fn draw_site(drawing: &mut Canvas, plot: &Plot, site: Site, lines: &[Line], numbers: bool) {
    let panel = &plot.panel;
    panel.log_frame(drawing, numbers);
    plot.axis(drawing, site.name());
    let y = panel.y(LEAST_SHIFT.log10());
    BOUND.draw(drawing, &[(panel.left, y), (panel.right(), y)]);
    for (index, line) in lines.iter().enumerate() {
        plot.line(drawing, &logarithms(line, panel.range.0), stroke(index));
    }
}

/// Returns whole powers of ten around the data and the bound, or `None` if nothing is above 0.
fn decades<'a>(points: impl Iterator<Item = &'a (f64, Spread)>) -> Option<(f64, f64)> {
    let drawn = points.filter(|(_, shift)| shift.mean > 0.0);
    let ends = drawn.flat_map(|(_, shift)| [shift.mean, shift.band.map_or(shift.mean, |(_, high)| high)]);
    let logarithms: Vec<f64> = ends.map(f64::log10).filter(|value| value.is_finite()).collect();
    let bound = LEAST_SHIFT.log10();
    let low = logarithms.iter().copied().reduce(f64::min)?.min(bound);
    let high = logarithms.into_iter().fold(bound, f64::max);
    Some((low.floor(), high.ceil()))
}

/// Returns a line on the logarithmic scale, without 0; bands that reach 0 end at `least`.
fn logarithms(line: &Line, least: f64) -> Line {
    let drawn = line.iter().filter(|(_, shift)| shift.mean > 0.0);
    let logarithm = |shift: &Spread| Spread {
        mean: shift.mean.log10(),
        band: shift.band.map(|(low, high)| (low.max(0.0).log10().max(least), high.log10())),
    };
    drawn.map(|(step, shift)| (*step, logarithm(shift))).collect()
}

fn caption(has_zeros: bool) -> String {
    let zeros = if has_zeros { " Shifts of 0 have no place on this scale." } else { "" };
    format!(
        "{SPREAD_NOTE} Shift: how far the deltas of this site alone move the colours of the step's rays, mean over rays and \
         channels. A site whose mean over its last ten logs is below 1/2 counts as inactive.{zeros}"
    )
}
