//! Figures of a sweep.
//!
//! Each is as wide as a page; long names wrap. Title and caption stand beside the figure, in [`Figure::caption`]. A row has
//! one colour in all figures. Blue is better, orange worse, grey not shown.

use crate::draw::canvas::{Canvas, Colour, PAGE, PALETTE, range};
use crate::metrics::{Digits, Metric};
use crate::report::TableSpec;
use crate::report::statistics::{mean, standard_deviation};

mod axes;
mod comparisons;
mod curves;
mod differences;
mod ends;
mod legend;
mod places;
mod rows;
mod series;

pub use crate::draw::Figure;
pub use axes::axes_figure;
pub use comparisons::comparisons_figure;
pub use curves::{Curve, Seeds, curves_figure};
pub use rows::rows_figure;

/// Free height above everything.
const TOP: f64 = 8.0;

/// What the figures of a sweep share.
#[derive(Clone, Copy)]
pub struct Style<'a> {
    /// The sweep's rows; a row's place decides its colour.
    pub spec: &'a TableSpec,
}

impl Style<'_> {
    /// Finishes a figure with what it shows and its caption, to which settings that were changed for all rows belong.
    fn finish(&self, drawing: Canvas, shows: &str, caption: &str) -> Figure {
        let changed = match self.spec.changed.as_str() {
            "" => String::new(),
            changed => format!(" All rows: {changed}."),
        };
        captioned(drawing, shows, &format!("{caption}{changed}"))
    }

    /// Returns the line of a row. After the last colour of the palette, colours repeat, dashed.
    fn stroke(&self, row: &str) -> Stroke {
        let mut own = self.spec.rows.iter().filter(|known| !known.quoted);
        Stroke::of(own.position(|known| known.name == row).unwrap_or(0))
    }

    /// Returns the name of a row's baseline.
    fn baseline_of(&self, row: &str) -> Option<&str> {
        self.spec.rows.iter().find(|known| known.name == row)?.baseline.as_deref()
    }
}

/// How a line is drawn.
#[derive(Clone, Copy)]
struct Stroke {
    colour: Colour,
    dashed: bool,
    width: f64,
}

impl Stroke {
    fn of(index: usize) -> Stroke {
        Stroke { colour: PALETTE[index % PALETTE.len()], dashed: index >= PALETTE.len(), width: 1.8 }
    }

    /// Draws a line, or a dot where there is one point.
    fn draw(self, drawing: &mut Canvas, line: &[(f64, f64)]) {
        match (line, self.dashed) {
            ([only], _) => drawing.dot(*only, 3.0, self.colour, 1.0),
            (_, true) => drawing.dashed(line, self.colour, self.width),
            (_, false) => drawing.line(line, self.colour, self.width),
        }
    }
}

/// Returns an empty canvas of a figure's width.
fn canvas() -> Canvas {
    Canvas::new(PAGE, TOP)
}

/// Finishes a figure with what it shows and how it is read.
fn captioned(drawing: Canvas, shows: &str, caption: &str) -> Figure {
    Figure { caption: format!("{shows}\n{caption}\n"), ..drawing.finish() }
}

/// Returns a range around values of a metric, which spans ten units of its last digit or more: what tables do not tell
/// apart is no difference in a figure.
fn range_of(metric: &str, values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let (low, high) = range(values)?;
    let least = match Metric::find(metric).map(|metric| metric.digits) {
        Some(Digits::Decimals(digits)) => 10f64.powi(1 - digits as i32),
        _ => 0.0,
    };
    let room = (least - (high - low)).max(0.0) / 2.0;
    Some((low - room, high + room))
}

/// Returns the name of a metric in figures.
fn metric_label(key: &str) -> &str {
    Metric::find(key).map_or(key, |metric| metric.label)
}

/// Mean over seeds with their spread: mean ± standard deviation for three or more seeds, the two values for two,
/// nothing for one.
#[derive(Clone, Copy)]
struct Spread {
    mean: f64,
    band: Option<(f64, f64)>,
}

impl Spread {
    fn new(values: &[f64]) -> Option<Spread> {
        let mean = mean(values)?;
        let band = match values {
            [_] => None,
            [a, b] => Some((a.min(*b), a.max(*b))),
            _ => standard_deviation(values).map(|deviation| (mean - deviation, mean + deviation)),
        };
        Some(Spread { mean, band })
    }
}

const SPREAD_NOTE: &str = "Lines and large dots are means over seeds, faint dots the seeds; bands are mean ± standard deviation of three and \
     more seeds, and from end to end of two.";
