//! How far the attack moves colours during training, site by site.

use super::curves::{Line, Plot, Seeds, axis_end, cut, unsmoothed};
use super::{Figure, SPREAD_NOTE, Spread, Stroke, Style, canvas, legend};
use crate::augment::Site;
use crate::base::Result;
use crate::draw::canvas::{Canvas, GREY, LINE_HEIGHT, Panel, SIDE};
use crate::settings::columns::LEAST_SHIFT;

/// Panels side by side of a page and of a column, and their heights.
const ACROSS: (usize, usize) = (3, 2);
const HEIGHT: (f64, f64) = (160.0, 130.0);
const LEFT: f64 = 50.0;
const GAP: f64 = 36.0;
const INACTIVE: &str = "1/2: a seed below is inactive";

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

    /// Returns the last step of any site.
    fn last(&self) -> Option<f64> {
        let steps = self.sites.iter().flat_map(|(_, seeds)| seeds).flatten().map(|(step, _)| *step);
        steps.reduce(f64::max)
    }
}

/// Draws a panel for each site of any row, on one logarithmic scale: means over seeds against steps. Returns `None` if
/// no colour moved.
pub fn shifts_figure(style: Style, scene: &str, rows: &[Shifts]) -> Result<Option<Figure>> {
    let end = axis_end(&rows.iter().filter_map(Shifts::last).collect::<Vec<f64>>());
    let lines = |site: Site| (site, rows.iter().map(|row| cut(&row.line(site), end)).collect::<Vec<Line>>());
    let sites: Vec<(Site, Vec<Line>)> =
        Site::ALL.into_iter().map(lines).filter(|(_, lines)| lines.iter().any(|line| !line.is_empty())).collect();
    let points = || sites.iter().flat_map(|(_, lines)| lines).flatten();
    let Some(range) = decades(points()) else { return Ok(None) };
    let across = style.width.pick(ACROSS.0, ACROSS.1);
    let mut drawing = canvas(style.width);
    let width = (drawing.width - LEFT - SIDE + GAP) / across as f64 - GAP;
    let strokes: Vec<Stroke> = rows.iter().map(|row| style.stroke(&row.label)).collect();
    let (room, head) = (drawing.width - 2.0 * SIDE, "shift of the rendered colours (8-bit steps)");
    drawing.height = drawing.lines((SIDE, drawing.height + 4.0), room, head, GREY);
    for line in sites.chunks(across) {
        let (top, mut foot) = (drawing.height + LINE_HEIGHT, 0.0);
        for (column, (site, lines)) in line.iter().enumerate() {
            let left = LEFT + column as f64 * (width + GAP);
            let panel = Panel { left, top, width, height: style.width.pick(HEIGHT.0, HEIGHT.1), range };
            foot = draw_site(&mut drawing, Plot { panel, end, along: "step" }, *site, lines, &strokes, column == 0);
        }
        drawing.height = foot;
    }
    let mut entries: Vec<(&str, Stroke)> = rows.iter().map(|row| row.label.as_str()).zip(strokes).collect();
    entries.push((INACTIVE, BOUND));
    legend::draw(&mut drawing, &entries);
    let longer: Vec<&str> =
        rows.iter().filter(|row| row.last().is_some_and(|last| last > end)).map(|row| row.label.as_str()).collect();
    let caption = caption(points().any(|(_, shift)| shift.mean <= 0.0), &longer);
    style.finish(drawing, &format!("Shift of colours by the attack on {scene}"), &caption)
}

const BOUND: Stroke = Stroke { colour: GREY, dashed: true, width: 1.2 };

/// Draws a site's panel; returns the position after it.
fn draw_site(drawing: &mut Canvas, plot: Plot, site: Site, lines: &[Line], strokes: &[Stroke], numbers: bool) -> f64 {
    let panel = &plot.panel;
    panel.log_frame(drawing, numbers);
    let foot = plot.axis(drawing, &[site.name().to_string()]);
    let y = panel.y(LEAST_SHIFT.log10());
    BOUND.draw(drawing, &[(panel.left, y), (panel.right(), y)]);
    for (line, stroke) in lines.iter().zip(strokes) {
        plot.line(drawing, &logarithms(line, panel.range.0), *stroke);
    }
    foot
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

fn caption(has_zeros: bool, longer: &[&str]) -> String {
    let zeros = if has_zeros { " Shifts of 0 have no place on this scale." } else { "" };
    let longer = if longer.is_empty() { String::new() } else { format!(" Cut off: {}.", longer.join("; ")) };
    format!(
        "{SPREAD_NOTE} Shift: how far the deltas of this site alone move the colours of the step's rays, mean over rays and \
         channels. A site is inactive with a seed if its mean over that seed's last ten logs is below 1/2.{zeros}{longer}"
    )
}
