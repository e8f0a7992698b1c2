//! Error against predicted spread.

use super::curves::Plot;
use super::{Figure, Stroke, Width, legend};
use crate::base::Result;
use crate::draw::canvas::{BLUE, Canvas, GREY, GRID, Panel, SIDE, tick_texts};
use crate::report::calibration::CalibrationBin;

const LEFT: f64 = 60.0;
const HEIGHT: f64 = 300.0;
/// Room of an axis beyond its largest value.
const ROOM: f64 = 1.05;
const CALIBRATED: Stroke = Stroke { colour: GREY, dashed: true, width: 1.5 };
const UNBIASED: Stroke = Stroke { colour: GREY, dashed: false, width: 1.2 };
const BINS: Stroke = Stroke { colour: BLUE, dashed: false, width: 2.0 };

/// Draws the root mean square error of the mean of `seeds` seeds against their root mean square spread, one dot a bin.
/// The dashed diagonal is error = spread. The grey line is error = spread / sqrt(seeds), the standard error of the mean.
pub fn calibration_figure(title: &str, bins: &[CalibrationBin], seeds: usize, caption: &str) -> Result<Figure> {
    let largest = |value: fn(&CalibrationBin) -> f64| bins.iter().map(value).fold(0.0, f64::max);
    // If all bins are 0, the axes still need a length.
    let end = |value| if largest(value) > 0.0 { ROOM * largest(value) } else { 1.0 / 255.0 };
    let (right, top) = (end(|bin| bin.spread_rms), end(|bin| bin.error_rms));
    let mut drawing = Canvas::titled(Width::Column, title);
    let width = drawing.width - LEFT - SIDE;
    let panel = Panel { left: LEFT, top: drawing.height + 24.0, width, height: HEIGHT, range: (0.0, top) };
    let plot = Plot { panel, end: right, along: "spread over seeds" };
    for (mark, _) in tick_texts((0.0, right), width) {
        drawing.line(&[(plot.x(mark), plot.panel.top), (plot.x(mark), plot.panel.bottom())], GRID, 1.0);
    }
    plot.panel.frame(&mut drawing, true);
    drawing.height = plot.axis(&mut drawing, &["error of the mean image".to_string()]) + 4.0;
    let ray = |slope: f64, stroke: Stroke, drawing: &mut Canvas| {
        let end = right.min(top / slope);
        stroke.draw(drawing, &[(plot.x(0.0), plot.panel.y(0.0)), (plot.x(end), plot.panel.y(slope * end))]);
    };
    ray(1.0, CALIBRATED, &mut drawing);
    ray(1.0 / (seeds as f64).sqrt(), UNBIASED, &mut drawing);
    let line: Vec<(f64, f64)> = bins.iter().map(|bin| (plot.x(bin.spread_rms), plot.panel.y(bin.error_rms))).collect();
    BINS.draw(&mut drawing, &line);
    line.iter().for_each(|at| drawing.dot(*at, 3.5, BLUE, 1.0));
    let unbiased = format!("error = spread / √{seeds}");
    legend::draw(&mut drawing, &[("pixels, by spread", BINS), ("error = spread", CALIBRATED), (&unbiased, UNBIASED)]);
    drawing.caption(caption);
    drawing.finish()
}
